"""Compiled kernel of sweeps over states whose steps are known: see `joint_kernels.Store`."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled

TIE = 1e-12
"""As in `joint_kernels`."""


@compiled
def sweep_stored(
    pairs: Any,
    edges: Any,
    shape: Any,
    following: Any,
    sides: Any,
    joints: Any,
    sums: Any,
    best: Any,
    sign: float,
    discount: float,
    only_whether: bool,
    values: Any,
    target: Any,
    choice: Any,
    segments: Any,
    changes: Any,
) -> None:
    """The same as `joint_kernels.sweep`, by what that has stored."""
    number = sums.shape[0]
    for segment in range(segments.shape[0]):
        change, largest = 0.0, 0.0
        for state in range(segments[segment, 0], segments[segment, 1]):
            ours, theirs = np.int64(shape[state, 0]), np.int64(shape[state, 1])
            if ours == 0:
                continue
            edge, pair = edges[state], pairs[state]
            chances, chosen, bound, least = edge + ours * number, 0, np.inf, np.inf
            for own in range(ours):
                for q in range(number):
                    sums[q] = 0.0
                for other in range(theirs):
                    after = np.int64(following[pair + own * theirs + other])
                    if after >= 0:
                        for q in range(number):
                            sums[q] += sides[chances + other] * values[after, q]
                for q in range(number):
                    sums[q] = sides[edge + own * number + q] + discount * sums[q]
                first = sign * sums[0]
                if first < bound:
                    bound, chosen = first - TIE * max(1.0, abs(first)), own
                if first < least or own == 0:
                    least = first
                    for q in range(number):
                        best[q] = sums[q]
            choice[state] = joints[edge + chosen]
            for q in range(number):
                worth = best[q]
                if only_whether:
                    worth = 1.0 if worth > 0.0 else 0.0
                change = max(change, abs(worth - values[state, q]))
                largest = max(largest, abs(worth))
                target[state, q] = worth
        changes[segment, 0], changes[segment, 1] = change, largest
