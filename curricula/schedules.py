"""Pure functions from the progress of a run to the value of a setting.

Schedules return exactly their start value at the start and exactly their end value at the end, and
stay between these two values in spite of rounding.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, floor, inf, isfinite, pi

SHAPES = ("constant", "linear", "cosine", "step", "exponential", "piecewise")
UNITS = ("share", "frames", "episodes", "seconds")


@dataclass(frozen=True)
class Progress:
    """The progress of a run.

    Attributes:
        share: the fraction of the budget that is spent, in [0, 1].
        frames, episodes, seconds: since the start of the run; frames and episodes of all games.
    """

    share: float = 0.0
    frames: float = 0.0
    episodes: float = 0.0
    seconds: float = 0.0


def _share(progress: float, length: float) -> float:
    """`progress / length`, clipped to [0, 1]; 1 for a length of 0."""
    if not 0.0 <= length < inf:
        raise ValueError(f"length={length}; give a finite length of at least 0")
    return min(max(progress / length, 0.0), 1.0) if length else 1.0


def _between(value: float, start: float, end: float) -> float:
    """`value`, clipped to the range from `start` to `end`."""
    low, high = (start, end) if start <= end else (end, start)
    return min(max(value, low), high)


def constant(value: float, progress: float = 0.0) -> float:
    """`value`, at any progress."""
    return value


def linear(start: float, end: float, progress: float, length: float = 1.0) -> float:
    """Linear from `start` at progress 0 to `end` at progress `length`.

    Outside this range it stays at `start` or `end`. ValueError for a negative length.
    """
    share = _share(progress, length)
    return _between((1.0 - share) * start + share * end, start, end)


def cosine(start: float, end: float, progress: float, length: float = 1.0) -> float:
    """From `start` to `end` along half a period: slow, fast, slow (Loshchilov and Hutter, 2017).

    ValueError for a negative length.
    """
    share = _share(progress, length)
    if share == 0.0:  # where end + (start - end) is not always start
        return start
    return _between(end + (start - end) * 0.5 * (1.0 + cos(pi * share)), start, end)


def step(start: float, end: float, progress: float, every: float, size: float = 1.0) -> float:
    """Steps of `size` from `start` towards `end` after each `every` of progress.

    Raises:
        ValueError: `every` or `size` is not above 0.
    """
    _check_positive(every=every, size=size)
    moved = floor(max(progress, 0.0) / every) * size
    if moved >= abs(end - start):
        return end
    return _between(start + moved if end >= start else start - moved, start, end)


def exponential(start: float, least: float, progress: float, every: float, factor: float) -> float:
    """`start` times `factor` for each whole `every` of progress, at least `least`.

    The thesis multiplied epsilon by 0.99 every n episodes, down to 0.2.

    Raises:
        ValueError: a start below 0, `least` above the start, a factor outside (0, 1), or `every`
            not above 0.
    """
    _check_positive(every=every)
    if not 0.0 < factor < 1.0:
        raise ValueError(f"factor={factor}; give a factor between 0 and 1")
    if start < 0.0:
        raise ValueError(f"start={start}; give a start of at least 0")
    if least > start:
        raise ValueError(f"the end {least} is above the start {start}; swap them")
    return max(start * factor ** floor(max(progress, 0.0) / every), least)


def piecewise(points: Sequence[tuple[float, float]], progress: float) -> float:
    """Linear interpolation of (progress, value) points; constant outside their range.

    Raises:
        ValueError: no points, progress values that do not increase, or numbers that are not finite.
    """
    places = [place for place, _ in points]
    if not all(isfinite(number) for point in points for number in point):
        raise ValueError(f"points={list(points)}; give finite numbers")
    if not points or any(a >= b for a, b in pairwise(places)) or places[0] < 0:
        raise ValueError(f"points={list(points)}; give (progress, value) with progress increasing")
    after = bisect_right(places, progress)
    if after == 0 or after == len(points):
        return points[max(after - 1, 0)][1]
    (left, before), (right, value) = points[after - 1], points[after]
    return linear(before, value, progress - left, right - left)


def _check_positive(**named: float) -> None:
    for name, value in named.items():
        if not 0.0 < value < inf:
            raise ValueError(f"{name}={value}; give a finite number above 0")


@dataclass(frozen=True)
class Schedule:
    """A schedule defined by plain values; call it with a `Progress`.

    Args:
        shape: one of SHAPES.
        start, end: the values at the beginning and at the end (exponential: the least value).
        unit: the unit of progress: "share" of the budget, "frames", "episodes" or
            "seconds".
        length: for linear and cosine, in `unit`.
        every, factor: for step (`every`) and exponential (both).
        points: for piecewise, (progress, value) with progress increasing.

    Raises:
        ValueError: an invalid value.
    """

    shape: str = "linear"
    start: float = 0.0
    end: float = 1.0
    unit: str = "share"
    length: float = 1.0
    every: float = 1.0
    factor: float = 0.99
    points: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for name, value, choices in (("schedule", self.shape, SHAPES), ("unit", self.unit, UNITS)):
            if value not in choices:
                raise ValueError(f"unknown {name} {value!r}; one of {', '.join(choices)}")
        if not (isfinite(self.start) and isfinite(self.end)):
            raise ValueError(f"start={self.start}, end={self.end}; give finite numbers")
        self(Progress())

    def __call__(self, progress: Progress) -> float:
        """The value at this progress."""
        now = float(getattr(progress, self.unit))
        if self.shape == "constant":
            return constant(self.end, now)
        if self.shape == "linear":
            return linear(self.start, self.end, now, self.length)
        if self.shape == "cosine":
            return cosine(self.start, self.end, now, self.length)
        if self.shape == "step":
            return step(self.start, self.end, now, self.every)
        if self.shape == "exponential":
            return exponential(self.start, self.end, now, self.every, self.factor)
        return piecewise(self.points, now)
