"""Custom observations: their protocol, their registry and their evaluation."""

from __future__ import annotations

import re
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.observations.pursuit_v5 import PursuitV5Observation
from pursuit.plugins import Registry
from pursuit.rules.arrays import Array
from pursuit.rules.layout import Games
from pursuit.tasks.moments import Before, distances_of, roles_of
from pursuit.tasks.task import Task

ENCODINGS = ("one_hot", "positions", "cells", "walls", "planes", "index", "window")
"""The names of the built-in encodings; see `pursuit.observations.observations.Encoder`. "window:R",
with a number R, is built in as well."""
WINDOW = "window"
MAX_WINDOW = 255
"""The largest R of "window:R"."""
AGENT_ID = "+id"
"""Suffix of an encoding that ends with the number of the agent within its role."""


def without_id(encoding: str) -> str:
    """The encoding without the suffix "+id"."""
    return encoding.removesuffix(AGENT_ID)


def is_builtin(encoding: object) -> bool:
    """Whether an encoding is built in, including "window:R"."""
    if not isinstance(encoding, str):
        return False
    encoding = without_id(encoding)
    return encoding in ENCODINGS or re.fullmatch(rf"{WINDOW}:[0-9]+", encoding) is not None


def given_radius(encoding: str) -> int | None:
    """R of "window:R"; None for any other encoding.

    Raises:
        ValueError: R is too large.
    """
    _, colon, radius = without_id(encoding).partition(":")
    if not colon:
        return None
    if int(radius) > MAX_WINDOW:
        raise ValueError(
            f"window radius {radius}; at most {MAX_WINDOW}: give a smaller one, such as window:4"
        )
    return int(radius)


def check_observation(name: object) -> None:
    """Raise ValueError unless `name` is a built-in encoding or a custom observation."""
    if is_builtin(name):
        given_radius(str(name))
    elif isinstance(name, str) and name.startswith(f"{WINDOW}:"):
        raise ValueError(
            f"observation {name!r}; give window:R with a number R from 0 to {MAX_WINDOW}, such "
            "as window:4"
        )
    else:
        OBSERVATIONS.check(without_id(name) if isinstance(name, str) else name)


class Observation(Protocol):
    """A custom observation."""

    def space(self, task: Task) -> gymnasium.spaces.Box:
        """The observation space of one agent, of any shape.

        Networks process [channels, height, width] by convolutions and any other shape as a vector.
        """

    def encode(self, task: Task, games: Before, seats: NDArray[np.intp]) -> Array:
        """[games, seats, *shape]: the observations of the agents with indices `seats` [k].

        `games` is read-only. If the task limits views, this is called for one agent at a time, with
        the games as that agent sees them: agents out of view are not active, in cell -1 and without
        events, and goals out of view are -1. The mazes of the task are not hidden.
        """


OBSERVATIONS: Registry[Any] = Registry(
    "observation",
    "an object or class with space(task) and encode(task, games, seats)",
    lambda part: callable(getattr(part, "space", None)) and callable(getattr(part, "encode", None)),
    ours=ENCODINGS,
)
OBSERVATIONS.register("pursuit_v5", PursuitV5Observation)
OBSERVATIONS.register("pursuit_v5_flat", PursuitV5Observation(flat=True))


class CustomEncoding:
    """A custom observation of one task.

    Args:
        task: the task.
        encoding: its name, the object, or its class.

    Raises:
        ValueError: not an observation, or its space is not a Box.

    Attributes:
        space: its Gymnasium space.
    """

    def __init__(self, task: Task, encoding: Any) -> None:
        if isinstance(encoding, str):
            check_observation(encoding)
        part = OBSERVATIONS.resolved(encoding)
        self.task, self.encoding = task, encoding
        self.part: Observation = part() if isinstance(part, type) else part
        self.space = self.part.space(task)
        if not isinstance(self.space, gymnasium.spaces.Box) or not self.space.shape:
            raise ValueError(
                f"observation {encoding!r} has the space {self.space}; it must be a "
                "gymnasium.spaces.Box of at least one dimension"
            )

    def encode(self, games: Games, seats: slice) -> Array:
        """[games, seats, *shape], a new array of the dtype of the space.

        Raises:
            ValueError: `encode` returned another shape, or a dtype that cannot be cast.
        """
        chosen = np.arange(self.task.num_agents)[seats]
        if not self.task.sight.limited:
            return self._encode(games, chosen)
        sight = self.task.sight
        seen = [
            self._encode(sight.observed_games(games, seat), chosen[i : i + 1])
            for i, seat in enumerate(chosen)
        ]
        return np.concatenate(seen, axis=1)

    def _encode(self, games: Games, chosen: NDArray[np.intp]) -> Array:
        task = self.task
        arrays = (*games, roles_of(task.seat_roles), distances_of(task.mazes))
        shown = Before(*(array.view() for array in arrays))
        for view in shown:
            view.flags.writeable = False
        seen = np.asarray(self.part.encode(task, shown, chosen))
        shape, dtype = (len(games.steps), len(chosen), *self.space.shape), self.space.dtype
        if seen.shape != shape or not np.can_cast(seen.dtype, dtype, "same_kind"):
            raise ValueError(
                f"observation {self.encoding!r} returned {seen.dtype} of shape {seen.shape}; its "
                f"space needs {dtype} [games, seats, *shape] = {shape}"
            )
        return np.array(seen, dtype=dtype, order="C")
