"""The axes of curricula by name: task parameters that a curriculum can vary from easy to hard."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.plugins import Registry

AXES = (
    *("opponent-epsilon", "slip", "goal-spread-fixed", "goal-spread-start", "start-distance"),
    *("num-goals", "maze-size", "loops"),
    *("target-distance", "free-joints", "hold", "tolerance"),
)
"""The built-in axes; the last four are of the arm."""

Apply = Callable[[Any, NDArray[np.intp], NDArray[np.float64]], None]


@dataclass(frozen=True)
class Axis:
    """A task parameter and its range from easy to hard.

    Attributes:
        name: one of `AXES`, or that of a user-defined axis.
        easiest, hardest: the ends of the range.
        apply: (simulator, games [n], values [n]); sets the values for the next episodes of `games`.
        whole: whether values are whole numbers.
        mazes: the mazes of the training games, if these vary; the last one is the task's.
        ordered: False if the values are indices that are not ordered by difficulty.
    """

    name: str
    easiest: float
    hardest: float
    apply: Apply
    whole: bool = True
    mazes: tuple[Maze, ...] = ()
    ordered: bool = True

    def stages(self, count: int) -> list[float]:
        """At most `count` different, evenly spaced values from easy to hard."""
        values = np.linspace(self.easiest, self.hardest, count)
        return list(dict.fromkeys((np.round(values) if self.whole else values).tolist()))


def is_axis(part: object) -> bool:
    """Whether a user-defined object is a `Maker` of an axis."""
    return callable(getattr(part, "make", None)) and hasattr(part, "scripted")


AXIS_PARTS: Registry[Any] = Registry(
    "axis", "a train.teaching.axes.Maker", is_axis, plural="axes", ours=("auto", *AXES)
)
"""User-defined axes."""
