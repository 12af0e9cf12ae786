"""What an axis of a curriculum is, in any world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.maze import Maze
from train.settings.checks import check
from train.settings.curricula import AxisSettings

Apply = Callable[[Any, NDArray[np.intp], NDArray[np.float64]], None]


@dataclass(frozen=True)
class Axis:
    """One quantity from easy to hard.

    Attributes:
        name: one of `train.settings.curricula.AXES`, or a user's own.
        easiest, hardest: the ends.
        apply: (simulator, games [n], values [n]): has the next episode of each of the games played
            with its value.
        whole: whether only whole numbers make sense.
        mazes: of the training games, where these are what changes; the last is the task's.
        ordered: False where its values are numbers of things that are not from easy to hard.
    """

    name: str
    easiest: float
    hardest: float
    apply: Apply
    whole: bool = True
    mazes: tuple[Maze, ...] = ()
    ordered: bool = True

    def stages(self, count: int) -> list[float]:
        """At most `count` values from easy to hard, evenly spaced, all different."""
        values = np.linspace(self.easiest, self.hardest, count)
        return list(dict.fromkeys((np.round(values) if self.whole else values).tolist()))


def ends_of(ends: AxisSettings, easiest: float, hardest: float) -> tuple[float, float]:
    """The ends that are given, else these; ValueError for one that is not finite."""
    first = easiest if ends.easiest is None else float(ends.easiest)
    last = hardest if ends.hardest is None else float(ends.hardest)
    for value in (first, last):
        check(bool(np.isfinite(value)), f"{value} as the easiest or hardest; a finite number")
    return first, last
