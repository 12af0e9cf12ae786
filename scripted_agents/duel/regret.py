"""Where a duel is lost: what every state costs, in steps of the gap to the exact optimum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from pursuit.mazes.maze import Maze, load_maze
from pursuit.memory import check_memory
from pursuit.validation import whole
from scripted_agents.duel.action_values import outcomes
from scripted_agents.duel.best_response import MoveOrder, checked_table


@dataclass(frozen=True, eq=False)
class DuelRegret:
    """What a policy loses against the best response, state by state; they sum up to all it loses.

    Attributes:
        optimum, achieved: expected steps until capture, mean over the starts, of the best response
            and of the policy.
        visits: [own cell, other cell] float64, how often a game is in that state, on average.
        regret: [own cell, other cell] float64, what a game loses there, in steps: the visits times
            what the policy's action is worse than the best. Their sum is the difference of
            `achieved` and `optimum`, whichever is more (Kakade and Langford, 2002, lemma 6.1).
        action_gap: [own cell, other cell] float64, by how much the second best value of an action
            is worse than the best, with all steps before one; inf where all are equally good.
    """

    optimum: float
    achieved: float
    visits: NDArray[np.float64]
    regret: NDArray[np.float64]
    action_gap: NDArray[np.float64]


def duel_regret(
    role: Literal["chaser", "evader"],
    maze: Maze,
    own_table: ArrayLike,
    opponent_table: ArrayLike,
    horizon: int = 200,
    move_order: MoveOrder = "simultaneous",
    min_start_distance: int = 1,
) -> DuelRegret:
    """What a policy of one side loses in every state of a duel, exactly.

    Backward over the steps, the best actions of a game that is cut at the horizon; forward, how
    often the policy is in each state.

    Args:
        role: whose policy is looked at, "chaser" or "evader".
        maze: or the name of one.
        own_table, opponent_table: [own cell, other cell, action], probabilities.
        horizon: steps after which the game is cut.
        move_order, min_start_distance: as in the game.

    Raises:
        ValueError: a table that is none, a horizon below 1, or too little memory.
    """
    maze, horizon = load_maze(maze), whole("horizon", horizon, 1, 2**31)
    own = checked_table(maze, own_table, "own_table")
    other = checked_table(maze, opponent_table, "opponent_table")
    cells, actions = maze.num_cells, own.shape[2]
    check_memory(
        f"{maze.name}, {horizon} steps,",
        8 * cells * cells * (horizon + 40 * actions),
        "use a smaller maze",
    )
    sign = 1.0 if role == "chaser" else -1.0
    lost = np.empty((horizon, cells, cells))
    best = np.zeros((cells, cells))
    apart = ~np.eye(cells, dtype=bool)
    steps = transitions(role, maze, other, actions, move_order)
    for left in range(1, horizon + 1):
        later = [(step @ best.ravel()).reshape(cells, cells) for step in steps]
        worth = np.stack([sign + after for after in later], axis=-1)
        best = np.where(apart, worth.min(axis=2), 0.0)
        lost[horizon - left] = ((worth - best[:, :, None]) * own).sum(axis=2) * apart
    starts = (maze.distances >= max(min_start_distance, 1)).astype(np.float64)
    now = starts / starts.sum()
    visits, regret = np.zeros((cells, cells)), np.zeros((cells, cells))
    optimum = sign * float((now * best).sum())
    for costs in lost:
        visits += now
        regret += now * costs
        moved = [(now * own[:, :, action]).ravel() @ step for action, step in enumerate(steps)]
        now = np.sum(moved, axis=0).reshape(cells, cells)
    worse = worth - best[:, :, None]
    worse[worse <= 1e-9 * np.abs(best)[:, :, None]] = np.inf
    achieved = optimum + sign * float(regret.sum())
    return DuelRegret(optimum, achieved, visits, regret, worse.min(axis=2))


def transitions(
    role: Literal["chaser", "evader"],
    maze: Maze,
    other: NDArray[np.float64],
    actions: int,
    move_order: MoveOrder,
) -> list[csr_array]:
    """For each own action the chances [pairs, pairs] of the pair of cells that follows.

    Pairs are numbered own cell * cells + other cell; rows sum to less than 1 where it may be a
    capture.
    """
    cells, pairs = maze.num_cells, maze.num_cells**2
    parts: list[list[Any]] = [[] for _ in range(actions)]
    for action, chance, mine, theirs, caught in outcomes(role, maze, other, actions, move_order):
        free = np.flatnonzero(~caught & (chance > 0.0))
        after = (mine * cells + theirs).ravel()[free]
        parts[action].append((chance.ravel()[free], free, after))
    steps = []
    for replies in parts:  # what two replies lead to alike is summed up
        chances, before, following = (np.concatenate(each) for each in zip(*replies, strict=True))
        steps.append(csr_array((chances, (before, following)), (pairs, pairs)))
    return steps
