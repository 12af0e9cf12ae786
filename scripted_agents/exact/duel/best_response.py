"""The exact best response to a tabular policy, and the exact value of two tabular policies.

One chaser and one evader in one maze. A *table* is a policy [self cell, other cell, action] of
probabilities, float64, for the moves (north, south, east, west), or for the moves and stay. Entries
for equal cells are ignored, as no game continues with both agents in one cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.memory import check_memory
from pursuit.observations.masks import bump_masks
from pursuit.rules.captures import Duel
from pursuit.validation import as_array, check_bool, check_discount, whole
from scripted_agents.agents.table_policy import checked_table
from scripted_agents.exact.duel.pair_kernels import (
    Pairs,
    choose,
    evaluate_rows,
    lay_out_table,
    respond_rows,
    spread_capture,
)
from scripted_agents.exact.duel.value_iteration import iterate_duel
from scripted_agents.exact.limits import MAX_DUEL_ENTRIES, check_duel_order

MoveOrder = Literal["simultaneous", "chasers_first"]


SMALL_COST = 2.0**-20
"""The cost of a game that is not over at the horizon, in steps, for `BestResponse.captured`: so
small that it decides between equally good actions only."""


class PairValues(np.ndarray[tuple[int, int], np.dtype[np.float64]]):
    """[chaser cell, evader cell] float64: expected steps until capture or the horizon."""

    @property
    def values(self) -> NDArray[np.float64]:
        """The same numbers as a plain array, as in `BestResponse.values`."""
        return self.view(np.ndarray)

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        """Results of computations are plain arrays or numbers."""
        plain = np.asarray(array)
        return plain[()] if return_scalar else plain


@dataclass(frozen=True, eq=False)
class BestResponse:
    """The result of `best_response`.

    Attributes:
        role: "chaser" or "evader", the role of the best response.
        maze: where it is played.
        values: [chaser cell, evader cell] float64, the expected number of steps until capture (the
            capturing step included), at most the horizon; 0 on the diagonal. With a discount the
            step t = 0, 1, ... counts discount**t.
        actions: [self cell, other cell] int8, an optimal action of the first step: among equally
            good ones the first in order, moves before staying.
        horizon: number of steps, or None for the problem with infinite horizon.
        sweeps: number of steps of backward induction.
        num_actions: the moves, 4 in a maze, and stay if it is an action.
        open_share: a function without arguments: see `captured`.
    """

    role: str
    maze: Maze
    values: NDArray[np.float64] = field(repr=False)
    actions: NDArray[np.int8] = field(repr=False)
    horizon: int | None
    discount: float
    move_order: str
    num_actions: int
    sweeps: int
    open_share: Callable[[], NDArray[np.float64]] = field(repr=False)

    @cached_property
    def captured(self) -> NDArray[np.float64]:
        """[chaser cell, evader cell] float64, the probability of a capture within the horizon if
        the optimal action of every step is taken (`actions` are those of the first); 1 on the
        diagonal. Of equally good ones the chaser takes those with more captures, the evader those
        with fewer."""
        found = np.asarray(1.0 - self.open_share())
        object.__setattr__(self, "open_share", None)  # its arrays are large
        return found

    @cached_property
    def policy(self) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64, `actions` as a table of probabilities 0 and 1.

        Optimal in every step if `horizon` is None, else in the first step.
        """
        return np.eye(self.num_actions)[self.actions]

    @property
    def policies(self) -> dict[str, NDArray[np.float64]]:
        """By role, `policy`."""
        return {self.role: self.policy}

    @property
    def mean_over_starts(self) -> float:
        """The mean of `values` over all starts in different cells."""
        return mean_over_starts(self.values, self.maze)


