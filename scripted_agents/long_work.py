"""The progress of long exact work, and the time that it may take."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from time import perf_counter
from typing import TypeVar

from scripted_agents.limits import MAX_EXACT_WORK

T = TypeVar("T")
Tell = Callable[[str, float], None]
"""(what, share): a description of the work, and its completed share in [0, 1]; NaN if unknown."""


class OutOfTime(Exception):
    """Exact work took longer than allowed; raised once."""


@dataclass
class _Time:
    """The time of exact work: seconds from its start, None for no limit, and whether it is over."""

    seconds: float | None
    tell: Tell
    began: float
    is_over: bool = False


_current: ContextVar[_Time | None] = ContextVar("_current", default=None)


def in_time(work: Callable[[], T], seconds: float | None, tell: Tell) -> tuple[T, str]:
    """The result of work with exact solutions, which may take so many seconds.

    When they are over, the work is done again without the solutions of games that are larger than
    MAX_EXACT_WORK (`limits.work_of`): those take about a second.

    Args:
        work: without side effects; nothing that it keeps was solved before.
        seconds: 0 for none of these solutions, None for no limit.
        tell: called with the progress of the work.

    Returns:
        The result, and the limit in words if it was reached; else "".
    """
    time = _Time(seconds, tell, perf_counter(), seconds == 0.0)
    token = _current.set(time)
    try:
        try:
            found = work()
        except OutOfTime:
            found = work()
        return found, why_no_time(MAX_EXACT_WORK + 1) or ""
    finally:
        _current.reset(token)


def report(what: str, share: float) -> None:
    """Report the progress of work."""
    if (time := _current.get()) is not None:
        time.tell(what, share)


def working(what: str, share: float) -> None:
    """Report the progress of an exact solution; `OutOfTime` where it takes too long."""
    time = _current.get()
    if time is None:
        return
    report(what, share)
    if not time.is_over and time.seconds is not None:
        time.is_over = perf_counter() - time.began > time.seconds
        if time.is_over:
            raise OutOfTime


def why_no_time(work: int) -> str | None:
    """Why a game of this size (`limits.work_of`) is not solved now; None if it may be."""
    time = _current.get()
    if time is None or not time.is_over or work <= MAX_EXACT_WORK:
        return None
    return f"exact solutions are limited to {time.seconds:g} s (--exact-seconds)"
