"""Gymnasium environments of one game, and the base classes of all Gymnasium environments.

`SingleEnv` is one game, `pursuit.environments.vector.LockstepVectorEnv` a batch. Both use the
methods of `GamesOfWorld`, which mazes and arms implement.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from pursuit.rendering.rendering import Drawable
from pursuit.rendering.windows import Rendered
from pursuit.validation import as_array, checked_seed, some_seed


class StepLimitInSpec:
    """`spec.max_episode_steps` is the `max_steps` of the task, which truncates episodes itself.

    The ids are registered without a limit, as `gymnasium.make` would add a `TimeLimit` that ignores
    `max_steps`. The limit is set when Gymnasium sets the spec.
    """

    task: Any
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The spec of `gymnasium.make` or `make_vec`; None for environments made otherwise."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        limit = self.task.max_steps
        self._spec = None if spec is None else replace(spec, max_episode_steps=limit)


def checked_actions(
    actions: Any, kinds: str, shape: tuple[int, ...], rule: str, limits: tuple[int, int] | None
) -> NDArray[Any]:
    """`actions` as an array.

    Args:
        actions: the actions of a batch of games.
        kinds: the allowed kinds of dtypes, in NumPy's codes.
        shape: the required shape.
        rule: description of valid actions, for messages.
        limits: the smallest and largest value; None for no check.

    Raises:
        ValueError: a wrong dtype or shape, or a value outside the limits.
    """
    chosen = as_array("actions", actions, kinds, rule)
    if chosen.shape != shape or chosen.dtype.kind not in kinds:
        raise ValueError(
            f"actions of shape {chosen.shape} and dtype {chosen.dtype}; give {rule} of shape "
            f"{shape}"
        )
    if limits is not None:
        low, high = np.minimum.reduce(chosen, axis=None), np.maximum.reduce(chosen, axis=None)
        if low < limits[0] or high > limits[1]:
            raise ValueError(f"actions from {low} to {high}; give {rule}")
    return chosen


def row_of(observations: Any, game: Any) -> Any:
    """The entry of one game in a batch of observations, or in a dict of batches."""
    if isinstance(observations, dict):
        return {key: values[game] for key, values in observations.items()}
    return observations[game]


class GamesOfWorld(ABC):
    """Interface of Gymnasium environments to simulators; all arrays are [games, ...]."""

    @abstractmethod
    def _begin(
        self, seed: int | None, options: Any, games: NDArray[np.bool_] | None = None
    ) -> None:
        """Start new episodes in all games, or those of a mask; ValueError for invalid options."""

    @abstractmethod
    def _checked(self, actions: Any) -> Any:
        """The actions in the form that `_advance` needs; ValueError for invalid ones."""

    @abstractmethod
    def _advance(self, actions: Any) -> tuple[NDArray[Any], NDArray[np.bool_], NDArray[np.bool_]]:
        """Step; rewards, terminations and truncations [games], overwritten by later steps."""

    @abstractmethod
    def _observe(self) -> Any:
        """[games, ...] the observations, an array or a dict of arrays."""

    @abstractmethod
    def _returns(self) -> NDArray[np.float64]:
        """[games] the sum of rewards of the current episodes."""

    def _infos(self) -> dict[str, NDArray[Any]]:
        """The infos of every reset and step, without Gymnasium's masks."""
        return {}

    @abstractmethod
    def _scene(self, game: int = 0) -> Drawable:
        """The scene of one game."""


class SingleEnv(GamesOfWorld, StepLimitInSpec, Rendered, gymnasium.Env[Any, Any]):
    """One game of a simulator. The info of the last step has the return and length of the episode.

    Args:
        simulator: a simulator of one game with `auto_restart=False`.
        observed, action: the spaces of observations and actions.
    """

    simulator: Any

    def __init__(
        self, simulator: Any, observed: gymnasium.Space[Any], action: gymnasium.Space[Any]
    ) -> None:
        self.simulator, self.task = simulator, simulator.task
        self.observation_space, self.action_space = observed, action
        self._seeded = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: seeds all random streams; an arm then draws a new pose.
            options: the start state: "positions" and "goals", and "maze", its number, if there are
                several; for an arm `{"angles": [joints] radians, "target": (x, y)}`.

        Raises:
            ValueError: a seed out of range, or an invalid start. Nothing is changed then.
        """
        if seed is not None:
            seed = checked_seed(seed)
        elif not self._seeded:
            seed = some_seed()
        self._begin(seed, options)
        super().reset(seed=seed)
        self._seeded = True
        self._show()
        return row_of(self._observe(), 0), row_of(self._infos(), 0)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step your agent and all other agents.

        Raises:
            ValueError: a step before the first reset, or an invalid action. Nothing is changed
                then.
        """
        if not self._seeded:
            raise ValueError("step before reset; call reset() first")
        rewards, terminations, truncations = self._advance(self._checked(action))
        self._show()
        info: dict[str, Any] = row_of(self._infos(), 0)
        terminated, truncated = bool(terminations[0]), bool(truncations[0])
        if terminated or truncated:
            info["episode_return"] = float(self._returns()[0])
            info["episode_length"] = int(self.simulator.steps[0])
        return row_of(self._observe(), 0), float(rewards[0]), terminated, truncated, info