def best_response(
    role: Literal["chaser", "evader"],
    maze: Maze,
    opponent_table: ArrayLike,
    horizon: int | None = 200,
    discount: float = 1.0,
    stay_action: bool | None = None,
    move_order: MoveOrder = "simultaneous",
    mask_bumps: bool = False,
) -> BestResponse:
    """The exact best response to an opponent with a tabular policy.

    Against a fixed table the game is a Markov decision process over pairs of cells. The chaser
    minimises the expected number of steps until capture, the evader maximises it. Solved exactly by
    backward induction over `horizon` steps; or with `horizon=None` by value iteration for the
    infinite horizon, to a relative error of about 1e-9. Bellman (1957); Puterman (1994).

    Args:
        role: of the responding agent; the opponent has the other role.
        maze: of at most MAX_TABLE_CELLS cells; the work is quadratic in their number.
        opponent_table: [self cell, other cell, action], the opponent's probabilities.
        horizon: number of steps of the game, or None for infinitely many.
        discount: of each step, above 0 and at most 1.
        stay_action: whether the responder has the stay action; by default as the opponent. Without
            it an agent can stay only by a move into a wall.
        move_order: "simultaneous", or "chasers_first": the evader moves after the chaser, unless it
            is caught, but both choose their moves before.
        mask_bumps: whether the responder must not move into walls (`pursuit.observations.masks`):
            the optimum of a learner with action masks. Without the stay action it cannot wait then.

    Raises:
        ValueError: an invalid argument; a table of a wrong shape, or with a row that is no
            distribution; an infinite horizon without discount, if capture can be avoided forever,
            or is so rare that value iteration does not converge.
    """
    if role not in ("chaser", "evader"):
        raise ValueError(f"role={role!r}; give 'chaser' or 'evader'")
    maze = load_maze(maze)
    if stay_action is not None:
        check_bool("stay_action", stay_action)
    _check_settings(maze, horizon, discount, move_order)
    table = checked_table(maze, opponent_table, "opponent_table")
    num_actions = table.shape[2] if stay_action is None else maze.num_moves + bool(stay_action)
    every = np.ones((maze.num_cells, num_actions), dtype=bool)
    allowed = bump_masks(maze, num_actions) if mask_bumps else every
    neighbors, instead = _own_moves(maze, allowed)
    stays = num_actions > maze.num_moves
    pairs, shape = _pairs(maze, table, neighbors, role == "chaser", move_order, stays)
    if horizon is None and discount == 1.0:
        _check_capture(maze, _any_move(maze, allowed), pairs, role == "evader")
    sign = -1.0 if role == "evader" else 1.0
    sweep = partial(respond_rows, pairs, sign, discount)
    last_values, next_values, sweeps = iterate_duel(sweep, shape, horizon, discount)
    actions = np.empty((maze.num_cells, maze.num_cells), dtype=np.int8)
    choose(next_values, pairs, actions)
    actions = np.take_along_axis(instead, actions, axis=1)

    values = _by_pair(role, pairs, last_values)
    open_share = partial(_open_share, role, pairs, shape, horizon, discount, values)
    rest = (horizon, discount, move_order, num_actions, sweeps, open_share)
    return BestResponse(role, maze, values, actions, *rest)


def _by_pair(role: str, pairs: Pairs, found: NDArray[np.float64]) -> NDArray[np.float64]:
    """[chaser cell, evader cell] values of a role."""
    sign = -1.0 if role == "evader" else 1.0
    values = 0.0 + sign * found.take(pairs.width + pairs.spots, axis=1)
    return np.ascontiguousarray(values.T) if role == "evader" else values


