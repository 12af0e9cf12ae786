"""Compiled kernels of the search for bounds of `HiddenCell`, games with one hidden cell.

The state of the player is its *own* cell and a *belief*: weights over the hidden cell, which is
known if it is visible from the own cell. The cost of a belief is the least expected cost. It is a
concave function of the weights and homogeneous of degree 1, so beliefs need not sum to 1, and a
belief costs at least as much as its parts.

Beliefs over cells out of view are stored by *slot*, the index among the cells that are not visible
from the own cell. The last axis of arrays is the point or vector, for vectorised loops.
"""

from __future__ import annotations

from typing import Any

from pursuit.compilation.compiled import compiled, subroutine
from scripted_agents.exact.hidden.layout import MIXED, NONE

NO_LIMIT = 1e300
"""The inverse of a weight of 0, which never limits the share of a point in a belief."""

LEAST = 1e-200
"""In place of a weight of 0 that is multiplied by an inverse."""

NEGLIGIBLE = 1e-6
"""Smaller shares of a belief are dropped from the beliefs that trials visit."""

SAME = 1e-12
"""Beliefs with a smaller difference are one point; `HiddenSearch.margin` includes the error."""

LEAST_GAIN = 1e-3
"""Least improvement by a new point or plan, as a share of the distance of the bounds there."""


# -- the two bounds --------------------------------------------------------------------------------


@subroutine
def lower_at(lower: Any, own: int, size: int, weights: Any, work: Any, skip: int) -> Any:
    """A lower bound of the cost of these weights by slot, without the point `skip`.

    The weights contain a point `work.ratio` times, and the rest costs at least its informed bound.
    (Sawtooth bound: Hauskrecht, 2000, with the costs of single cells for the rest.)
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
    """The best plan for these weights by slot; costs are stored in work.product."""
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
    """The upper bound of a belief [hidden] with this first action.

    Stores the next belief in work.arrived (in view) and work.after (out of view), and the cost of
    the step in work.cost.
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
    """One-step lookahead from a belief [hidden]: both bounds for every useful action."""
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
    """Fill `moves` [games] with the bit of the action of least upper bound by one-step lookahead.

    Ties are broken by order. Inputs are own [games] and beliefs [games, hidden].
    """
    for game in range(len(own)):
        for action in range(model.next_own.shape[1]):
            work.up[action] = 1e300
            if model.useful[own[game], action]:
                work.up[action] = upper_after(model, upper, work, own[game], action, beliefs[game])
        moves[game] = 1 << least_of(work.up)


@subroutine
def least_of(values: Any) -> Any:
    """The index of the least value, the first of equal ones."""
    best = 0
    for i in range(len(values)):
        if values[i] < values[best]:
            best = i
    return best


@subroutine
def plan_cost(model: Any, upper: Any, own: int, cell: int, action: int, follow: int) -> Any:
    """The cost of an action and a plan after it, for this hidden cell."""
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
    """Add the point work.weights with lower bound `value`, if that improves the bound by `gain`."""
    size, weights, index = model.sizes[own], work.weights, lower.count[own]
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
    """Add the plan of `look` that starts with `action`, if it reduces the cost of the belief
    work.weights by `gain`."""
    size, index, follow = model.sizes[own], upper.count[own], work.plan[action]
    if index == upper.action.shape[1]:
        return
    best = upper_at(upper, own, size, work.weights, work)
    if work.up[action] >= work.product[best] - gain:
        return
    for slot in range(size):
        cell = model.cells[own, slot]
        upper.vectors[own, slot, index] = plan_cost(model, upper, own, cell, action, follow)
    upper.action[own, index], upper.follow[own, index] = action, follow
    upper.count[own] += 1


@subroutine
def update(model: Any, lower: Any, upper: Any, work: Any, own: int, seen: int, belief: Any) -> None:
    """Improve both bounds by the results of `look`, if the other cell is seen in `seen`, or for a
    belief out of view (NONE) with sum 1."""
    low, action = work.low[least_of(work.low)], least_of(work.up)
    if seen == NONE:
        for slot in range(model.sizes[own]):
            work.weights[slot] = belief[model.cells[own, slot]]
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
    """Write the successor that adds most to the distance of the bounds to the next path entry.

    Successors are those of the action with the least lower bound. Returns False if no distance of
    bounds exceeds `allowed`.
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
    """One trial of heuristic search value iteration (Smith and Simmons, 2004, 2005) from the first
    path entry: forward until the bounds are close enough for a distance of `epsilon` at the start,
    then backward with updates. Returns the length of the path; work.low and work.up are those of
    the start.
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
def improve(model: Any, lower: Any, upper: Any, work: Any, roots: Any) -> Any:
    """Look ahead from all roots, and improve both bounds there, except at roots with `seen` MIXED.
    Returns the largest change of the bounds of the roots.
    """
    change = 0.0
    for root in range(len(roots.own)):
        own, belief = roots.own[root], roots.belief[root]
        look(model, lower, upper, work, own, belief)
        low, up = work.low[least_of(work.low)], work.up[least_of(work.up)]
        change = max(change, low - roots.low[root], roots.up[root] - up)
        roots.low[root] = max(roots.low[root], low)
        roots.up[root] = min(roots.up[root], up)
        if roots.seen[root] != MIXED:
            update(model, lower, upper, work, own, roots.seen[root], belief)
    return change


@compiled
def evaluate_plans(model: Any, upper: Any) -> Any:
    """Update the costs of all plans by those of their successors; returns the largest change."""
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
    """Remove points, one by one, that raise the bound of the others by less than `slack`."""
    size, point = model.sizes[own], 0
    while point < lower.count[own]:
        for slot in range(size):
            inverse = lower.inverse[own, slot, point]
            work.weights[slot] = 1.0 / inverse if inverse < NO_LIMIT else 0.0
        known = lower_at(lower, own, size, work.weights, work, point)
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
    belief = work.weights
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
