"""Exact win probabilities in duels, for ratings without sampled games."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import block_diag, csr_array, diags_array

from pursuit.mazes.maze import Maze, load_maze
from pursuit.memory import check_memory
from pursuit.validation import whole
from scripted_agents.duel.action_values import outcomes
from scripted_agents.duel.best_response import MoveOrder, checked_table

NEGLIGIBLE = 1e-12
"""The chance of being still free below which a game counts as over."""


def duel_wins(
    role: Literal["chaser", "evader"],
    maze: Maze,
    tables: Sequence[ArrayLike],
    opponents: Sequence[ArrayLike],
    horizon: int = 200,
    move_order: MoveOrder = "simultaneous",
    min_start_distance: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How often each of several players of one role does better than each other, exactly.

    Two players do the same thing apart: each plays a game of its own from one start against one
    opponent. The chaser that captures sooner has won, and the evader that is captured later; ties
    count half, and an escape until the horizon ties with a capture in the last step. Mean over
    all starts and all opponents: what the share of comparisons of `pursuit league` tends to.

    Args:
        role: of the players, "chaser" or "evader".
        maze: or the name of one.
        tables: of the players, [own cell, other cell, action] each, probabilities.
        opponents: likewise.
        horizon: steps after which a game is cut.
        move_order, min_start_distance: as in the game.

    Returns:
        [players, players] float64, the chance that the first is better than the second, which is
        1 less that of the other way round; and [players, opponents] float64, the expected steps.

    Raises:
        ValueError: no player or no opponent, a table that is none, tables over 4 and over 5
            actions, a horizon below 1, or too little memory.
    """
    maze, horizon = load_maze(maze), whole("horizon", horizon, 1, 2**31)
    own = [checked_table(maze, table, "tables") for table in tables]
    others = [checked_table(maze, table, "opponents") for table in opponents]
    if not own or not others:
        raise ValueError(f"{len(own)} tables and {len(others)} opponents; give at least one each")
    sizes = {table.shape[2] for table in own}
    if len(sizes) > 1:
        raise ValueError(
            f"tables over {' and '.join(map(str, sorted(sizes)))} actions; one game has "
            "the same actions: give all of them the action stay, or none"
        )
    players, pairs, actions = len(own), maze.num_cells**2, own[0].shape[2]
    check_memory(
        f"{maze.name}, {players} players,",
        40 * players * pairs * actions**2,
        "compare fewer, or use a smaller maze",
    )
    starts = np.flatnonzero((maze.distances >= max(min_start_distance, 1)).ravel())
    steps_of, sooner = np.zeros((players, len(others))), np.zeros((players, players))
    weights = [table.reshape(pairs, actions) for table in own]
    for number, other in enumerate(others):
        moves = transitions(role, maze, other, actions, move_order)
        chain = block_diag([_mixed(moves, chances) for chances in weights], "csr")
        everywhere: NDArray[np.float64] = np.ones(players * pairs)
        before: NDArray[np.float64] = np.ones((players, len(starts)))
        for step in range(1, horizon + 1):
            steps_of[:, number] += before.mean(axis=1)
            everywhere = chain @ everywhere
            free = everywhere.reshape(players, pairs)[:, starts]
            if step == horizon or free.max() < NEGLIGIBLE:
                free = np.zeros_like(free)
            ended = before - free
            sooner += ended @ (free + 0.5 * ended).T
            before = free
            if not free.any():
                break
    sooner /= len(others) * len(starts)
    return (sooner if role == "chaser" else sooner.T), steps_of


def _mixed(moves: list[csr_array], chances: NDArray[np.float64]) -> csr_array:
    """[pairs, pairs], the transitions of a player that moves by `chances` [pairs, actions]."""
    return sum(diags_array(own) @ move for own, move in zip(chances.T, moves, strict=True))


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
