"""Gymnasium's environments of one game, and what all of Gymnasium's environments share.

`SingleEnv` is one game, `pursuit.environments.vector.LockstepVectorEnv` a batch. Both ask the same
of the world that is played, which `GamesOfWorld` lists.
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

    The ids are registered without a limit: `gymnasium.make` would add a `TimeLimit` of that many
    steps, whatever `max_steps` is given. So the limit is written when Gymnasium sets the spec.
    """

    task: Any
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What `gymnasium.make` or `make_vec` made this of; None where neither did."""
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
        actions: of a batch of games.
        kinds: of dtypes, as NumPy names them.
        shape: that it must have.
        rule: for the message.
        limits: the least and the largest value; None where they are not checked here.

    Raises:
        ValueError: another dtype or shape, or a value outside the limits.
    """
    chosen = as_array("actions", actions, kinds, rule)
    if chosen.shape != shape or chosen.dtype.kind not in kinds:
        raise ValueError(
            f"actions of shape {chosen.shape} and dtype {chosen.dtype}; {rule} of shape {shape} "
            "are needed"
        )
    if limits is not None:
        low, high = np.minimum.reduce(chosen, axis=None), np.maximum.reduce(chosen, axis=None)
        if low < limits[0] or high > limits[1]:
            raise ValueError(f"actions from {low} to {high}; {rule}")
    return chosen


def row_of(observations: Any, game: Any) -> Any:
    """The observation of one game in a batch, or in a dict of batches."""
    if isinstance(observations, dict):
        return {key: values[game] for key, values in observations.items()}
    return observations[game]


class GamesOfWorld(ABC):
    """What a world says of its games, one or many; all arrays are [games, ...]."""

    @abstractmethod
    def _begin(
        self, seed: int | None, options: Any, games: NDArray[np.bool_] | None = None
    ) -> None:
        """Begin new episodes in all games, or those of a mask; ValueError for options of none."""

    @abstractmethod
    def _checked(self, actions: Any) -> Any:
        """Actions, of one game or of all, as `_advance` takes them; ValueError for others."""

    @abstractmethod
    def _advance(self, actions: Any) -> tuple[NDArray[Any], NDArray[np.bool_], NDArray[np.bool_]]:
        """Rewards, terminations and truncations [games] of one step, live arrays."""

    @abstractmethod
    def _observe(self) -> Any:
        """[games, ...] what is observed now, an array or a dict of arrays."""

    @abstractmethod
    def _returns(self) -> NDArray[np.float64]:
        """[games] the sum of rewards of every episode so far."""

    def _infos(self) -> dict[str, NDArray[Any]]:
        """The infos of every reset and step, without masks."""
        return {}

    @abstractmethod
    def _scene(self, game: int = 0) -> Drawable:
        """One game as it is drawn."""


class SingleEnv(GamesOfWorld, StepLimitInSpec, Rendered, gymnasium.Env[Any, Any]):
    """One game of a simulator; the info of the last step has the return and length of the episode.

    Args:
        simulator: of one game, made with `auto_restart=False`.
        observed, action: the spaces.
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
        """Begin a new episode.

        Args:
            seed: begins all random streams anew, and of an arm a pose that is kept otherwise.
            options: "positions" and "goals" to begin there, with "maze", its number, where there
                are several; of an arm `{"angles": [joints] radians, "target": (x, y)}`.

        Raises:
            ValueError: a seed out of range, or options that make no start; nothing is changed then.
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
        """Move your agent, and everybody else, by one step.

        Raises:
            ValueError: before the first reset, or an action of a wrong form or out of range; then
                nothing has moved.
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
