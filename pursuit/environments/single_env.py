"""Gymnasium environments of one game, and the base classes of all Gymnasium environments.

`SingleEnv` is one game, `pursuit.environments.vector.LockstepVectorEnv` a batch. Both use the
methods of `GamesOfWorld`, which mazes and arms implement.
"""

from __future__ import annotations

import json
import sys
from abc import ABC, abstractmethod
from dataclasses import fields
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.types import GamesSimulator, Info, Observations, Options, Single, Space
from pursuit.rendering.rendering import Drawable
from pursuit.rendering.windows import Rendered
from pursuit.rules.arrays import Array
from pursuit.validation import as_array, checked_seed, random_seed

MAKERS = (gymnasium.make.__code__, gymnasium.make_vec.__code__)
"""The functions that read no limit of a task from a `TaskSpec`."""


class TaskSpec(EnvSpec):
    """A spec whose `max_episode_steps` is the `max_steps` of a task, which truncates by itself.

    Wrappers and other libraries read the limit there. `gymnasium.make` and `make_vec` would repeat
    it as a TimeLimit, which would stay when another `max_steps` is given. So these two, and JSON,
    get None unless a TimeLimit was asked for.
    """

    task_limit: int | None = None
    _time_limit: int | None

    @property
    def max_episode_steps(self) -> int | None:
        """The limit of a TimeLimit, or else of the task."""
        made = sys._getframe(1).f_code in MAKERS
        return self.task_limit if self._time_limit is None and not made else self._time_limit

    @max_episode_steps.setter
    def max_episode_steps(self, limit: int | None) -> None:
        self._time_limit = limit

    def to_json(self) -> str:
        """As `EnvSpec.to_json`, without the limit of the task."""
        return json.dumps({**json.loads(super().to_json()), "max_episode_steps": self._time_limit})


def checked_actions(
    actions: ArrayLike,
    kinds: str,
    shape: tuple[int, ...],
    rule: str,
    limits: tuple[int, int] | None,
) -> Array:
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


def row_of(observations: Observations, game: int | np.intp) -> Observations:
    """The entry of one game in a batch of observations, or in a dict of batches."""
    if isinstance(observations, dict):
        return {key: values[game] for key, values in observations.items()}
    return observations[game]


class GamesOfWorld(ABC):
    """Interface of Gymnasium environments to simulators; all arrays are [games, ...].

    The `spec` is a `TaskSpec`, when Gymnasium has set one.
    """

    task: Any
    _spec: TaskSpec | None = None

    def _max_steps(self) -> int:
        """The longest episode."""
        return int(self.task.max_steps)

    @property
    def spec(self) -> EnvSpec | None:
        """The spec of `gymnasium.make` or `make_vec`; None for environments made otherwise."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = None
        if spec is not None:
            given = {each.name: getattr(spec, each.name) for each in fields(spec) if each.init}
            limit = spec._time_limit if isinstance(spec, TaskSpec) else spec.max_episode_steps
            self._spec = TaskSpec(**{**given, "max_episode_steps": limit})
            self._spec.task_limit = self._max_steps()

    @abstractmethod
    def _begin(
        self, seed: int | None, options: Options, games: NDArray[np.bool_] | None = None
    ) -> None:
        """Start new episodes in all games, or those of a mask; ValueError for invalid options."""

    @abstractmethod
    def _checked(self, actions: ArrayLike) -> Array | int:
        """The actions in the form that `_advance` needs; ValueError for invalid ones."""

    @abstractmethod
    def _advance(self, actions: Array | int) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Step; rewards, terminations and truncations [games], overwritten by later steps."""

    @abstractmethod
    def _observe(self) -> Observations:
        """[games, ...] the observations, an array or a dict of arrays."""

    @abstractmethod
    def _returns(self) -> NDArray[np.float64]:
        """[games] the sum of rewards of the current episodes."""

    def _infos(self) -> dict[str, Array]:
        """The infos of every reset and step, without Gymnasium's masks."""
        return {}

    @abstractmethod
    def _scene(self, game: int = 0) -> Drawable:
        """The scene of one game."""


class SingleEnv(GamesOfWorld, Rendered, Single):
    """One game of a simulator. The info of the last step has the return and length of the episode.

    Args:
        simulator: a simulator of one game with `auto_restart=False`.
        observed, action: the spaces of observations and actions.
    """

    simulator: GamesSimulator

    def __init__(self, simulator: GamesSimulator, observed: Space, action: Space) -> None:
        self.simulator, self.task = simulator, simulator.task
        self.observation_space, self.action_space = observed, action
        self._seeded = False

    def reset(
        self, *, seed: int | None = None, options: Options = None
    ) -> tuple[Observations, Info]:
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
            seed = random_seed()
        self._begin(seed, options)
        super().reset(seed=seed)
        self._seeded = True
        self._show()
        return row_of(self._observe(), 0), self._info()

    def _info(self) -> Info:
        return {name: values[0] for name, values in self._infos().items()}

    def step(self, action: ArrayLike) -> tuple[Observations, float, bool, bool, Info]:
        """Step your agent and all other agents.

        Raises:
            ValueError: a step before the first reset, or an invalid action. Nothing is changed
                then.
        """
        if not self._seeded:
            raise ValueError("step before reset; call reset() first")
        rewards, terminations, truncations = self._advance(self._checked(action))
        self._show()
        info = self._info()
        terminated, truncated = bool(terminations[0]), bool(truncations[0])
        if terminated or truncated:
            info["episode_return"] = float(self._returns()[0])
            info["episode_length"] = int(self.simulator.steps[0])
        return row_of(self._observe(), 0), float(rewards[0]), terminated, truncated, info
