"""Compiled kernels of the plans that `HiddenSearch` finds: what they cost, and which are kept.

A plan is an action, and a plan to follow for as long as the other is not seen; where it is seen,
the plan of that place begins. So the plans are the states of a controller, and dropping none that
another one leads to keeps every cost true. Arrays as in `hidden_layout`.
"""

from __future__ import annotations

from typing import Any

from pursuit.compiled import compiled, subroutine

NONE = -1


@subroutine
def cost_of(model: Any, upper: Any, own: int, cell: int, action: int, follow: int) -> Any:
    """What an action and a plan after it cost where the hidden cell is this one."""
    mine, mean = model.next_own[own, action], 0.0
    for branch in range(model.targets.shape[3]):
        target = model.targets[own, action, cell, branch]
        slot = model.slots[mine, target]
        known = upper.seen[mine, target] if slot == NONE else upper.vectors[mine, slot, follow]
        mean += model.chances[own, action, cell, branch] * known
    return model.costs[own, action, cell] + model.discount * mean


@compiled
def evaluate_plans(model: Any, upper: Any) -> Any:
    """The costs of all plans, from those of the plans after them; returns the largest change."""
    change = 0.0
    for own in range(len(model.sizes)):
        for plan in range(upper.count[own]):
            action, follow = upper.action[own, plan], upper.follow[own, plan]
            if action == NONE:
                continue
            for slot in range(model.sizes[own]):
                cost = cost_of(model, upper, own, model.cells[own, slot], action, follow)
                change = max(change, upper.vectors[own, slot, plan] - cost)
                upper.vectors[own, slot, plan] = min(upper.vectors[own, slot, plan], cost)
    for own in range(len(model.sizes)):
        for cell in range(upper.seen.shape[1]):
            if model.slots[own, cell] == NONE and upper.seen_action[own, cell] != NONE:
                action, follow = upper.seen_action[own, cell], upper.seen_follow[own, cell]
                cost = cost_of(model, upper, own, cell, action, follow)
                change = max(change, upper.seen[own, cell] - cost)
                upper.seen[own, cell] = min(upper.seen[own, cell], cost)
    return change


@compiled
def mark_followed(model: Any, upper: Any, used: Any) -> None:
    """Mark in used [own, plan] the random walks, the plans after a sight, and all that follow."""
    for own in range(len(model.sizes)):
        used[own, 0] = True
        for cell in range(upper.seen.shape[1]):
            action = upper.seen_action[own, cell]
            if model.slots[own, cell] == NONE and action != NONE:
                used[model.next_own[own, action], upper.seen_follow[own, cell]] = True
    news = True
    while news:
        news = False
        for own in range(len(model.sizes)):
            for plan in range(upper.count[own]):
                if used[own, plan] and upper.action[own, plan] != NONE:
                    mine = model.next_own[own, upper.action[own, plan]]
                    follow = upper.follow[own, plan]
                    news |= not used[mine, follow]
                    used[mine, follow] = True


@compiled
def drop_plans(model: Any, upper: Any, used: Any, number: Any) -> None:
    """Drop the plans that are not marked; number [own, plan] int32 is room for the new numbers."""
    for own in range(len(model.sizes)):
        kept = 0
        for plan in range(upper.count[own]):
            number[own, plan] = kept
            if used[own, plan]:
                for slot in range(model.sizes[own]):
                    upper.vectors[own, slot, kept] = upper.vectors[own, slot, plan]
                upper.action[own, kept] = upper.action[own, plan]
                upper.follow[own, kept] = upper.follow[own, plan]
                kept += 1
        upper.count[own] = kept
    for own in range(len(model.sizes)):
        for plan in range(upper.count[own]):
            if upper.action[own, plan] != NONE:
                mine = model.next_own[own, upper.action[own, plan]]
                upper.follow[own, plan] = number[mine, upper.follow[own, plan]]
        for cell in range(upper.seen.shape[1]):
            action = upper.seen_action[own, cell]
            if model.slots[own, cell] == NONE and action != NONE:
                follow = upper.seen_follow[own, cell]
                upper.seen_follow[own, cell] = number[model.next_own[own, action], follow]
