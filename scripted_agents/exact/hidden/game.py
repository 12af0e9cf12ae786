"""Games of one player with one hidden cell, which `HiddenSearch` solves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.memory import check_memory
from pursuit.rules import captured
from pursuit.tasks.visibility import visible_cells
from pursuit.validation import Flag, Rule, Whole, as_array, check_fields, choice, number, whole
from scripted_agents.exact.duel.best_response import MoveOrder, random_starts
from scripted_agents.exact.hidden.layout import MIXED, NONE, Model, Roots
from scripted_agents.exact.limits import check_duel_order
from scripted_agents.exact.tolerances import SUM_TOLERANCE

Role = Literal["chaser", "evader"]


@dataclass(frozen=True)
class VisibilityRules:
    """The rules of a chase with a limited view, except for maze and opponent.

    Raises:
        ValueError: a value that is not allowed.
    """

    role: Annotated[Role, choice("chaser", "evader")] = "chaser"
    view_radius: Annotated[int | None, Rule(whole)] = None
    line_of_sight: Flag = False
    discount: Annotated[float, Rule(number)] = 0.95
    move_order: MoveOrder = "simultaneous"
    stay_action: Flag = False
    min_start_distance: Whole = 1

    def __post_init__(self) -> None:
        check_fields(self)
        check_duel_order(self.move_order)

    def __str__(self) -> str:
        radius = "all" if self.view_radius is None else f"radius {self.view_radius}"
        return f"{radius}{', in line' if self.line_of_sight else ''}, discount {self.discount:g}"


@dataclass(frozen=True, eq=False)
class HiddenCell:
    """A game of one player, *own* with a known own cell and a partly hidden other cell.

    In every step own takes an action with a deterministic next own cell. The hidden cell moves with
    probabilities that depend on both cells and on the action. Then own observes the hidden cell if
    it is visible from the own cell. This is a partially observable Markov decision process in which
    one cell is unknown.

    Attributes:
        next_own: [own, action] int, the own cell after the action.
        targets: [own, action, hidden, branch] int, the possible next hidden cells.
        chances: of the same shape, their probabilities, with sums of at most 1; with the remaining
            probability the game ends.
        costs: [own, action, hidden], expected cost of the step.
        visible: [own, hidden] bool, whether own sees that cell.
        discount: of each step, above 0 and below 1.
        start_cells: [starts] int, own cells at the start.
        start_beliefs: [starts, hidden], probabilities of the hidden cell at the start: one cell in
            view, or any cells out of view.
        start_weights: [starts], probabilities of the starts, with sum 1.

    Raises:
        ValueError: arrays with inconsistent shapes, or that are no probabilities.
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
            raise ValueError(f"discount={self.discount}; give a number above 0 and below 1")
        _check_shapes(self)
        _check_chances(self)

    @property
    def starts(self) -> Roots:
        """The starts as an argument of kernels, without bounds."""
        return roots_of(self, self.start_cells, self.start_beliefs, self.start_weights)


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
                f"{name} has shape {getattr(game, name).shape}; give {shape}, not empty, to match "
                f"visible {game.visible.shape} and next_own {game.next_own.shape}"
            )
    for name, most in (("next_own", own), ("targets", hidden), ("start_cells", own)):
        cells = getattr(game, name)
        if cells.min() < 0 or cells.max() >= most:
            raise ValueError(
                f"{name} has cells from {cells.min()} to {cells.max()}; give 0 to {most - 1}"
            )


def _check_chances(game: HiddenCell) -> None:
    sums = game.chances.sum(axis=3)
    if not (game.chances >= 0.0).all() or not (sums <= 1.0 + SUM_TOLERANCE).all():
        raise ValueError(
            "chances must not be negative, with sums of at most 1 for each action and hidden cell"
        )
    if not np.isfinite(game.costs).all():
        raise ValueError("costs must be finite")
    beliefs, weights = game.start_beliefs, game.start_weights
    if not (beliefs >= 0.0).all() or not np.allclose(beliefs.sum(axis=1), 1.0, atol=SUM_TOLERANCE):
        raise ValueError("each of start_beliefs must be a distribution: not negative, with sum 1")
    if not (weights >= 0.0).all() or abs(weights.sum() - 1.0) > SUM_TOLERANCE:
        raise ValueError("start_weights must be a distribution: not negative, with sum 1")
    if (game.starts.seen == MIXED).any():
        raise ValueError(
            "each of start_beliefs must have one cell in view, or only cells out of view: a "
            "visible cell is observed at the start"
        )


