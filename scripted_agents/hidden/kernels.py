"""Compiled kernels of `HiddenCell`: bounds of games in which one cell is hidden, and their search.

*Own* knows its own cell; the other cell is hidden, but in cells that are seen from the own one it
is known. So the player has a cell and a *belief*: weights over the hidden cells. The cost
of a belief is the least expected one; it is a concave function of the weights, and of degree 1 in
them, so beliefs need not sum to 1, and a belief costs at least as much as its parts.

Beliefs over cells out of view are kept by *slots*: of the cells that own does not see they are the
first, the second and so on. Arrays end in the number of the point or vector, so that a processor
does many of them at a time.
"""

from __future__ import annotations

from typing import Any

from pursuit.compilation.compiled import compiled, subroutine

NONE, MIXED = -1, -2

NO_LIMIT = 1e300
"""The inverse of a weight of 0: it never limits how much of a point there is in a belief."""

LEAST = 1e-200
"""Stands for a weight of 0 where it is multiplied by an inverse."""

NEGLIGIBLE = 1e-6
"""Shares of a belief below this are left out of the beliefs that are looked at further."""

SAME = 1e-12
"""Beliefs that differ by no more are one point; what that can change is in the margin."""

LEAST_GAIN = 1e-3
"""Share of the distance of the bounds at a belief by which a point or a plan must improve them."""


# -- the two bounds --------------------------------------------------------------------------------


@subroutine
def lower_at(lower: Any, own: int, size: int, weights: Any, work: Any, skip: int) -> Any:
    """A lower bound of the cost of these weights by slot; the point `skip` is left out.

    The weights hold so much of a point, left in work.ratio, and the rest costs its informed bound
    at least. (Sawtooth: Hauskrecht, 2000; there the rest costs what its single cells do.)
    """
    count, ratio, least = lower.count[own], work.ratio, work.least
    for i in range(count):
        ratio[i], least[i] = 1e300, 1e300
    for slot in range(size):
        weight, line = max(weights[slot], LEAST), lower.inverse[own, slot]
        for i in range(count):
            share = weight * line[i]
            ratio[i] = share if share < ratio[i] else ratio[i]
    most = 1e300
    for action in range(lower.informed.shape[1]):
        line, first, dot = lower.informed[own, action], lower.first[own, action], 0.0
        for slot in range(size):
            dot += weights[slot] * line[slot]
        most = min(most, dot)
        for i in range(count):
            value = dot - ratio[i] * first[i]
            least[i] = value if value < least[i] else least[i]
    for i in range(count):
        value = least[i] + ratio[i] * lower.value[own, i]
        if value > most and i != skip:
            most = value
    return most


@subroutine
def upper_at(upper: Any, own: int, size: int, weights: Any, work: Any) -> Any:
    """The best plan for these weights by slot; its cost is left in work.product."""
    count, product = upper.count[own], work.product
    for j in range(count):
        product[j] = 0.0
    for slot in range(size):
        weight, line = weights[slot], upper.vectors[own, slot]
        if weight > 0.0:
            for j in range(count):
                product[j] += weight * line[j]
    best = 0
    for j in range(count):
        if product[j] < product[best]:
            best = j
    return best


@subroutine
def upper_after(model: Any, upper: Any, work: Any, own: int, action: int, belief: Any) -> Any:
    """The upper bound of a belief [hidden] with this action first.

    Leaves where the other may be then in work.arrived and work.after, and the cost of the
    step in work.cost.
    """
    arrived, after = work.arrived[action], work.after[action]
    mine, cost, up = model.next_own[own, action], 0.0, 0.0
    arrived[:] = 0.0
    after[:] = 0.0
    for cell in range(belief.shape[0]):
        weight = belief[cell]
        if weight > 0.0:
            cost += weight * model.costs[own, action, cell]
            for branch in range(model.targets.shape[3]):
                chance = weight * model.chances[own, action, cell, branch]
                target = model.targets[own, action, cell, branch]
                slot = model.slots[mine, target]
                if slot == NONE:
                    arrived[target] += chance
                else:
                    after[slot] += chance
    for cell in range(belief.shape[0]):
        up += arrived[cell] * upper.seen[mine, cell]
    work.cost[action], work.plan[action], work.hidden_up[action] = cost, 0, 0.0
    if after.sum() > 0.0:
        plan = upper_at(upper, mine, model.sizes[mine], after, work)
        work.plan[action], work.hidden_up[action] = plan, work.product[plan]
    return cost + model.discount * (up + work.hidden_up[action])


@subroutine
def look(model: Any, lower: Any, upper: Any, work: Any, own: int, belief: Any) -> None:
    """Look one step ahead from a belief [hidden]: both bounds of every useful action."""
    for action in range(model.next_own.shape[1]):
        work.low[action], work.up[action] = 1e300, 1e300
        if not model.useful[own, action]:
            continue
        work.up[action] = upper_after(model, upper, work, own, action, belief)
        mine, arrived, after = (
            model.next_own[own, action],
            work.arrived[action],
            work.after[action],
        )
        low = hidden = 0.0
        for cell in range(belief.shape[0]):
            low += arrived[cell] * lower.seen[mine, cell]
        if after.sum() > 0.0:
            hidden = lower_at(lower, mine, model.sizes[mine], after, work, NONE)
        work.hidden_low[action] = hidden
        work.low[action] = work.cost[action] + model.discount * (low + hidden)


