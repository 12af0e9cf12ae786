"""The turn-based chase, solved by retrograde analysis: winning positions and the cop number.

All chasers move at once, then the evader moves, and so on; all positions are known. This is the
game of cops and robbers (Nowakowski and Winkler, 1983; Aigner and Fromme, 1984).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.memory import check_memory
from pursuit.validation import check_bool, whole
from scripted_agents.exact.graphs.turn_kernels import (
    add_captures,
    extend,
    join,
    trap,
    trap_in_graph,
)
from scripted_agents.exact.limits import MAX_TURN_BYTES

OnProgress = Callable[[float, int], None]

NEVER = 65535
"""Capture time if the evader is never captured."""


@dataclass(frozen=True, eq=False)
class TurnBasedSolution:
    """The result of `solve_in_turns`.

    Attributes:
        chasers_win: [chaser cell, ..., evader cell] bool, with the chasers to move; True if one is
            in the cell of the evader.
        times: of the same shape, uint16: the moves of the chasers until capture with optimal moves
            of both sides; 0 if it is captured already, NEVER if it escapes. None if the array does
            not fit into memory.
    """

    maze: Maze
    num_chasers: int
    stay_action: bool
    chasers_win: NDArray[np.bool_] = field(repr=False)
    times: NDArray[np.uint16] | None = field(repr=False)

    @property
    def has_winning_start(self) -> bool:
        """Whether the chasers have starting cells from which they capture any evader."""
        return bool(self.chasers_win.all(axis=-1).any())


def solve_in_turns(
    maze: Maze,
    num_chasers: int = 1,
    stay_action: bool = True,
    report: OnProgress = lambda share, num_chasers: None,
) -> TurnBasedSolution:
    """Solve the turn-based chase by retrograde analysis; the chasers move first.

    Chasers may share a cell. An evader is captured if a chaser moves into its cell, or if it moves
    into the cell of a chaser.

    Args:
        maze: the maze.
        num_chasers: 1 or more.
        stay_action: whether agents may stay, as in the literature. Without it agents can stay only
            by a move into a wall.
        report: called after every sweep with the fraction of positions known to be won by the
            chasers, and the number of chasers.

    Raises:
        ValueError: no chaser, or a game that does not fit into MAX_TURN_BYTES.
    """
    maze, stay_action = load_maze(maze), check_bool("stay_action", stay_action)
    whole("num_chasers", num_chasers, 1)
    size = maze.num_cells
    words = -(-(maze.height * maze.width if maze.is_grid else size) // 64)
    teams = size**num_chasers
    needed = 3 * 8 * teams * words + teams * size
    check_memory(
        f"{maze.name} in turns, {size} cells and {num_chasers} chaser(s),",
        needed,
        "use a smaller maze or fewer chasers",
        MAX_TURN_BYTES,
    )
    timed = needed + 2 * teams * size <= MAX_TURN_BYTES
    neighbors = np.ascontiguousarray(maze.neighbors[:, : maze.num_moves + stay_action])
    spots = np.arange(size)
    if maze.is_grid:
        spots = maze.rows.astype(np.int64) * maze.width + maze.columns
        offsets = np.array([-maze.width, maze.width, 1, -1, 0], dtype=np.int64)
        moving = neighbors[:, :4] != np.arange(size)[:, None]
        still = np.ones(size, dtype=bool) if stay_action else ~moving.all(axis=1)
        chances = np.stack([_as_set(spots[way], words) for way in (*moving.T, still)])
    taken = np.stack([_as_set(spots[cell : cell + 1], words) for cell in range(size)])
    useful = distinct_moves(neighbors)

    winning = np.zeros((teams, words), dtype=np.uint64)
    one, other = np.empty_like(winning), np.empty_like(winning)
    for chaser in range(num_chasers):
        winning |= taken[np.arange(teams) // size**chaser % size]
    times = np.full((teams if timed else 0, size), NEVER, dtype=np.uint16)
    if timed:
        times[_members(winning, spots)] = 0
    time = 1
    while True:
        if maze.is_grid:
            trap(winning, one, chances, offsets)
        else:
            trap_in_graph(winning, one, neighbors)
        add_captures(one, taken, num_chasers)
        for chaser in range(num_chasers):
            join(one, other, neighbors, useful, size**chaser)
            one, other = other, one
        if not extend(winning, one, spots, times, min(time, NEVER - 1)):
            break
        report(int(np.bitwise_count(winning).sum()) / (teams * size), num_chasers)
        time += 1
    shape = (size,) * (num_chasers + 1)
    wins = _members(winning, spots).reshape(shape)
    return TurnBasedSolution(
        maze, num_chasers, stay_action, wins, times.reshape(shape) if timed else None
    )


def cop_number(
    maze: Maze,
    stay_action: bool = True,
    most: int = 3,
    report: OnProgress = lambda share, num_chasers: None,
) -> int | None:
    """The least number of chasers that capture any evader in turns, from starts of their choice.

    None if more than `most` are needed. In a planar graph, such as a maze, 3 chasers always suffice
    if it is connected and agents may stay (Aigner and Fromme, 1984).

    Raises:
        ValueError: the solution does not fit into memory.
    """
    for chasers in range(1, whole("most", most, 1) + 1):
        if solve_in_turns(maze, chasers, stay_action, report).has_winning_start:
            return chasers
    return None


def _as_set(spots: NDArray[np.int64], words: int) -> NDArray[np.uint64]:
    bits = np.zeros(64 * words, dtype=np.uint8)
    bits[spots] = 1
    packed: NDArray[np.uint64] = np.packbits(bits, bitorder="little").view("<u8")
    return packed.astype(np.uint64)


def _members(sets: NDArray[np.uint64], spots: NDArray[np.int64]) -> NDArray[np.bool_]:
    """[teams, cells] bool: whether each cell is in each set."""
    member = np.empty((len(sets), len(spots)), dtype=bool)
    for cell, spot in enumerate(spots.tolist()):
        member[:, cell] = (sets[:, spot // 64] >> np.uint64(spot % 64)) & np.uint64(1)
    return member


def distinct_moves(neighbors: NDArray[np.int32]) -> NDArray[np.bool_]:
    """[cells, actions] bool: False for an action with the same next cell as an earlier one."""
    useful = np.ones(neighbors.shape, dtype=bool)
    for action in range(1, neighbors.shape[1]):
        useful[:, action] = (neighbors[:, :action] != neighbors[:, action : action + 1]).all(axis=1)
    return useful
