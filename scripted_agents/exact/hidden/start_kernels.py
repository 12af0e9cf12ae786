"""Compiled kernels of the initial bounds of the search of a `HiddenCell`.

Both are fixed points that sweeps approach from one side, so the values are a bound after every
sweep. Arrays as in `layout`.
"""

from __future__ import annotations

from typing import Any

from pursuit.compilation.compiled import compiled, subroutine


@subroutine
def least_after(model: Any, values: Any, own: int, action: int, cell: int) -> Any:
    """The expected least value after an action: for each cell in view, and for all others."""
    mine, mean, least = model.next_own[own, action], 0.0, 1e300
    branches, actions = model.targets.shape[3], model.next_own.shape[1]
    for branch in range(branches):
        target = model.targets[own, action, cell, branch]
        if model.slots[mine, target] < 0:
            known = 1e300
            for after in range(actions):
                if model.useful[mine, after]:
                    known = min(known, values[mine, target, after])
            mean += model.chances[own, action, cell, branch] * known
    for after in range(actions):
        if model.useful[mine, after]:
            unseen = 0.0
            for branch in range(branches):
                target = model.targets[own, action, cell, branch]
                if model.slots[mine, target] >= 0:
                    chance = model.chances[own, action, cell, branch]
                    unseen += chance * values[mine, target, after]
            least = min(least, unseen)
    return mean + least


@compiled
def inform(model: Any, values: Any) -> Any:
    """One sweep of the fast informed bound (Hauskrecht, 2000); returns the largest change.

    values [own, hidden, action] float64: a lower bound of the cost with that first action, if the
    hidden cell is known now; from the next step on it is known only if visible. Values increase,
    and are updated in place.
    """
    change = 0.0
    for own in range(values.shape[0]):
        for cell in range(values.shape[1]):
            for action in range(values.shape[2]):
                if model.useful[own, action]:
                    mean = least_after(model, values, own, action, cell)
                    value = model.costs[own, action, cell] + model.discount * mean
                    change = max(change, value - values[own, cell, action])
                    values[own, cell, action] = max(values[own, cell, action], value)
    return change


@compiled
def wander(model: Any, values: Any) -> Any:
    """One sweep of the costs of a random walk, values [own, hidden]; returns the largest change.

    Values decrease.
    """
    change = 0.0
    for own in range(values.shape[0]):
        for cell in range(values.shape[1]):
            total, count = 0.0, 0
            for action in range(model.next_own.shape[1]):
                if model.useful[own, action]:
                    mine, mean = model.next_own[own, action], 0.0
                    for branch in range(model.targets.shape[3]):
                        target = model.targets[own, action, cell, branch]
                        mean += model.chances[own, action, cell, branch] * values[mine, target]
                    total += model.costs[own, action, cell] + model.discount * mean
                    count += 1
            value = total / count
            change = max(change, values[own, cell] - value)
            values[own, cell] = min(values[own, cell], value)
    return change
