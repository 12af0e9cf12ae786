"""The double oracle method for duels, with exact equilibria and exact best responses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.validation import number
from scripted_agents.exact.duel.best_response import MoveOrder, best_response, mean_over_starts
from scripted_agents.exact.graphs.cops_and_robbers import distinct_moves
from scripted_agents.exact.joint.equilibrium import solve_chase
from scripted_agents.exact.joint.results import ChaseSolution
from scripted_agents.exact.populations.uniform import uniform_duel_table


@dataclass(frozen=True)
class OracleIteration:
    """One iteration of `double_oracle`.

    Attributes:
        nash_conv: of the equilibrium of the restricted game, in the full game: discounted steps,
            the mean over all starts in distinct cells.
        largest_gain: the same sum of both gains from the start where it is largest.
        policies: in the population of each role.
        chaser_actions, evader_actions: of each role in the restricted game: the mean number per
            pair of distinct cells. Actions that lead to the same cell count as one.
    """

    nash_conv: float
    largest_gain: float
    policies: int
    chaser_actions: float
    evader_actions: float


@dataclass(frozen=True, eq=False)
class DoubleOracle:
    """The result of `double_oracle`.

    Attributes:
        solution: of the last restricted game, an equilibrium of the full game up to the tolerance.
        chasers, evaders: [policies, own cell, other cell] int8, the actions of the populations.
        iterations: of the method, in order.
    """

    solution: ChaseSolution = field(repr=False)
    chasers: NDArray[np.int8] = field(repr=False)
    evaders: NDArray[np.int8] = field(repr=False)
    iterations: list[OracleIteration]


def double_oracle(
    maze: Maze | str,
    discount: float = 0.95,
    stay_action: bool = False,
    move_order: MoveOrder = "simultaneous",
    tolerance: float = 1e-6,
    report: Callable[[OracleIteration], None] = lambda iteration: None,
) -> DoubleOracle:
    """Solve a duel by a growing restricted game: `solve_chase` from best responses.

    The restricted game has, at each pair of cells, the actions that some policy of the population
    takes there. Its equilibrium is solved exactly (Shapley, 1953). The exact best responses of both
    sides in the full game join the populations. The first two are the best responses to uniformly
    random actions.

    Double oracle is due to McMahan, Gordon and Blum (2003), for matrix games. The restriction by
    state is that of XDO (McAleer et al., 2021), here for a game with discount over pairs of cells.
    In a matrix game of whole policies the best response to a mixture would depend on the history,
    so it would be no table.

    It ends: a best response that gains takes an action that is not yet in the restricted game, and
    actions are finite in number. At the end both sides' gains bound the error of the values, at
    every pair of cells.

    Args:
        maze, discount, stay_action, move_order: as for `solve_chase`.
        tolerance: at most this sum of both gains from any start at the end, in discounted steps,
            above 0. Best responses are exact to a relative error of about 1e-9: if the tolerance is
            below that, it ends when the restricted game does not grow.
        report: called after each iteration.

    Raises:
        ValueError: an argument outside these limits, or a game that does not fit into memory.
    """
    maze = load_maze(maze)
    if not number("tolerance", tolerance) > 0.0:
        raise ValueError(f"tolerance={tolerance}; give a number above 0")
    even = uniform_duel_table(maze, discount, stay_action)
    rest = (None, discount, stay_action, move_order)
    chasers = [best_response("chaser", maze, even, *rest).actions]
    evaders = [best_response("evader", maze, even, *rest).actions]
    chaser_mask, evader_mask = (np.zeros(even.shape, dtype=bool) for _ in range(2))
    iterations: list[OracleIteration] = []
    while True:
        before = chaser_mask.sum() + evader_mask.sum()
        _allow(maze, chaser_mask, chasers[-1])
        _allow(maze, evader_mask, evaders[-1])
        if iterations and chaser_mask.sum() + evader_mask.sum() == before:
            del chasers[-1], evaders[-1]
            break
        solution = solve_chase(
            maze, discount, stay_action, None, move_order, allowed=(chaser_mask, evader_mask)
        )
        longest = best_response("evader", maze, solution.chaser_policy, *rest)
        shortest = best_response("chaser", maze, solution.evader_policy, *rest)
        gains = longest.values - shortest.values
        nash_conv, largest = mean_over_starts(gains, maze), float(gains.max())
        allowed = (_mean_actions(maze, mask) for mask in (chaser_mask, evader_mask))
        iterations.append(OracleIteration(nash_conv, largest, len(chasers), *allowed))
        report(iterations[-1])
        if iterations[-1].largest_gain <= tolerance:
            break
        chasers.append(shortest.actions)
        evaders.append(longest.actions)
    return DoubleOracle(solution, np.stack(chasers), np.stack(evaders), iterations)


def _allow(maze: Maze, mask: NDArray[np.bool_], actions: NDArray[np.int8]) -> None:
    """Add a policy to a mask, with all actions that lead to the same cell."""
    after = maze.neighbors[:, : mask.shape[2]]
    chosen = np.take_along_axis(after, actions, axis=1)
    mask |= after[:, None, :] == chosen[:, :, None]


def _mean_actions(maze: Maze, mask: NDArray[np.bool_]) -> float:
    """The mean number of different next cells per pair of distinct cells."""
    after = maze.neighbors[:, : mask.shape[2]]
    count = (mask & distinct_moves(after)[:, None]).sum(axis=2)
    return float(count[~np.eye(maze.num_cells, dtype=bool)].mean())
