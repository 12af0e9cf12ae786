"""The arguments of the kernels of `HiddenCell`: the game, its two bounds and scratch memory."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

NONE, MIXED = -1, -2
"""Values of `seen` for beliefs over cells out of view, and over cells in view and out of view; NONE
also stands for no slot, action or plan."""


class Model(NamedTuple):
    """The game.

    Attributes:
        next_own: [own, action] int32, the own cell after the action.
        useful: [own, action] bool, False if an earlier action has the same effect.
        targets: [own, action, hidden, branch] int32, the possible next hidden cells.
        chances: of the same shape, float64, their probabilities; with the rest the game ends.
        costs: [own, action, hidden] float64, expected cost of the step.
        slots: [own, hidden] int32, the slot of a cell; NONE where own sees it.
        cells: [own, slots] int32, the cell in a slot.
        sizes: [own] int32, number of slots.
        discount: of every step, below 1.
    """

    next_own: Any
    useful: Any
    targets: Any
    chances: Any
    costs: Any
    slots: Any
    cells: Any
    sizes: Any
    discount: Any


class LowerBound(NamedTuple):
    """A lower bound of the costs.

    Attributes:
        seen: [own, hidden] float64, the bound where the cell is known.
        informed: [own, action, slot] float64, the fast informed bound of the action.
        inverse: [own, slot, point] float64, the inverse weights of the points.
        value: [own, point] float64, the bound at the point.
        first: [own, action, point] float64, the fast informed bound at the point.
        count: [own] int64, number of points.
    """

    seen: Any
    informed: Any
    inverse: Any
    value: Any
    first: Any
    count: Any


class UpperBound(NamedTuple):
    """An upper bound of the costs: those of plans, each an action and a plan that follows it.

    Attributes:
        seen: [own, hidden] float64, the bound if the cell is known.
        seen_action, seen_follow: [own, hidden] int32, the action then, and the plan after it.
        vectors: [own, slot, plan] float64, the cost by the hidden cell.
        action, follow: [own, plan] int32. The first plan is a random walk, with action NONE.
        count: [own] int64, number of plans.
    """

    seen: Any
    seen_action: Any
    seen_follow: Any
    vectors: Any
    action: Any
    follow: Any
    count: Any


class Workspace(NamedTuple):
    """Scratch memory; the arrays by action hold the results of `look`.

    Attributes:
        after: [action, slot] float64, the weights after the action, out of view.
        arrived: [action, hidden] float64, the weights in view.
        weights: [slot]; ratio, least: [point]; product: [plan], of one bound.
        cost: [action] float64, of the step.
        low, up, hidden_low, hidden_up: [action] float64; all, and the share out of view.
        plan: [action] int64, the best plan after the action.
        own, seen: [depth] int64; belief: [depth, hidden] float64: the path of a trial.
    """

    after: Any
    arrived: Any
    weights: Any
    ratio: Any
    least: Any
    product: Any
    cost: Any
    low: Any
    up: Any
    hidden_low: Any
    hidden_up: Any
    plan: Any
    own: Any
    seen: Any
    belief: Any


def workspace_for(model: Model, points: int, plans: int, depth: int) -> Workspace:
    """Scratch memory for so many points and plans of an own cell, and for trials of this depth."""
    _, actions, hidden = model.costs.shape
    slots = model.cells.shape[1]
    by_action = ("cost", "low", "up", "hidden_low", "hidden_up", "plan")
    shapes: dict[str, int | tuple[int, int]] = {
        **dict.fromkeys(by_action, actions),
        **dict.fromkeys(("ratio", "least"), points),
        **dict.fromkeys(("own", "seen"), depth),
        "after": (actions, slots),
        "arrived": (actions, hidden),
        "weights": slots,
        "product": plans,
        "belief": (depth, hidden),
    }
    whole = ("plan", "own", "seen")
    kinds = {name: np.int64 if name in whole else np.float64 for name in shapes}
    return Workspace(**{name: np.zeros(shape, kinds[name]) for name, shape in shapes.items()})


class Roots(NamedTuple):
    """Own cells and beliefs with bounds: own [roots], belief [roots, hidden], seen [roots] (a cell,
    NONE or MIXED), weight [roots], the bounds low, up [roots], credit [roots] (order of trials).
    """

    own: Any
    belief: Any
    seen: Any
    weight: Any
    low: Any
    up: Any
    credit: Any
