"""Games of one player in which one cell is hidden: what `HiddenSearch` bounds the cost of."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.memory import check_memory
from pursuit.rules import captured
from pursuit.tasks.task import MOVE_ORDERS
from pursuit.tasks.visibility import visible_cells
from pursuit.validation import (
    as_array,
    check_fields,
    choice,
    count,
    declared,
    finite,
    flag,
    number,
    whole,
)
from scripted_agents.duel.best_response import MoveOrder
from scripted_agents.hidden.layout import Model, Roots

NONE, MIXED = -1, -2
"""In place of the cell where the other is seen: it is not seen; cells of both kinds are possible"""

SUM_TOLERANCE = 1e-9

Role = Literal["chaser", "evader"]


def _radius(name: str, value: Any) -> int | None:
    return None if value is None else whole(name, value)


@dataclass(frozen=True)
class VisibilityRules:
    """What a hidden chase is played by, but for the maze and the opponent.

    Raises:
        ValueError: a value that is not allowed.
    """

    role: Role = choice(("chaser", "evader"), "chaser")
    view_radius: int | None = declared(_radius, None)
    line_of_sight: bool = flag(False)
    discount: float = finite(0.95)
    move_order: MoveOrder = choice(MOVE_ORDERS, "simultaneous")
    stay_action: bool = flag(False)
    min_start_distance: int = count(0, 1)

    def __post_init__(self) -> None:
        check_fields(self)

    def __str__(self) -> str:
        radius = "all" if self.view_radius is None else f"radius {self.view_radius}"
        return f"{radius}{', in line' if self.line_of_sight else ''}, discount {self.discount:g}"


@dataclass(frozen=True, eq=False)
class HiddenCell:
    """A game of one player, *own*, which knows its own cell; the other cell moves by chance.

    At every step own takes an action, which leads to a next own cell for sure, and the other cell
    moves, with chances that depend on both cells and on the action. Then own sees the other cell if
    it is visible from the own one, and knows that it is in none of those if not. So it is a
    partially observable Markov decision process, in which what is not known is one cell.

    Attributes:
        next_own: [own, action] int, the own cell after the action.
        targets: [own, action, hidden, branch] int, where the other cell can come to.
        chances: of that shape, how likely; at most 1 in all. With the rest the game ends.
        costs: [own, action, hidden], expected, of the step.
        visible: [own, hidden] bool, whether own sees that cell.
        discount: what a step counts in terms of the one before it; above 0 and below 1.
        start_cells: [starts] int, own cells at the start.
        start_beliefs: [starts, hidden], the chances of the other cell there: one cell in view, or
            any cells out of view.
        start_weights: [starts], how likely each start is; 1 in all.

    Raises:
        ValueError: arrays that do not fit together, or that are no chances.
    """

    next_own: NDArray[np.int32] = field(repr=False)
    targets: NDArray[np.int32] = field(repr=False)
    chances: NDArray[np.float64] = field(repr=False)
    costs: NDArray[np.float64] = field(repr=False)
    visible: NDArray[np.bool_] = field(repr=False)
    discount: float
    start_cells: NDArray[np.int64] = field(repr=False)
    start_beliefs: NDArray[np.float64] = field(repr=False)
    start_weights: NDArray[np.float64] = field(repr=False)

    def __post_init__(self) -> None:
        kinds: dict[str, Any] = {
            "next_own": np.int32, "targets": np.int32, "chances": np.float64, "costs": np.float64,
            "visible": np.bool_, "start_cells": np.int64, "start_beliefs": np.float64,
            "start_weights": np.float64,
        }  # fmt: skip
        for name, kind in kinds.items():
            given = as_array(name, getattr(self, name), "biuf", "give numbers")
            object.__setattr__(self, name, np.ascontiguousarray(given, dtype=kind))
        if not 0.0 < number("discount", self.discount) < 1.0:
            raise ValueError(f"discount={self.discount}; it lies above 0 and below 1")
        _check_shapes(self)
        _check_chances(self)

    @property
    def starts(self) -> Roots:
        """The starts as the kernels take them, with no bounds yet."""
        return places(self, self.start_cells, self.start_beliefs, self.start_weights)


def _check_shapes(game: HiddenCell) -> None:
    own, hidden = game.visible.shape if game.visible.ndim == 2 else (0, 0)
    actions = game.next_own.shape[1] if game.next_own.ndim == 2 else 0
    branches = game.targets.shape[3] if game.targets.ndim == 4 else 0
    starts = len(game.start_cells)
    needed = {
        "next_own": (own, actions),
        "targets": (own, actions, hidden, branches),
        "chances": (own, actions, hidden, branches),
        "costs": (own, actions, hidden),
        "start_cells": (starts,),
        "start_beliefs": (starts, hidden),
        "start_weights": (starts,),
    }
    for name, shape in needed.items():
        if getattr(game, name).shape != shape or 0 in shape:
            raise ValueError(
                f"{name} has shape {getattr(game, name).shape}; beside visible "
                f"{game.visible.shape} and next_own {game.next_own.shape} it needs {shape}, "
                "with nothing empty"
            )
    for name, most in (("next_own", own), ("targets", hidden), ("start_cells", own)):
        cells = getattr(game, name)
        if cells.min() < 0 or cells.max() >= most:
            raise ValueError(f"{name} names cells from 0 to {most - 1}; these reach outside")


def _check_chances(game: HiddenCell) -> None:
    sums = game.chances.sum(axis=3)
    if not (game.chances >= 0.0).all() or not (sums <= 1.0 + SUM_TOLERANCE).all():
        raise ValueError("chances are not negative, and at most 1 for each action and hidden cell")
    if not np.isfinite(game.costs).all():
        raise ValueError("costs are finite")
    beliefs, weights = game.start_beliefs, game.start_weights
    if not (beliefs >= 0.0).all() or not np.allclose(beliefs.sum(axis=1), 1.0, atol=SUM_TOLERANCE):
        raise ValueError("each of start_beliefs is a distribution: not negative, with the sum 1")
    if not (weights >= 0.0).all() or abs(weights.sum() - 1.0) > SUM_TOLERANCE:
        raise ValueError("start_weights are a distribution: not negative, with the sum 1")
    if (game.starts.seen == MIXED).any():
        raise ValueError(
            "each of start_beliefs has one cell in view, or cells out of view only: at the start "
            "the other is seen, or is known not to be where it would be seen"
        )


def places(
    game: HiddenCell,
    own: NDArray[np.int64],
    beliefs: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
) -> Roots:
    """Places to look at: own cells [places] with beliefs [places, hidden]."""
    count, possible = len(own), beliefs > 0.0
    in_view = possible & game.visible[own]
    seen = np.where(in_view.any(axis=1), MIXED, NONE)
    certain = possible.sum(axis=1) == 1
    seen = np.where(certain & in_view.any(axis=1), possible.argmax(axis=1), seen)
    bounds = np.full(count, -np.inf), np.full(count, np.inf)
    weights = np.zeros(count) if weights is None else weights
    return Roots(own, beliefs, seen.astype(np.int64), weights, *bounds, np.zeros(count))


def model_of(game: HiddenCell) -> Model:
    """The game as the kernels take it."""
    hidden = ~game.visible
    sizes = hidden.sum(axis=1).astype(np.int32)
    slots = np.where(hidden, hidden.cumsum(axis=1) - 1, NONE).astype(np.int32)
    cells = np.zeros((len(sizes), max(int(sizes.max()), 1)), dtype=np.int32)
    own, cell = np.nonzero(hidden)
    cells[own, slots[own, cell]] = cell
    useful: NDArray[np.bool_] = np.ones(game.next_own.shape, dtype=bool)
    arrays = game.targets, game.chances, game.costs
    for action in range(game.next_own.shape[1]):
        for earlier in range(action):
            same = game.next_own[:, action] == game.next_own[:, earlier]
            for array in arrays:
                differ = array[:, action] != array[:, earlier]
                same &= ~differ.reshape(len(same), -1).any(axis=1)
            useful[:, action] &= ~same
    return Model(game.next_own, useful, *arrays, slots, cells, sizes, float(game.discount))


def hidden_chase(
    maze: Maze, opponent_table: NDArray[np.float64], rules: VisibilityRules
) -> HiddenCell:
    """A chase as the player of one role meets it, the other playing a table; a step costs 1.

    Of an evader it costs -1. The starts are all ordered pairs of cells that are at least
    `min_start_distance` apart, equally likely: one for each cell in view, one for all that are not.

    Args:
        opponent_table: [self cell, other cell, action], checked.

    Raises:
        ValueError: no two cells are so far apart.
    """
    visible = visible_cells(maze, rules.view_radius, rules.line_of_sight)
    role, num_actions = rules.role, 4 + rules.stay_action
    size, moves = maze.num_cells, maze.neighbors
    # Chances, targets and what they are made of; and a belief for every pair in view.
    check_memory(
        f"{maze.name}, {size} cells,",
        size * size * (5 * 24 * num_actions) + 16 * size * int(visible.sum()),
        "use a smaller maze, or see less",
    )
    own = moves[:, :num_actions].astype(np.int32)
    # Actions of the other: four moves, and waiting (by stay or a wall).
    still = moves[:, :4] == np.arange(size)[:, None]
    table = opponent_table / np.where(
        np.eye(size)[..., None] > 0, 1.0, opponent_table.sum(axis=2)[..., None]
    )
    moving = np.where(still[:, None], 0.0, table[..., :4])
    standing = np.where(still[:, None], table[..., :4], 0.0).sum(axis=2)
    standing += table[..., 4:].sum(axis=2)
    chances = np.concatenate([moving, standing[..., None]], axis=2).transpose(1, 0, 2)
    targets = np.concatenate([moves[:, :4], np.arange(size)[:, None]], axis=1)
    x, h = np.arange(size)[:, None, None, None], np.arange(size)[None, None, :, None]
    mine, theirs = own[:, :, None, None], targets[None, None]
    steps = (x, mine), (h, theirs)
    chaser, evader = steps if role == "chaser" else steps[::-1]
    caught = captured(rules.move_order == "chasers_first", *chaser, *evader)
    shape = (size, num_actions, size, 5)
    apart = np.broadcast_to(x != h, shape)
    chances = np.where(caught | ~apart, 0.0, chances[:, None])
    costs = np.where(apart[..., 0], 1.0 if role == "chaser" else -1.0, 0.0)
    return HiddenCell(
        own,
        np.broadcast_to(theirs, shape),
        chances,
        costs,
        visible,
        rules.discount,
        *_starts(maze, visible, rules.min_start_distance),
    )


def _starts(
    maze: Maze, visible: NDArray[np.bool_], min_start_distance: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    size = maze.num_cells
    pairs = maze.distances >= max(min_start_distance, 1)
    if not pairs.any():
        raise ValueError(
            f"min_start_distance {min_start_distance}: no two cells of {maze.name} are so far "
            f"apart; the longest distance is {maze.longest_distance}"
        )
    own, cell = np.nonzero(pairs & visible)
    hidden = pairs & ~visible
    blind = np.flatnonzero(hidden.any(axis=1))
    cells = np.concatenate([blind, own])
    counts = np.concatenate([hidden[blind].sum(axis=1), np.ones(len(own))])
    beliefs = np.concatenate([hidden[blind].astype(np.float64), np.eye(size)[cell]])
    return cells, beliefs / counts[:, None], counts / counts.sum()
