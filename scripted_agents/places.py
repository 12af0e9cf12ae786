"""The places of a chase of one evader by a team: numbers for all that the solvers go through.

A *place* is (team, evader cell). A *team* numbers the cells of all chasers, and a *joint* action
their actions, the last chaser counting fastest in both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from pursuit.maze import Maze


@dataclass(frozen=True, eq=False)
class Places:
    """All places of a maze.

    Attributes:
        num_chasers: of the team.
        neighbors: [cells, actions] int32, the cell after each action.
        teams: [teams, chasers] int32, the cells of every team.
        nexts: [teams, joint actions] int32, the team after each joint action.
        parts: [joint actions, chasers] int64, each chaser's part of a joint action.
    """

    num_chasers: int
    neighbors: NDArray[np.int32] = field(repr=False)
    teams: NDArray[np.int32] = field(repr=False)
    nexts: NDArray[np.int32] = field(repr=False)
    parts: NDArray[np.int64] = field(repr=False)

    @property
    def size(self) -> int:
        """Cells of the maze."""
        return len(self.neighbors)

    @property
    def shape(self) -> tuple[int, ...]:
        """[chaser cell, ..., evader cell]."""
        return (self.size,) * (self.num_chasers + 1)

    @cached_property
    def apart(self) -> NDArray[np.bool_]:
        """[teams, cells] bool: where no chaser stands on the evader."""
        return (self.teams[:, :, None] != np.arange(self.size)).all(axis=1)

    @cached_property
    def random_moves(self) -> NDArray[np.float64]:
        """[cells, actions] float64: uniform over the moves that change the cell, as `RandomAgent`
        plays; an enclosed agent stays, or bumps into the north wall."""
        moves = (self.neighbors != np.arange(self.size)[:, None]).astype(np.float64)
        moves[moves.sum(axis=1) == 0.0, -1 if moves.shape[1] == 5 else 0] = 1.0
        chances: NDArray[np.float64] = moves / moves.sum(axis=1, keepdims=True)
        return chances

    @cached_property
    def sorted_teams(self) -> NDArray[np.int64]:
        """The teams whose cells are in order: every other one is one of them with names changed."""
        found: NDArray[np.int64] = np.flatnonzero((np.diff(self.teams, axis=1) >= 0).all(axis=1))
        return found

    @cached_property
    def twins(self) -> NDArray[np.int64]:
        """[teams] int64, the sorted team of the same cells."""
        return self.number(np.sort(self.teams, axis=1))

    def number(self, teams: NDArray[np.integer]) -> NDArray[np.int64]:
        """[...] int64, the numbers of teams given by their cells [..., chasers]."""
        number = np.zeros(teams.shape[:-1], dtype=np.int64)
        for chaser in range(self.num_chasers):
            number = number * self.size + teams[..., chaser]
        return number

    def rename(self, chaser_policy: NDArray[np.float64]) -> None:
        """Give every team the joint policy [teams, cells, joint actions] of its twin, in place."""
        actions = self.neighbors.shape[1]
        for order in permutations(range(self.num_chasers)):
            ordered = self.teams[:, order]
            here = (ordered[:, :-1] <= ordered[:, 1:]).all(axis=1)
            here &= self.twins != np.arange(len(self.teams))
            # The twin's chaser i is this team's chaser order[i], and so is its part.
            joint = np.zeros(len(self.parts), dtype=np.int64)
            for chaser in order:
                joint = joint * actions + self.parts[:, chaser]
            chaser_policy[here] = chaser_policy[self.twins[here]][:, :, joint]


def places_of(maze: Maze, num_chasers: int, stay_action: bool) -> Places:
    """The places of one evader and this many chasers."""
    size, actions = maze.num_cells, 5 if stay_action else 4
    neighbors = np.ascontiguousarray(maze.neighbors[:, :actions])
    teams = np.indices((size,) * num_chasers, dtype=np.int32).reshape(num_chasers, -1).T.copy()
    parts = np.indices((actions,) * num_chasers, dtype=np.int64).reshape(num_chasers, -1).T.copy()
    nexts = np.zeros((len(teams), len(parts)), dtype=np.int32)
    for chaser in range(num_chasers):
        nexts *= np.int32(size)
        nexts += neighbors[teams[:, chaser]][:, parts[:, chaser]]
    return Places(num_chasers, neighbors, teams, nexts, parts)


def distinct_moves(neighbors: NDArray[np.int32]) -> NDArray[np.bool_]:
    """[cells, actions] bool: False for an action that leads where an earlier one does."""
    useful = np.ones(neighbors.shape, dtype=bool)
    for action in range(1, neighbors.shape[1]):
        useful[:, action] = (neighbors[:, :action] != neighbors[:, action : action + 1]).all(axis=1)
    return useful