def _open_share(
    role: str,
    pairs: Pairs,
    shape: tuple[int, int],
    horizon: int | None,
    discount: float,
    values: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The share of games that are not over at the horizon: the values with a small cost of these,
    less the values, over the cost."""
    if horizon is None or discount != 1.0:
        raise ValueError("captures are counted with a horizon and without discount")
    sweep = partial(respond_rows, pairs, -1.0 if role == "evader" else 1.0, discount)
    start = np.zeros(shape)
    sweep(np.zeros(shape), start, 0, shape[0])  # 1 in all games that are not over
    start *= SMALL_COST
    with_cost, _, _ = iterate_duel(sweep, shape, horizon, 1.0, start)
    return np.clip((_by_pair(role, pairs, with_cost) - values) / SMALL_COST, 0.0, 1.0)


def evaluate_exactly(
    maze: Maze,
    chaser_table: ArrayLike,
    evader_table: ArrayLike,
    horizon: int | None = 200,
    discount: float = 1.0,
    move_order: MoveOrder = "simultaneous",
) -> PairValues:
    """The expected number of steps until capture for two tabular policies.

    The same quantity as `best_response(...).values`, with its arguments and errors: an array
    [chaser cell, evader cell] float64 with 0 on the diagonal. `.values` is the same as plain array.
    """
    maze = load_maze(maze)
    _check_settings(maze, horizon, discount, move_order)
    chaser = checked_table(maze, chaser_table, "chaser_table")
    evader = checked_table(maze, evader_table, "evader_table")
    weights, stays = _lay_out(maze, chaser), chaser.shape[2] > maze.num_moves
    pairs, shape = _pairs(maze, evader, maze.neighbors, True, move_order, stays)
    if horizon is None and discount == 1.0:
        _check_capture(maze, weights, pairs, False)
    values, _, _ = iterate_duel(
        partial(evaluate_rows, weights, pairs, discount), shape, horizon, discount
    )
    pair_values: PairValues = values.take(pairs.width + pairs.spots, axis=1).view(PairValues)
    return pair_values


def mean_over_starts(values: ArrayLike, maze: Maze, min_start_distance: int = 1) -> float:
    """The mean of `values` over the random starts of the game.

    These are all ordered pairs of different cells with a path distance of at least
    `min_start_distance`, equally likely. Cells without a path have an infinite distance.

    Raises:
        ValueError: `values` is not [num_cells, num_cells], or there is no such pair.
    """
    maze, array = load_maze(maze), as_array("values", values, "iuf", "give numbers")
    min_start_distance = whole("min_start_distance", min_start_distance, 0)
    if array.shape != (maze.num_cells, maze.num_cells):
        raise ValueError(
            f"values has shape {array.shape}; {maze.name} with {maze.num_cells} cells needs "
            f"{(maze.num_cells, maze.num_cells)}"
        )
    return float(array[random_starts(maze, min_start_distance)].mean())


def random_starts(maze: Maze, min_start_distance: int) -> NDArray[np.bool_]:
    """[chaser cell, evader cell] bool, the starts of `mean_over_starts`; ValueError for none."""
    starts: NDArray[np.bool_] = maze.distances >= max(min_start_distance, 1)
    if not starts.any():
        raise ValueError(
            f"min_start_distance={min_start_distance} is more than the largest distance in "
            f"{maze.name}; give at most {maze.longest_distance}"
        )
    return starts


# -- checks ----------------------------------------------------------------------------------------


def _check_settings(maze: Maze, horizon: int | None, discount: float, move_order: str) -> None:
    if maze.num_cells > MAX_TABLE_CELLS:
        raise ValueError(
            f"{maze.name}: {maze.num_cells} cells; duels are solved exactly for at most "
            f"{MAX_TABLE_CELLS} cells. Use a smaller maze, or simulate episodes"
        )
    _, width, (_, room) = _grid(maze)
    grid = room - 2 * width
    entries = maze.num_cells * grid
    if entries > MAX_DUEL_ENTRIES:
        raise ValueError(
            f"{maze.name}: {maze.num_cells} cells in {maze.height} rows and {maze.width} columns, "
            f"{entries} entries; at most {MAX_DUEL_ENTRIES} are possible. Remove rows and columns "
            "of blocked cells"
        )
    # Tables of both agents in the layout of the kernels, and the values of two steps.
    check_memory(
        f"{maze.name}, {maze.num_cells} cells,",
        8 * maze.num_cells * (2 * (maze.num_moves + 1) * grid + 2 * room),
        "use a smaller maze, or simulate episodes",
    )
    if horizon is not None:
        whole("horizon", horizon, 1)
    check_discount(discount)
    check_duel_order(move_order)


def _check_capture(maze: Maze, weights: NDArray[np.float64], pairs: Pairs, for_all: bool) -> None:
    """ValueError unless the expected time until capture is finite from every pair of cells.

    In a finite Markov chain it is finite if capture is reachable from every pair: by some moves of
    a minimising agent, or by all moves of a maximising one (`for_all`).
    """
    captured = np.eye(maze.num_cells, dtype=bool)
    while spread_capture(captured, weights, pairs, for_all):
        pass
    if not captured.all():
        own_cell, other_cell = np.argwhere(~captured)[0].tolist()
        raise ValueError(
            f"{maze.name}: capture can be avoided forever, so the expected number of steps is "
            f"infinite (first from the cells {own_cell} and {other_cell}); give a horizon, or a "
            "discount below 1"
        )


# -- layout ----------------------------------------------------------------------------------------


def _pairs(
    maze: Maze,
    table: NDArray[np.float64],
    neighbors: NDArray[np.int32],
    own_chases: bool,
    move_order: str,
    stay_action: bool,
) -> tuple[Pairs, tuple[int, int]]:
    """The duel of an own player against the table of the other, and the shape of its values."""
    spots, width, shape = _grid(maze)
    duel, chances = Duel(own_chases, move_order == "chasers_first"), _lay_out(maze, table, True)
    return Pairs(chances, neighbors, _around(maze), spots, width, duel, stay_action), shape


def _grid(maze: Maze) -> tuple[NDArray[np.int32], int, tuple[int, int]]:
    """The index of each cell in the full grid, the width of the grid (0 for a graph), and the shape
    of the values with their margins."""
    if not maze.is_grid:
        return np.arange(maze.num_cells, dtype=np.int32), 0, (maze.num_cells, maze.num_cells)
    shape = (maze.num_cells, (maze.height + 2) * maze.width)
    return maze.rows * np.int32(maze.width) + maze.columns, maze.width, shape


def _around(maze: Maze) -> NDArray[np.int32]:
    """[cells, any] int32, the cells that moves lead to or from; the own cell in free places."""
    if not maze.is_directed:
        return np.ascontiguousarray(maze.neighbors[:, :-1])
    cells = np.arange(maze.num_cells)
    near = [
        np.flatnonzero((maze.neighbors == cell).any(axis=1) | np.isin(cells, maze.neighbors[cell]))
        for cell in cells
    ]
    found = np.repeat(cells[:, None], max(map(len, near)), axis=1).astype(np.int32)
    for cell, others in enumerate(near):
        found[cell, : len(others)] = others
    return found


def _lay_out(maze: Maze, table: NDArray[np.float64], turned: bool = False) -> NDArray[np.float64]:
    """The table as [own cell, slot, grid]; of the own player, or of the other if `turned`."""
    spots, width, (_, room) = _grid(maze)
    laid = np.empty((maze.num_cells, maze.num_moves + 1, room - 2 * width))
    lay_out_table(table, maze.neighbors, spots, turned, laid)
    return laid


def _any_move(maze: Maze, allowed: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Weights of an own player, uniform over the `allowed` [cells, actions]."""
    even = allowed / allowed.sum(axis=1, keepdims=True)
    table = np.broadcast_to(even[:, None], (len(even), *even.shape))
    return _lay_out(maze, np.ascontiguousarray(table))


def _own_moves(
    maze: Maze, allowed: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """Neighbors [cells, slots] of an own player with the `allowed` actions [cells, actions], and
    the allowed action [cells, slots] in place of each action.

    An action that is not allowed is replaced by the first that is, so the kernels need no masks.
    """
    slots = maze.num_moves + 1
    kept = np.ones((len(allowed), slots), dtype=bool)
    kept[:, : allowed.shape[1]] = allowed
    instead = np.where(kept, np.arange(slots), kept.argmax(axis=1)[:, None])
    neighbors = np.take_along_axis(maze.neighbors, instead, axis=1)
    neighbors.setflags(write=False)  # as the arrays of mazes, so that both have one compiled kernel
    return neighbors, instead.astype(np.int8)
