"""Exact action values of duels, and all optimal actions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.rules import captured
from pursuit.validation import whole
from scripted_agents.agents.table_policy import checked_table
from scripted_agents.exact.duel.best_response import MoveOrder, best_response
from scripted_agents.exact.limits import check_duel_order
from scripted_agents.exact.tolerances import EQUAL_VALUES

MoveOutcomes = tuple[int, NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]
"""See `outcomes`."""


@dataclass(frozen=True, eq=False)
class ActionValues:
    """The exact values of a duel for one side, by its own cell and the other's.

    Attributes:
        role: "chaser" or "evader", the role of these values.
        steps: [own cell, other cell, action] float64, expected steps until capture with that action
            and optimal actions after it, its own step included, at most the horizon.
        values: [own cell, other cell] float64, of an optimal action; 0 on the diagonal.
        optimal: [own cell, other cell, action] bool, all optimal actions; none on the diagonal.
    """

    role: str
    steps: NDArray[np.float64]
    values: NDArray[np.float64]
    optimal: NDArray[np.bool_]


def action_values(
    role: Literal["chaser", "evader"],
    maze: Maze | str,
    opponent_table: ArrayLike,
    horizon: int = 200,
    stay_action: bool | None = None,
    move_order: MoveOrder = "simultaneous",
) -> ActionValues:
    """The value of every action against a tabular opponent.

    One step of Bellman's equation (1957), applied to `best_response` with one step less.

    Args:
        role, maze, opponent_table, stay_action, move_order: as for `best_response`.
        horizon: number of steps of the game, at least 1.

    Raises:
        ValueError: as `best_response`.
    """
    maze, horizon = load_maze(maze), whole("horizon", horizon, 1, 2**31)
    check_duel_order(move_order)
    table = checked_table(maze, opponent_table, "opponent_table")
    actions = table.shape[2] if stay_action is None else maze.num_moves + bool(stay_action)
    cells = maze.num_cells
    if horizon > 1:
        rest = best_response(
            role, maze, table, horizon - 1, stay_action=stay_action, move_order=move_order
        ).values
        later = rest if role == "chaser" else rest.T
    else:
        later = np.zeros((cells, cells))
    steps = q_values(role, maze, table, later, actions, move_order)
    best = steps.min(axis=2) if role == "chaser" else steps.max(axis=2)
    apart = ~np.eye(cells, dtype=bool)
    optimal = (np.abs(steps - best[:, :, None]) <= EQUAL_VALUES * best[:, :, None]) & apart[
        :, :, None
    ]
    return ActionValues(role, steps, np.where(apart, best, 0.0), optimal)


def q_values(
    role: Literal["chaser", "evader"],
    maze: Maze,
    opponent_table: NDArray[np.float64],
    later: NDArray[np.float64],
    num_actions: int,
    move_order: MoveOrder,
    discount: float = 1.0,
) -> NDArray[np.float64]:
    """[own cell, other cell, action] float64: one step plus the discounted values after it.

    Args:
        role, maze, opponent_table, move_order, discount: as for `best_response`.
        later: [own cell, other cell], the values of the next pairs of cells; capture counts 0.
        num_actions: of the responder.
    """
    moves = outcomes(role, maze, opponent_table, num_actions, move_order)
    return 1.0 + discount * expected_after(moves, later, num_actions)


def expected_after(
    moves: Iterable[MoveOutcomes], later: NDArray[np.float64], num_actions: int
) -> NDArray[np.float64]:
    """[own cell, other cell, action] float64: the mean of `later` after one step; capture counts 0.

    Args:
        moves: from `outcomes`.
        later: [own cell, other cell].
        num_actions: of the responder.
    """
    expected = np.zeros((*later.shape, num_actions))
    for action, chance, mine, theirs, caught in moves:
        expected[:, :, action] += np.where(caught, 0.0, chance * later[mine, theirs])
    return expected


def outcomes(
    role: Literal["chaser", "evader"],
    maze: Maze,
    opponent_table: NDArray[np.float64],
    num_actions: int,
    move_order: MoveOrder,
) -> Iterator[MoveOutcomes]:
    """The outcomes of one step of a duel, for every pair of actions.

    Yields:
        The own action, and arrays [own cell, other cell]: the probability of an action of the
        opponent, the own and the other cell after both moves, and whether that is a capture.
    """
    cells, neighbors = maze.num_cells, maze.neighbors
    own, other = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    for action in range(num_actions):
        mine = neighbors[own, action]
        for reply in range(opponent_table.shape[2]):
            chance, theirs = opponent_table[other, own, reply], neighbors[other, reply]
            moves = (own, mine), (other, theirs)
            chaser, evader = moves if role == "chaser" else moves[::-1]
            caught = captured(move_order == "chasers_first", *chaser, *evader)
            yield action, chance, mine, theirs, caught
