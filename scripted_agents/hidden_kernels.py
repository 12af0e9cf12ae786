"""Compiled kernels of `HiddenCell`: bounds of games in which one cell is hidden, and their search.

*Own* knows its own cell; the other cell is hidden, but in cells that are seen from the own one it
is known. So whoever plays stands in a cell with a *belief*: weights over the hidden cells. The cost
of a belief is the least expected one; it is a concave function of the weights, and of degree 1 in
them, so beliefs need not sum to 1, and a belief costs at least as much as its parts.

Beliefs over cells out of view are kept by *slots*: of the cells that own does not see they are the
first, the second and so on. Arrays end in the number of the point or vector, so that a processor
does many of them at a time.
"""

from __future__ import annotations

from typing import Any

from pursuit.compiled import compiled, subroutine

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
def lower_at(lower: Any, own: int, size: int, weights: Any, room: Any, skip: int) -> Any:
    """A lower bound of the cost of these weights by slot; the point `skip` is left out.

    The weights hold so much of a point, left in room.ratio, and the rest costs its informed bound
    at least. (Sawtooth: Hauskrecht, 2000; there the rest costs what its single cells do.)
    """
    count, ratio, least = lower.count[own], room.ratio, room.least
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
def upper_at(upper: Any, own: int, size: int, weights: Any, room: Any) -> Any:
    """The best plan for these weights by slot; its cost is left in room.product."""
    count, product = upper.count[own], room.product
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
def look(model: Any, lower: Any, upper: Any, room: Any, own: int, belief: Any) -> None:
    """Look one step ahead from a belief [hidden]: both bounds of every useful action."""
    for action in range(model.next_own.shape[1]):
        room.low[action], room.up[action] = 1e300, 1e300
        if not model.useful[own, action]:
            continue
        mine = model.next_own[own, action]
        size, after = model.sizes[mine], room.after[action]
        for slot in range(size):
            after[slot] = 0.0
        cost = low = up = 0.0
        for cell in range(belief.shape[0]):
            weight = belief[cell]
            if weight <= 0.0:
                continue
            cost += weight * model.costs[own, action, cell]
            for branch in range(model.targets.shape[3]):
                chance = weight * model.chances[own, action, cell, branch]
                if chance > 0.0:
                    target = model.targets[own, action, cell, branch]
                    slot = model.slots[mine, target]
                    if slot == NONE:
                        low += chance * lower.seen[mine, target]
                        up += chance * upper.seen[mine, target]
                    else:
                        after[slot] += chance
        mass = 0.0
        for slot in range(size):
            mass += after[slot]
        room.hidden_low[action] = room.hidden_up[action] = 0.0
        room.plan[action] = 0
        if mass > 0.0:
            room.hidden_low[action] = lower_at(lower, mine, size, after, room, NONE)
            plan = upper_at(upper, mine, size, after, room)
            room.plan[action], room.hidden_up[action] = plan, room.product[plan]
        room.low[action] = cost + model.discount * (low + room.hidden_low[action])
        room.up[action] = cost + model.discount * (up + room.hidden_up[action])


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
        chance = model.chances[own, action, cell, branch]
        if chance > 0.0:
            target = model.targets[own, action, cell, branch]
            slot = model.slots[mine, target]
            if slot == NONE:
                mean += chance * upper.seen[mine, target]
            else:
                mean += chance * upper.vectors[mine, slot, follow]
    return model.costs[own, action, cell] + model.discount * mean


# -- improving them --------------------------------------------------------------------------------


@subroutine
def add_point(
    model: Any, lower: Any, room: Any, own: int, belief: Any, value: float, gain: float
) -> None:
    """Note that this belief, with the sum 1, costs at least `value`, if that is news by `gain`."""
    size = model.sizes[own]
    for slot in range(size):
        room.rest[slot] = belief[model.cells[own, slot]]
    known = lower_at(lower, own, size, room.rest, room, NONE)
    if value <= known + gain:
        return
    index = lower.count[own]
    for i in range(index):  # ratios of the one level that was looked at: 1 is the same belief
        if room.ratio[i] > 1.0 - SAME:
            index = i
            break
    if index == lower.value.shape[1]:
        return
    if index == lower.count[own]:
        lower.count[own] += 1
        for slot in range(size):
            weight = belief[model.cells[own, slot]]
            lower.inverse[own, slot, index] = 1.0 / weight if weight > 0.0 else NO_LIMIT
        for action in range(lower.informed.shape[1]):
            dot = 0.0
            for slot in range(size):
                weight = belief[model.cells[own, slot]]
                dot += weight * lower.informed[own, action, slot]
            lower.first[own, action, index] = dot
        lower.value[own, index] = value
    lower.value[own, index] = max(lower.value[own, index], value)


