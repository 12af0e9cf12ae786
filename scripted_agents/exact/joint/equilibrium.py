"""The exact value and optimal mixed policies of the simultaneous chase, and of matrix games."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.memory import check_memory
from pursuit.tasks.task import Task
from pursuit.validation import as_array, number, whole
from scripted_agents.exact.duel.best_response import MoveOrder
from scripted_agents.exact.joint.matrix_games import solve_matrix
from scripted_agents.exact.joint.results import ChaseSolution
from scripted_agents.exact.joint.shapley_iteration import (
    Mask,
    OnProgress,
    StochasticGame,
    silent,
    solve_stochastic_game,
    stochastic_game_of,
)
from scripted_agents.exact.joint.states import joint_states_of
from scripted_agents.exact.joint.sweeps import Quantity
from scripted_agents.exact.limits import MAX_CHASE_BYTES, bytes_to_solve, check_duel_order


@dataclass(frozen=True, eq=False)
class MatrixGame:
    """The solution of a zero-sum matrix game.

    Attributes:
        value: the expected payoff of the row player if both play optimally.
        row: [m] float64, an optimal strategy of the row player, which maximises.
        column: [n] float64, one of the column player, which minimises.
        pure: whether the two are a pure saddle point.
    """

    value: float
    row: NDArray[np.float64]
    column: NDArray[np.float64]
    pure: bool


def solve_matrix_game(payoff: ArrayLike) -> MatrixGame:
    """Solve a two-player zero-sum game. Von Neumann (1928); the linear program of Dantzig (1951).

    Args:
        payoff: [m, n], the payoff of the row player; the column player gets its negative.

    Raises:
        ValueError: no matrix, an empty one, or entries that are not finite.
    """
    matrix = payoff_matrix(payoff)
    m, n = matrix.shape
    row, column = np.empty(m), np.empty(n)
    scratch = np.empty((m + 1, n + m + 1)), np.empty(m, dtype=np.int64)
    value, _ = solve_matrix(matrix, *scratch, row, column)
    pure = bool(row.max() == 1.0 and column.max() == 1.0)
    return MatrixGame(float(value), row, column, pure)


def payoff_matrix(payoff: ArrayLike) -> NDArray[np.float64]:
    """The payoff as [m, n] float64, or the errors of `solve_matrix_game`."""
    matrix = as_array("payoff", payoff, "biuf", "give a matrix of numbers").astype(np.float64)
    if matrix.ndim != 2 or matrix.size == 0:
        raise ValueError(f"payoff has shape {matrix.shape}; give a matrix [rows, columns]")
    if not np.isfinite(matrix).all():
        raise ValueError(f"payoff has entries that are not finite: {matrix[~np.isfinite(matrix)]}")
    return matrix


MOST_KEPT = 8
_kept: dict[tuple[Any, ...], ChaseSolution] = {}
"""The cached solutions, the latest at the end."""


def solve_chase(
    maze: Maze,
    discount: float = 0.95,
    stay_action: bool = False,
    horizon: int | None = None,
    move_order: MoveOrder = "simultaneous",
    num_chasers: int = 1,
    report: OnProgress = silent,
    allowed: tuple[ArrayLike, ArrayLike] | None = None,
) -> ChaseSolution:
    """Solve the chase of one evader by a team of chasers exactly, as a zero-sum stochastic game.

    Moves are simultaneous. The payoff is the expected sum of discount**t over the steps t = 0, 1,
    ... up to and including the capture; with `horizon` the expected number of steps, at most the
    horizon. The chasers minimise it, as one player with joint actions; the evader maximises it.
    Shapley (1953), by value iteration, with steps of policy evaluation in between where they help
    (Pollatschek and Avi-Itzhak, 1969).

    Args:
        maze: where it is played.
        discount: of each step, in (0, 1); not used with a horizon.
        stay_action: whether the fifth action exists.
        horizon: number of steps of the game, or None for infinitely many.
        move_order: "simultaneous", or "chasers_first": the chasers move first and the evader then,
            if it is not caught yet, but it has chosen its move before.
        num_chasers: size of the team; memory grows with cells ** (num_chasers + 1).
        report: called regularly with the estimated fraction of the work done, in [0, 1]; not called
            for cached solutions.
        allowed: for one chaser: the actions that the chaser and the evader may take, each [own
            cell, other cell, action] bool, at least one for every pair of different cells. Actions
            that lead to the same cell are one action. Such solutions are not cached.

    Raises:
        ValueError: an argument outside these limits, or a game that does not fit into memory.
    """
    maze = load_maze(maze)
    check_duel_order(move_order)
    if horizon is not None:
        discount, horizon = 1.0, whole("horizon", horizon, 1)
    elif not 0.0 < number("discount", discount) < 1.0:
        raise ValueError(f"discount={discount}; give a number in (0, 1), or a horizon")
    task = Task(
        maze=maze,
        num_chasers=whole("num_chasers", num_chasers, 1),
        num_evaders=1,
        stay_action=stay_action,
        move_order=move_order,
    )
    check_memory(
        f"{maze.name}, {maze.num_cells} cells and {num_chasers} chaser(s),",
        bytes_to_solve(maze, num_chasers, task.stay_action),
        "take a smaller maze or fewer chasers",
        MAX_CHASE_BYTES,
    )
    if allowed is not None:
        if num_chasers != 1:
            raise ValueError(f"allowed with num_chasers={num_chasers}; give one chaser, or no mask")
        chaser = _options(maze, allowed[0], task.num_actions, "chaser")
        evader = _options(maze, allowed[1], task.num_actions, "evader").swapaxes(0, 1)
        masks = evader.reshape(-1, task.num_actions), chaser.reshape(-1, task.num_actions)
        return _solve(task, float(discount), horizon, report, masks)
    key = (maze, task.move_order, task.stay_action, num_chasers, float(discount), horizon)
    solution = _kept.pop(key, None) or _solve(task, float(discount), horizon, report)
    _kept[key] = solution
    if len(_kept) > MOST_KEPT:
        del _kept[next(iter(_kept))]
    return solution


def _options(maze: Maze, allowed: ArrayLike, actions: int, role: str) -> Mask:
    """The mask of `solve_chase` with all actions that lead to the same cell as an allowed one."""
    mask = as_array("allowed", allowed, "b", "give masks of booleans")
    shape = (maze.num_cells, maze.num_cells, actions)
    if mask.shape != shape:
        raise ValueError(f"allowed of the {role} has shape {mask.shape}; {maze.name} needs {shape}")
    none = np.argwhere(~mask.any(axis=2) & ~np.eye(maze.num_cells, dtype=bool))
    if len(none):
        raise ValueError(
            f"allowed of the {role} has no action with its own cell {none[0, 0]} and the other "
            f"cell {none[0, 1]}; give at least one"
        )
    cells = maze.neighbors[:, :actions]
    same = cells[:, :, None] == cells[:, None, :]
    options: Mask = (mask[:, :, None, :] & same[:, None]).any(axis=3)
    return options


def _solve(
    task: Task,
    discount: float,
    horizon: int | None,
    report: OnProgress,
    allowed: tuple[Mask, Mask] | None = None,
) -> ChaseSolution:
    maze, num_chasers = task.mazes[0], task.num_chasers
    shape = (maze.num_cells,) * (num_chasers + 1)
    cells = np.stack(np.unravel_index(np.arange(maze.num_cells ** len(shape)), shape), axis=1)
    payoff = Quantity([0] * (num_chasers + 1), [1] * (num_chasers + 1))
    game, twins = team_chase_game(task, payoff, discount, report=report, allowed=allowed)
    values, sweeps = solve_stochastic_game(game, horizon)
    evader_policy, chaser_policy = game.strategies()
    evader_policy = evader_policy[twins]
    _rename(chaser_policy, cells, twins, task.num_actions)
    caught = (cells[:, :-1] == cells[:, -1:]).any(axis=1)
    chaser_policy[caught] = 1.0 / chaser_policy.shape[1]
    evader_policy[caught] = 1.0 / task.num_actions
    evader_table = np.moveaxis(evader_policy.reshape(*shape, -1), num_chasers, 0)
    values = values[twins]
    starts = (np.diff(np.sort(cells, axis=1), axis=1) != 0).all(axis=1)  # in different cells
    solution = ChaseSolution(
        values=values.reshape(shape),
        mean_over_starts=float(values[starts].mean()),
        policies={
            "chaser": chaser_policy.reshape(*shape, -1),
            "evader": np.ascontiguousarray(evader_table),
        },
        mixed=game.mixed[twins].reshape(shape),
        maze=maze,
        discount=discount,
        horizon=horizon,
        stay_action=task.stay_action,
        move_order=task.move_order,
        num_chasers=num_chasers,
        sweeps=sweeps,
    )
    for array in (solution.values, solution.mixed, *solution.policies.values()):
        array.flags.writeable = False
    return solution


def team_chase_game(
    task: Task,
    payoff: Quantity,
    discount: float,
    symmetries: NDArray[np.int64] | None = None,
    report: OnProgress = silent,
    allowed: tuple[Mask, Mask] | None = None,
) -> tuple[StochasticGame, NDArray[np.int64]]:
    """The game of one evader, the row player, against a team of chasers, the column player.

    Args:
        task: a chase of one evader in one maze, with any options of the rules but slips and drawn
            exits.
        payoff: of the evader.
        discount: of each step, or round of turns.
        symmetries: [n, cells], cells after each map of the maze onto itself under which the rules
            are the same; states that are equal up to these are looked at once. None for the
            identity only.
        report, allowed: as in `stochastic_game_of`; `allowed` for one chaser.

    Returns:
        The game, and [states] int64, the state that stands for each: its values are those of all.
    """
    states = joint_states_of(task)
    shape = (states.numbering.halves, *(task.max_cells,) * task.num_agents)
    half, *cells = np.unravel_index(np.arange(states.count), shape)
    everywhere = np.arange(task.max_cells)[None]
    twins = np.arange(states.count)
    if task.num_chasers > 1 or symmetries is not None:
        for after in everywhere if symmetries is None else symmetries:
            chasers = np.sort(after[np.stack(cells[:-1])], axis=0)
            image = np.ravel_multi_index((half, *chasers, after[cells[-1]]), shape)
            twins = np.minimum(twins, image)
    seats = (task.num_chasers, *range(task.num_chasers))
    same = None if task.num_chasers == 1 and symmetries is None else twins
    return stochastic_game_of(states, seats, payoff, discount, same, report, allowed), twins


def _rename(
    chaser_policy: NDArray[np.float64],
    cells: NDArray[np.int64],
    twins: NDArray[np.int64],
    actions: int,
) -> None:
    """Give every state the chasers' policy of its twin, in which their cells are in order."""
    chasers = cells.shape[1] - 1
    parts = np.indices((actions,) * chasers).reshape(chasers, -1)
    for order in permutations(range(chasers)):
        ordered = cells[:, order]
        here = (np.diff(ordered, axis=1) >= 0).all(axis=1) & (twins != np.arange(len(twins)))
        # The twin's chaser i is this state's chaser order[i], and so is its part.
        joint = np.ravel_multi_index(tuple(parts[list(order)]), (actions,) * chasers)
        chaser_policy[here] = chaser_policy[twins[here]][:, joint]
