"""The progress of long exact work, and the time that it may take."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from time import perf_counter
from typing import TypeVar

from scripted_agents.exact.limits import MAX_EXACT_WORK

T = TypeVar("T")
Tell = Callable[[str, float], None]
"""(what, share): a description of the work, and its completed share in [0, 1]; NaN if unknown."""


LIMIT = "exact solutions are limited to {} s (--exact-seconds)"


class OutOfTime(Exception):
    """Exact solutions took longer than allowed; raised once."""


@dataclass
class _Time:
    """The time of exact solutions.

    Attributes:
        seconds: that they may take; None for no limit.
        tell: see `in_time`.
        spent: seconds that they took so far.
        raised: whether `OutOfTime` was raised.
        refused: whether a solution was left out.
    """

    seconds: float | None
    tell: Tell
    spent: float = 0.0
    raised: bool = False
    refused: bool = False

    @property
    def is_over(self) -> bool:
        return self.seconds is not None and self.spent >= self.seconds


_current: ContextVar[_Time | None] = ContextVar("_current", default=None)


def in_time(work: Callable[[], T], seconds: float | None, tell: Tell) -> tuple[T, str]:
    """The result of work with exact solutions of whole games, which may take so many seconds.

    When they are over, the work is done again without the solutions of games that are larger than
    MAX_EXACT_WORK (`limits.work_of`); smaller ones take about a second.

    Args:
        work: can be done twice, and solves again what it needs.
        seconds: 0 for none of these solutions, None for no limit.
        tell: called with the progress of the work.

    Returns:
        The result, and the limit in words if a solution was left out; else "".
    """
    time = _Time(seconds, tell)
    token = _current.set(time)
    try:
        try:
            found = work()
        except OutOfTime:
            found = work()
        return found, LIMIT.format(f"{seconds:g}") if time.refused else ""
    finally:
        _current.reset(token)


def report(what: str, share: float) -> None:
    """Report the progress of work."""
    if (time := _current.get()) is not None:
        time.tell(what, share)


class Solving:
    """The progress and the time of one exact solution, from its construction on."""

    def __init__(self, what: str) -> None:
        self.what, self.now = what, perf_counter()

    def __call__(self, share: float) -> None:
        """Report the completed share; `OutOfTime` where exact solutions take too long."""
        report(self.what, share)
        before, self.now = self.now, perf_counter()
        if (time := _current.get()) is not None:
            time.spent += self.now - before
            if time.is_over and not time.raised:
                time.raised = True
                raise OutOfTime


def why_no_time(work: int) -> str | None:
    """Why a game of this size (`limits.work_of`) is not solved now; None if it may be."""
    time = _current.get()
    if time is None or not time.is_over or work <= MAX_EXACT_WORK:
        return None
    time.refused = True
    return LIMIT.format(f"{time.seconds:g}")