@subroutine
def add_plan(
    model: Any, upper: Any, room: Any, own: int, belief: Any, action: int, gain: float
) -> None:
    """Note the plan that `look` found to begin with `action`, if it is better here by `gain`."""
    size, index = model.sizes[own], upper.count[own]
    if index == upper.action.shape[1]:
        return
    for slot in range(size):
        room.rest[slot] = belief[model.cells[own, slot]]
    best = upper_at(upper, own, size, room.rest, room)
    if room.up[action] >= room.product[best] - gain:
        return
    follow = room.plan[action]
    for slot in range(size):
        cell = model.cells[own, slot]
        upper.vectors[own, slot, index] = plan_cost(model, upper, own, cell, action, follow)
    upper.action[own, index], upper.follow[own, index] = action, follow
    upper.count[own] += 1


@subroutine
def update_seen(model: Any, lower: Any, upper: Any, room: Any, own: int, cell: int) -> None:
    """Improve both bounds where the other is known to be in `cell`, from what `look` found."""
    lower.seen[own, cell] = max(lower.seen[own, cell], room.low[least_of(room.low)])
    action = least_of(room.up)
    if room.up[action] < upper.seen[own, cell]:
        upper.seen[own, cell] = room.up[action]
        upper.seen_action[own, cell], upper.seen_follow[own, cell] = action, room.plan[action]


@subroutine
def update_hidden(model: Any, lower: Any, upper: Any, room: Any, own: int, belief: Any) -> None:
    """Improve both bounds at a belief out of view, from what `look` found."""
    low, action = room.low[least_of(room.low)], least_of(room.up)
    gain = LEAST_GAIN * max(room.up[action] - low, 0.0)
    add_plan(model, upper, room, own, belief, action, gain)
    add_point(model, lower, room, own, belief, low, gain)


@subroutine
def descend(
    model: Any, lower: Any, upper: Any, room: Any, own: int, belief: Any, depth: int, allowed: float
) -> Any:
    """Put what adds most to the distance of the bounds into the next place of the way.

    That is of what follows the action that may be best. A distance of `allowed` is small enough;
    returns False where none is larger.
    """
    action = least_of(room.low)
    mine, arrived = model.next_own[own, action], room.arrived
    for cell in range(belief.shape[0]):
        arrived[cell] = 0.0
    for cell in range(belief.shape[0]):
        if belief[cell] > 0.0:
            for branch in range(model.targets.shape[3]):
                target = model.targets[own, action, cell, branch]
                chance = model.chances[own, action, cell, branch]
                if chance > 0.0 and model.slots[mine, target] == NONE:
                    arrived[target] += belief[cell] * chance
    best, most = NONE, 0.0
    for cell in range(belief.shape[0]):
        if arrived[cell] > 0.0:
            excess = upper.seen[mine, cell] - lower.seen[mine, cell] - allowed
            if arrived[cell] * excess > most:
                best, most = cell, arrived[cell] * excess
    size, after, mass = model.sizes[mine], room.after[action], 0.0
    for slot in range(size):
        mass += after[slot]
    excess = room.hidden_up[action] - room.hidden_low[action] - mass * allowed
    following = room.belief[depth + 1]
    room.own[depth + 1] = mine
    following[:] = 0.0
    if excess > most:
        room.seen[depth + 1] = NONE
        kept = 0.0
        for slot in range(size):
            if after[slot] > NEGLIGIBLE * mass:
                kept += after[slot]
        for slot in range(size):
            if after[slot] > NEGLIGIBLE * mass:
                following[model.cells[mine, slot]] = after[slot] / kept
        return True
    if best != NONE:
        room.seen[depth + 1] = best
        following[best] = 1.0
    return best != NONE


