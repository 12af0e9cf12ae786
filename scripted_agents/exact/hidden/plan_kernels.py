"""Compiled kernels that remove plans of `HiddenSearch` that are no longer used.

A plan is an action, and a plan to follow while the other cell is not seen; if it is seen, the plan
of that cell starts. So plans are the states of a finite-state controller. All costs stay valid if
no plan is removed that another one leads to. Arrays as in `layout`.
"""

from __future__ import annotations

from typing import Any

from pursuit.compilation.compiled import compiled
from scripted_agents.exact.hidden.layout import NONE


@compiled
def mark_followed(model: Any, upper: Any, used: Any) -> None:
    """Mark in used [own, plan] the random walks, plans after seen cells, and their successors."""
    for own in range(len(model.sizes)):
        used[own, 0] = True
        for cell in range(upper.seen.shape[1]):
            action = upper.seen_action[own, cell]
            if model.slots[own, cell] == NONE and action != NONE:
                used[model.next_own[own, action], upper.seen_follow[own, cell]] = True
    changed = True
    while changed:
        changed = False
        for own in range(len(model.sizes)):
            for plan in range(upper.count[own]):
                if used[own, plan] and upper.action[own, plan] != NONE:
                    mine = model.next_own[own, upper.action[own, plan]]
                    follow = upper.follow[own, plan]
                    changed |= not used[mine, follow]
                    used[mine, follow] = True


@compiled
def drop_plans(model: Any, upper: Any, used: Any, number: Any) -> None:
    """Remove the plans that are not marked; number [own, plan] int32 is filled with new indices."""
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
