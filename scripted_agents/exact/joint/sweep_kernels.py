"""Compiled sweeps of Bellman's equation over the stored transitions of a game."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled, inlined
from scripted_agents.exact.joint.layout import Backup, Store, Workspace
from scripted_agents.exact.joint.slips import slip_options
from scripted_agents.exact.tolerances import EQUAL_VALUES, TIE


@inlined
def back_up(store: Store, state: int, work: Workspace, backup: Backup, values: Any) -> int:
    """Compute the values of a state into `work.best`; return the joint action chosen."""
    number, ours, theirs = work.best.shape[0], store.shape[state, 0], store.shape[state, 1]
    edge, pair = store.edges[state], store.pairs[state]
    chances, chosen, bound, least = edge + ours * number, 0, np.inf, np.inf
    discount, worth = backup.discount if store.shape[state, 3] != 0 else 1.0, work.worth
    for own in range(ours):
        first = np.uint64(pair + own * theirs)  # signed indices are checked for negative values
        for q in range(number):
            total, at, chance = 0.0, first, np.uint64(chances)
            for _ in range(theirs):
                after = np.int64(store.following[at])
                if after >= 0:
                    total += store.sides[chance] * values[after, q]
                at, chance = at + np.uint64(1), chance + np.uint64(1)
            worth[own, q] = store.sides[edge + own * number + q] + discount * total
    if store.slips.shape[0] > 0:
        slip_options(store, state, worth, False)
    for own in range(ours):
        first = backup.sign * worth[own, 0]
        if first < bound:
            bound, chosen = first - TIE * max(1.0, abs(first)), own
        if first < least or own == 0:
            least = first
            for q in range(number):
                work.best[q] = worth[own, q]
    return int(store.joints[edge + chosen])


@compiled
def sweep(
    work: Workspace, store: Store, backup: Backup, values: Any, target: Any, choice: Any,
    segments: Any, changes: Any,
) -> None:  # fmt: skip
    """Back up all states of `segments` [n, 2] (first state, and the one after the last) once.

    `target` may be `values`. `choice` [states] gets the joint actions; `changes` [n, 2] zeros, the
    largest change of each segment, and the largest value.
    """
    for segment in range(segments.shape[0]):
        for state in range(segments[segment, 0], segments[segment, 1]):
            if store.shape[state, 0] == 0:
                continue
            choice[state] = back_up(store, state, work, backup, values)
            for q in range(work.best.shape[0]):
                worth = work.best[q]
                if backup.only_whether:
                    worth = 1.0 if worth > 0.0 else 0.0
                changes[segment, 0] = max(changes[segment, 0], abs(worth - values[state, q]))
                changes[segment, 1] = max(changes[segment, 1], abs(worth))
                target[state, q] = worth


@compiled
def list_optimal(work: Workspace, store: Store, backup: Backup, values: Any, optimal: Any) -> None:
    """Set `optimal` [states, actions] bool for the options of a single agent that are best up to
    EQUAL_VALUES, with `values` after them."""
    for state in range(optimal.shape[0]):
        ours, edge, best = store.shape[state, 0], store.edges[state], np.inf
        if ours > 0:
            back_up(store, state, work, backup, values)
        for own in range(ours):
            best = min(best, backup.sign * work.worth[own, 0])
        for own in range(ours):
            worse = backup.sign * work.worth[own, 0] - best
            optimal[state, store.joints[edge + own]] = worse <= EQUAL_VALUES * max(1.0, abs(best))
