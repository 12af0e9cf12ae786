"""Compiled kernels of the agents that play by a belief: where the other may be, and what to do.

Arrays as in `hidden_layout`; `plans` are `hidden_search.Plans`.
"""

from __future__ import annotations

from typing import Any

from pursuit.compiled import compiled, subroutine

NONE = -1


@subroutine
def follow(
    model: Any, belief: Any, before: int, own: int, seen: int, start: Any, rest: Any
) -> None:
    """What is known of the other cell after a step: Bayes' rule, exactly.

    Args:
        belief: [hidden], before the step and after it.
        before: own cell before the step; NONE at the start.
        own: own cell now.
        seen: the cell where the other is seen, or NONE.
        start: [hidden], what is believed at the start, and wherever what was believed cannot be.
        rest: [hidden], room.
    """
    rest[:] = 0.0
    mass = 0.0
    if seen != NONE:
        rest[seen] = mass = 1.0
    elif before != NONE:
        taken = NONE
        for action in range(model.next_own.shape[1] - 1, -1, -1):
            if model.next_own[before, action] == own:
                taken = action
        for cell in range(len(belief)):
            if taken != NONE and belief[cell] > 0.0:
                for branch in range(model.targets.shape[3]):
                    chance = belief[cell] * model.chances[before, taken, cell, branch]
                    target = model.targets[before, taken, cell, branch]
                    if model.slots[own, target] != NONE:
                        rest[target] += chance
                        mass += chance
    for cell in range(len(belief)):
        belief[cell] = rest[cell] / mass if mass > 1e-290 else start[cell]


@subroutine
def best_action(model: Any, plans: Any, own: int, belief: Any, after: Any, product: Any) -> Any:
    """The action with the least upper bound one step ahead, the first where several are."""
    best, least = 0, 1e300
    for action in range(model.next_own.shape[1]):
        if not model.useful[own, action]:
            continue
        mine = model.next_own[own, action]
        size, cost, later = model.sizes[mine], 0.0, 0.0
        for slot in range(size):
            after[slot] = 0.0
        for cell in range(len(belief)):
            if belief[cell] > 0.0:
                cost += belief[cell] * model.costs[own, action, cell]
                for branch in range(model.targets.shape[3]):
                    chance = belief[cell] * model.chances[own, action, cell, branch]
                    target = model.targets[own, action, cell, branch]
                    slot = model.slots[mine, target]
                    if slot == NONE:
                        later += chance * plans.seen[mine, target]
                    else:
                        after[slot] += chance
        count, hidden = plans.sizes[mine] if size > 0 else 0, 1e300 if size > 0 else 0.0
        for plan in range(count):
            product[plan] = 0.0
        for slot in range(size):
            weight, line = after[slot], plans.vectors[mine, slot]
            if weight > 0.0:
                for plan in range(count):
                    product[plan] += weight * line[plan]
        for plan in range(count):
            hidden = min(hidden, product[plan])
        value = cost + model.discount * (later + hidden)
        if value < least:
            best, least = action, value
    return best


@compiled
def play_beliefs(
    model: Any,
    plans: Any,
    starts: Any,
    own: Any,
    seen: Any,
    over: Any,
    rows: Any,
    beliefs: Any,
    before: Any,
    epsilon: Any,
    chance: Any,
    which: Any,
    rest: Any,
    after: Any,
    product: Any,
    actions: Any,
) -> None:
    """Follow and act in games; own, seen, over, rows, epsilon, chance, which, actions are [games].

    starts: [own, hidden]; beliefs [batch, hidden] and before [batch] are remembered, by rows. With
    the probability epsilon one of the moves that change the cell, decided by the uniform numbers
    `chance` and `which`. Games that are `over` are left alone.
    """
    for game in range(len(own)):
        row, cell = rows[game], own[game]
        if over[game]:
            actions[game] = 0
            continue
        belief = beliefs[row]
        follow(model, belief, before[row], cell, seen[game], starts[cell], rest)
        before[row] = cell
        if chance[game] >= epsilon[game]:
            actions[game] = best_action(model, plans, cell, belief, after, product)
            continue
        moves = 0
        for action in range(4):
            moves += model.next_own[cell, action] != cell
        actions[game] = 0  # of an enclosed cell, from which no move leads away
        pick = int(which[game] * moves)
        for action in range(4):
            if model.next_own[cell, action] != cell:
                if pick == 0:
                    actions[game] = action
                pick -= 1