@compiled
def choose_actions(model: Any, upper: Any, work: Any, own: Any, beliefs: Any, moves: Any) -> None:
    """Fill `moves` [games] with the bit of the action of the least upper bound one step ahead.

    That is the first of them where several are; own [games] and beliefs [games, hidden].
    """
    for game in range(len(own)):
        for action in range(model.next_own.shape[1]):
            work.up[action] = 1e300
            if model.useful[own[game], action]:
                work.up[action] = upper_after(model, upper, work, own[game], action, beliefs[game])
        moves[game] = 1 << least_of(work.up)


@subroutine
def least_of(values: Any) -> Any:
    """The number of the least of them, the first where several are."""
    best = 0
    for i in range(len(values)):
        if values[i] < values[best]:
            best = i
    return best


@subroutine
def plan_cost(model: Any, upper: Any, own: int, cell: int, action: int, follow: int) -> Any:
    """What an action and a plan after it cost where the hidden cell is this one."""
    mine, mean = model.next_own[own, action], 0.0
    for branch in range(model.targets.shape[3]):
        target = model.targets[own, action, cell, branch]
        slot = model.slots[mine, target]
        known = upper.seen[mine, target] if slot == NONE else upper.vectors[mine, slot, follow]
        mean += model.chances[own, action, cell, branch] * known
    return model.costs[own, action, cell] + model.discount * mean


# -- improving them --------------------------------------------------------------------------------


@subroutine
def add_point(model: Any, lower: Any, work: Any, own: int, value: float, gain: float) -> None:
    """Note that the belief in work.rest costs at least `value`, if that is news by `gain`."""
    size, weights, index = model.sizes[own], work.rest, lower.count[own]
    known = lower_at(lower, own, size, weights, work, NONE)
    if value <= known + gain:
        return
    for i in range(lower.count[own]):  # a ratio of 1 is the same belief
        if work.ratio[i] > 1.0 - SAME:
            index = i
            break
    if index == lower.value.shape[1]:
        return
    if index == lower.count[own]:
        lower.count[own] += 1
        for slot in range(size):
            weight = weights[slot]
            lower.inverse[own, slot, index] = 1.0 / weight if weight > 0.0 else NO_LIMIT
        for action in range(lower.informed.shape[1]):
            dot = 0.0
            for slot in range(size):
                dot += weights[slot] * lower.informed[own, action, slot]
            lower.first[own, action, index] = dot
        lower.value[own, index] = value
    lower.value[own, index] = max(lower.value[own, index], value)


@subroutine
def add_plan(model: Any, upper: Any, work: Any, own: int, action: int, gain: float) -> None:
    """Note the plan that `look` found to begin with `action`, if it costs the belief in work.rest
    less by `gain`."""
    size, index, follow = model.sizes[own], upper.count[own], work.plan[action]
    if index == upper.action.shape[1]:
        return
    best = upper_at(upper, own, size, work.rest, work)
    if work.up[action] >= work.product[best] - gain:
        return
    for slot in range(size):
        cell = model.cells[own, slot]
        upper.vectors[own, slot, index] = plan_cost(model, upper, own, cell, action, follow)
    upper.action[own, index], upper.follow[own, index] = action, follow
    upper.count[own] += 1


@subroutine
def update(model: Any, lower: Any, upper: Any, work: Any, own: int, seen: int, belief: Any) -> None:
    """Improve both bounds from what `look` found, where the other is seen in the cell `seen`, or at
    a belief out of view (NONE) with the sum 1."""
    low, action = work.low[least_of(work.low)], least_of(work.up)
    if seen == NONE:
        for slot in range(model.sizes[own]):
            work.rest[slot] = belief[model.cells[own, slot]]
        gain = LEAST_GAIN * max(work.up[action] - low, 0.0)
        add_plan(model, upper, work, own, action, gain)
        add_point(model, lower, work, own, low, gain)
        return
    lower.seen[own, seen] = max(lower.seen[own, seen], low)
    if work.up[action] < upper.seen[own, seen]:
        upper.seen[own, seen] = work.up[action]
        upper.seen_action[own, seen], upper.seen_follow[own, seen] = action, work.plan[action]