def roots_of(
    game: HiddenCell,
    own: NDArray[np.int64],
    beliefs: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
) -> Roots:
    """Own cells [n] with beliefs [n, hidden] as an argument of kernels."""
    count, possible = len(own), beliefs > 0.0
    in_view = possible & game.visible[own]
    seen = np.where(in_view.any(axis=1), MIXED, NONE)
    certain = possible.sum(axis=1) == 1
    seen = np.where(certain & in_view.any(axis=1), possible.argmax(axis=1), seen)
    bounds = np.full(count, -np.inf), np.full(count, np.inf)
    weights = np.zeros(count) if weights is None else weights
    return Roots(own, beliefs, seen.astype(np.int64), weights, *bounds, np.zeros(count))


def model_of(game: HiddenCell) -> Model:
    """The game as an argument of kernels."""
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
    """A chase from the view of one role against a table; a step costs 1, or -1 for an evader.

    All ordered pairs of cells at a distance of at least `min_start_distance` are equally likely.
    Each own cell has one start for each cell in view, and one for all cells out of view.

    Args:
        opponent_table: [self cell, other cell, action], checked.

    Raises:
        ValueError: there is no such pair.
    """
    visible = visible_cells(maze, rules.view_radius, rules.line_of_sight)
    role, num_actions = rules.role, maze.num_moves + rules.stay_action
    size, moves = maze.num_cells, maze.neighbors
    # Chances, targets and intermediate arrays; and a belief for every pair in view.
    check_memory(
        f"{maze.name}, {size} cells,",
        size * size * (24 * (maze.num_moves + 1) * num_actions) + 16 * size * int(visible.sum()),
        "use a smaller maze, or a narrower view",
    )
    own = moves[:, :num_actions].astype(np.int32)
    # Actions of the other: moves, and staying (by the stay action or a wall).
    still = moves[:, :-1] == np.arange(size)[:, None]
    table = opponent_table / np.where(
        np.eye(size)[..., None] > 0, 1.0, opponent_table.sum(axis=2)[..., None]
    )
    most = maze.num_moves
    moving = np.where(still[:, None], 0.0, table[..., :most])
    staying = np.where(still[:, None], table[..., :most], 0.0).sum(axis=2)
    staying += table[..., most:].sum(axis=2)
    chances = np.concatenate([moving, staying[..., None]], axis=2).transpose(1, 0, 2)
    targets = np.concatenate([moves[:, :-1], np.arange(size)[:, None]], axis=1)
    x, h = np.arange(size)[:, None, None, None], np.arange(size)[None, None, :, None]
    mine, theirs = own[:, :, None, None], targets[None, None]
    steps = (x, mine), (h, theirs)
    chaser, evader = steps if role == "chaser" else steps[::-1]
    caught = captured(rules.move_order == "chasers_first", *chaser, *evader)
    shape = (size, num_actions, size, most + 1)
    apart = np.broadcast_to(x != h, shape)
    chances = np.where(caught | ~apart, 0.0, chances[:, None])
    costs = np.where(apart[..., 0], 1.0 if role == "chaser" else -1.0, 0.0)
    starts = _starts(maze, role, visible, rules.min_start_distance)
    after = np.broadcast_to(theirs, shape)
    return HiddenCell(own, after, chances, costs, visible, rules.discount, *starts)


def _starts(
    maze: Maze, role: str, visible: NDArray[np.bool_], min_start_distance: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    size = maze.num_cells
    apart = random_starts(maze, min_start_distance)
    pairs = apart if role == "chaser" else apart.T
    own, cell = np.nonzero(pairs & visible)
    hidden = pairs & ~visible
    unseen = np.flatnonzero(hidden.any(axis=1))
    cells = np.concatenate([unseen, own])
    counts = np.concatenate([hidden[unseen].sum(axis=1), np.ones(len(own))])
    beliefs = np.concatenate([hidden[unseen].astype(np.float64), np.eye(size)[cell]])
    return cells, beliefs / counts[:, None], counts / counts.sum()