@subroutine
def explore(model: Any, lower: Any, upper: Any, room: Any, epsilon: float) -> Any:
    """One trial from the first place of the way: down to where the bounds are close enough, given
    that they are to be within `epsilon` at the start, and up again, improving them. Returns its
    length. Heuristic search value iteration: Smith and Simmons (2004, 2005).
    """
    depth, allowed = 0, epsilon
    while depth + 1 < len(room.own):
        own, belief = room.own[depth], room.belief[depth]
        look(model, lower, upper, room, own, belief)
        allowed /= model.discount
        if not descend(model, lower, upper, room, own, belief, depth, allowed):
            break
        depth += 1
    for place in range(depth, -1, -1):
        own, belief = room.own[place], room.belief[place]
        look(model, lower, upper, room, own, belief)
        if room.seen[place] != NONE:
            update_seen(model, lower, upper, room, own, room.seen[place])
        else:
            update_hidden(model, lower, upper, room, own, belief)
    return depth + 1


@compiled
def search(
    model: Any, lower: Any, upper: Any, room: Any, roots: Any, share: float, looks: int
) -> Any:
    """Trials from the roots, in turn by what they add to the distance of the mean's bounds, each to
    halve (or take to that `share`) the distance at its root; until so many `looks` are taken.
    """
    done = trials = 0
    while done < looks:
        total, best = 0.0, 0
        for root in range(len(roots.own)):
            distance = roots.weight[root] * max(roots.up[root] - roots.low[root], 0.0)
            roots.credit[root] += distance
            total += distance
            if roots.credit[root] > roots.credit[best]:
                best = root
        roots.credit[best] -= total
        if total <= 0.0:
            break
        room.own[0], room.seen[0] = roots.own[best], roots.seen[best]
        for cell in range(room.belief.shape[1]):
            room.belief[0, cell] = roots.belief[best, cell]
        epsilon = share * (roots.up[best] - roots.low[best])
        done += explore(model, lower, upper, room, epsilon)
        trials += 1
        # What `look` found last is the root.
        roots.low[best] = max(roots.low[best], room.low[least_of(room.low)])
        roots.up[best] = min(roots.up[best], room.up[least_of(room.up)])
    return trials


# -- keeping them small and sharp ------------------------------------------------------------------


@compiled
def improve(model: Any, lower: Any, upper: Any, room: Any, places: Any) -> Any:
    """Look at all places, which are like roots, and improve both bounds there; but with `seen`
    MIXED (a belief over cells of both kinds) only look. Returns the largest change of their bounds.
    """
    change = 0.0
    for place in range(len(places.own)):
        own, belief = places.own[place], places.belief[place]
        look(model, lower, upper, room, own, belief)
        low, up = room.low[least_of(room.low)], room.up[least_of(room.up)]
        change = max(change, low - places.low[place], places.up[place] - up)
        places.low[place] = max(places.low[place], low)
        places.up[place] = min(places.up[place], up)
        if places.seen[place] >= 0:
            update_seen(model, lower, upper, room, own, places.seen[place])
        elif places.seen[place] == NONE:
            update_hidden(model, lower, upper, room, own, belief)
    return change


@compiled
def prune_points(model: Any, lower: Any, room: Any, own: int, slack: float) -> None:
    """Drop the points that add less than `slack` to what the others say, one after the other."""
    size, point = model.sizes[own], 0
    while point < lower.count[own]:
        for slot in range(size):
            inverse = lower.inverse[own, slot, point]
            room.rest[slot] = 1.0 / inverse if inverse < NO_LIMIT else 0.0
        known = lower_at(lower, own, size, room.rest, room, point)
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
def mark_best(model: Any, lower: Any, upper: Any, room: Any, roots: Any, used: Any) -> None:
    """Mark in used [own, plan] the plans that are best at a point or at a root."""
    used[:] = False
    belief = room.rest
    for own in range(len(model.sizes)):
        size = model.sizes[own]
        for point in range(lower.count[own]):
            for slot in range(size):
                inverse = lower.inverse[own, slot, point]
                belief[slot] = 1.0 / inverse if inverse < NO_LIMIT else 0.0
            used[own, upper_at(upper, own, size, belief, room)] = True
    for root in range(len(roots.own)):
        own = roots.own[root]
        if roots.seen[root] == NONE:
            for slot in range(model.sizes[own]):
                belief[slot] = roots.belief[root, model.cells[own, slot]]
            used[own, upper_at(upper, own, model.sizes[own], belief, room)] = True