@subroutine
def descend(
    model: Any, lower: Any, upper: Any, work: Any, own: int, depth: int, allowed: float
) -> Any:
    """Put what adds most to the distance of the bounds into the next place of the way.

    That is of what follows the action that may be best. A distance of `allowed` is small enough;
    returns False where none is larger.
    """
    action = least_of(work.low)
    mine, arrived, after = (model.next_own[own, action], work.arrived[action], work.after[action])
    best, most = NONE, 0.0
    for cell in range(len(arrived)):
        if arrived[cell] > 0.0:
            excess = upper.seen[mine, cell] - lower.seen[mine, cell] - allowed
            if arrived[cell] * excess > most:
                best, most = cell, arrived[cell] * excess
    size, mass = model.sizes[mine], after.sum()
    excess = work.hidden_up[action] - work.hidden_low[action] - mass * allowed
    following = work.belief[depth + 1]
    work.own[depth + 1] = mine
    following[:] = 0.0
    if excess > most:
        work.seen[depth + 1] = NONE
        kept = 0.0
        for slot in range(size):
            if after[slot] > NEGLIGIBLE * mass:
                kept += after[slot]
        for slot in range(size):
            if after[slot] > NEGLIGIBLE * mass:
                following[model.cells[mine, slot]] = after[slot] / kept
        return True
    if best != NONE:
        work.seen[depth + 1] = best
        following[best] = 1.0
    return best != NONE


@compiled
def explore(model: Any, lower: Any, upper: Any, work: Any, epsilon: float) -> Any:
    """One trial from the first place of the way: down to where the bounds are close enough, given
    that they are to be within `epsilon` at the start, and up again, improving them. Returns its
    length; work.low and work.up are of the start then. Heuristic search value iteration: Smith and
    Simmons (2004, 2005).
    """
    depth, allowed = 0, epsilon
    while depth + 1 < len(work.own):
        own, belief = work.own[depth], work.belief[depth]
        look(model, lower, upper, work, own, belief)
        allowed /= model.discount
        if not descend(model, lower, upper, work, own, depth, allowed):
            break
        depth += 1
    for place in range(depth, -1, -1):
        own, belief = work.own[place], work.belief[place]
        look(model, lower, upper, work, own, belief)
        update(model, lower, upper, work, own, work.seen[place], belief)
    return depth + 1


# -- keeping them small and sharp ------------------------------------------------------------------


@compiled
def improve(model: Any, lower: Any, upper: Any, work: Any, places: Any) -> Any:
    """Look at all places, which are like roots, and improve both bounds there; but with `seen`
    MIXED (a belief over cells of both kinds) only look. Returns the largest change of their bounds.
    """
    change = 0.0
    for place in range(len(places.own)):
        own, belief = places.own[place], places.belief[place]
        look(model, lower, upper, work, own, belief)
        low, up = work.low[least_of(work.low)], work.up[least_of(work.up)]
        change = max(change, low - places.low[place], places.up[place] - up)
        places.low[place] = max(places.low[place], low)
        places.up[place] = min(places.up[place], up)
        if places.seen[place] != MIXED:
            update(model, lower, upper, work, own, places.seen[place], belief)
    return change


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
                cost = plan_cost(model, upper, own, model.cells[own, slot], action, follow)
                change = max(change, upper.vectors[own, slot, plan] - cost)
                upper.vectors[own, slot, plan] = min(upper.vectors[own, slot, plan], cost)
    for own in range(len(model.sizes)):
        for cell in range(upper.seen.shape[1]):
            if model.slots[own, cell] == NONE and upper.seen_action[own, cell] != NONE:
                action, follow = upper.seen_action[own, cell], upper.seen_follow[own, cell]
                cost = plan_cost(model, upper, own, cell, action, follow)
                change = max(change, upper.seen[own, cell] - cost)
                upper.seen[own, cell] = min(upper.seen[own, cell], cost)
    return change


@compiled
def prune_points(model: Any, lower: Any, work: Any, own: int, slack: float) -> None:
    """Drop the points that add less than `slack` to what the others say, one after the other."""
    size, point = model.sizes[own], 0
    while point < lower.count[own]:
        for slot in range(size):
            inverse = lower.inverse[own, slot, point]
            work.rest[slot] = 1.0 / inverse if inverse < NO_LIMIT else 0.0
        known = lower_at(lower, own, size, work.rest, work, point)
        if known < lower.value[own, point] - slack:
            point += 1
            continue
        lower.count[own] -= 1
        last = lower.count[own]
        lower.value[own, point] = lower.value[own, last]
        for slot in range(size):
            lower.inverse[own, slot, point] = lower.inverse[own, slot, last]
        for action in range(lower.first.shape[1]):
            lower.first[own, action, point] = lower.first[own, action, last]


@compiled
def mark_best(model: Any, lower: Any, upper: Any, work: Any, roots: Any, used: Any) -> None:
    """Mark in used [own, plan] the plans that are best at a point or at a root."""
    used[:] = False
    belief = work.rest
    for own in range(len(model.sizes)):
        size = model.sizes[own]
        for point in range(lower.count[own]):
            for slot in range(size):
                inverse = lower.inverse[own, slot, point]
                belief[slot] = 1.0 / inverse if inverse < NO_LIMIT else 0.0
            used[own, upper_at(upper, own, size, belief, work)] = True
    for root in range(len(roots.own)):
        own = roots.own[root]
        if roots.seen[root] == NONE:
            for slot in range(model.sizes[own]):
                belief[slot] = roots.belief[root, model.cells[own, slot]]
            used[own, upper_at(upper, own, model.sizes[own], belief, work)] = True
