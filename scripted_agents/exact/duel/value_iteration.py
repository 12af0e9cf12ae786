"""Sweeps over an array of values up to a horizon or a fixed point, with threads if large."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from itertools import pairwise, repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripted_agents.exact.tolerances import (
    DUEL_TOLERANCE,
    MAX_DUEL_SWEEPS,
    MAX_DUEL_UPDATES,
    MAX_THREADS,
    SWEEP_WINDOW,
)

Sweep = Callable[[NDArray[np.float64], NDArray[np.float64], int, int], float]

THREADED_ROWS = 400
"""Arrays with at least this number of rows use several threads."""

MAX_JUMPS = 30
"""Maximum number of extrapolations to the fixed point; after them only plain sweeps follow."""

LARGEST_PLAIN_DISCOUNT = 0.99
"""Up to this discount no extrapolation is used, as plain sweeps converge fast."""


def iterate_duel(
    sweep: Sweep,
    shape: tuple[int, int],
    horizon: int | None,
    discount: float = 1.0,
    start: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Backward induction, or value iteration. Bellman (1957).

    Args:
        sweep: (values, target, first, last) -> largest change; writes the next values of the rows
            from `first` to `last` - 1 into `target`. Threads help if it releases the GIL.
        shape: of the values, float64.
        horizon: number of sweeps; None for as many as needed until the values are within about
            DUEL_TOLERANCE (relative to the largest) of the fixed point.
        discount: factor by which a sweep reduces differences, or more.
        start: of the shape, the first values; None for 0.

    Returns:
        The values, those before the last sweep, and the number of sweeps. Values do not depend on
        the number of threads.

    Raises:
        ValueError: no convergence within MAX_DUEL_SWEEPS and MAX_DUEL_UPDATES.
    """
    values = np.zeros(shape) if start is None else start
    target = np.zeros(shape)
    threads = min(os.cpu_count() or 1, MAX_THREADS) if shape[0] >= THREADED_ROWS else 1
    bounds = [shape[0] * i // threads for i in range(threads + 1)]
    most = horizon or min(MAX_DUEL_SWEEPS, MAX_DUEL_UPDATES // values.size)
    changes: list[float] = []
    slowest = 0.0
    jumps = 0 if discount > LARGEST_PLAIN_DISCOUNT else MAX_JUMPS
    with ExitStack() as stack:
        pool: Any = stack.enter_context(ThreadPoolExecutor(threads)) if threads > 1 else None
        for sweeps in range(1, most + 1):
            if pool is None:
                change = sweep(values, target, 0, shape[0])
            else:
                rows = repeat(values), repeat(target), bounds, bounds[1:]
                change = max(pool.map(sweep, *rows))
            values, target = target, values
            if change == 0.0:  # a fixed point: more sweeps change nothing
                return values, target, sweeps
            changes.append(change)
            if horizon is not None or len(changes) < SWEEP_WINDOW:
                continue
            # Further changes are approximately a geometric series.
            rates = [after / before for before, after in pairwise(changes[-SWEEP_WINDOW:])]
            rate = max(*rates, slowest)
            largest = float(np.abs(values).max())
            rest = change * rate / (1.0 - rate) if rate < 1.0 else np.inf
            if (
                change <= 4 * np.spacing(largest)
                or change * discount <= 0.1 * (1.0 - discount) * DUEL_TOLERANCE * max(largest, 1.0)
                or rest <= 0.1 * DUEL_TOLERANCE * max(largest, 1.0)
            ):
                return values, target, sweeps
            if jumps < MAX_JUMPS and len(changes) >= 4 * SWEEP_WINDOW and _is_steady(rates):
                # Add the sum of the series. Sweeps converge from any values, so a bad extrapolation
                # only takes time.
                slowest = max(rates)
                jumps += 1
                values += (values - target) * (slowest / (1.0 - slowest))
                changes = []
    if horizon is None:
        largest = float(np.abs(values).max())
        raise ValueError(
            f"value iteration has not converged after {most} sweeps: capture is too rare "
            f"(expected steps so far {largest:.3g}); give a horizon, or a smaller discount"
        )
    return values, target, horizon


def _is_steady(rates: list[float]) -> bool:
    """Whether the changes decrease slowly, and regularly enough to extrapolate."""
    slowest = max(rates)
    return 0.9 < slowest < 1.0 - 1e-7 and (1.0 - min(rates)) < 1.05 * (1.0 - slowest)
