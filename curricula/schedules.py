"""Schedules: a value as a function of progress in [0, 1]. Numbers only."""

from __future__ import annotations


def linear(start: float, end: float, progress: float) -> float:
    """From `start` at progress 0 to `end` at progress 1, in a straight line; clipped outside."""
    share = min(max(progress, 0.0), 1.0)
    return start + (end - start) * share
