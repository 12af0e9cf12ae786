"""The states of a game as a whole: how many there are, their numbers, and which of them are starts.

A *state* is all that the rest of a game depends on: who is still free, the cells of all free
agents, and the cells that hold goals. By whom goals were collected is no part of it: it changes
nothing of what comes. How states are numbered stands in `joint_kernels`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.maze import MAX_TABLE_CELLS
from pursuit.maze_arrays import lay_out
from pursuit.memory import check_memory
from pursuit.rules import layout
from pursuit.rules.layout import Games
from pursuit.task import Task
from scripted_agents.joint_kernels import fill_games

MAX_STATES = 10**8
"""Above this number of states a game is not solved."""

MAX_BYTES = 8 * 10**9
"""Nor above this much memory."""

AT_ONCE = 65_536
"""States that are looked at in one pass, where all at once would not fit into memory."""

REMEDY = "take a smaller maze, fewer agents or fewer goals, or play episodes"


def count_joint_states(task: Task) -> int:
    """How many states a task has, counted without making any.

    The sum over the sets of free evaders (one at least, where there are evaders) of n to the number
    of free agents, times the sets of 1 to `num_goals` of the n cells (1 where there are no goals).

    Raises:
        ValueError: the task is played in several mazes.
    """
    if len(task.mazes) > 1:
        raise ValueError(
            f"task {task.name!r} is played in {len(task.mazes)} mazes; states are counted and "
            "solved in one: give one maze"
        )
    cells, evaders = task.max_cells, task.num_evaders
    others = task.num_chasers + task.num_runners
    places = sum(
        comb(evaders, free) * cells ** (others + free)
        for free in range(min(evaders, 1), evaders + 1)
    )
    sets = sum(comb(cells, left) for left in range(1, task.num_goals + 1))
    return places * (sets if task.num_goals else 1)


def check_joint_states(task: Task, most: int = MAX_STATES, each: int = 0) -> int:
    """The number of states of a task, if it is not too large to be solved.

    Args:
        task: the game.
        most: states that are solved.
        each: bytes that a state takes.

    Raises:
        ValueError: more states than `most`, more memory than MAX_BYTES or than is free, or a task
            that has no states (`count_joint_states`).
    """
    states = count_joint_states(task)
    told = (
        f"task {task.name!r} on {task.mazes[0].name}: {states:,} states ({task.max_cells} cells, "
        f"{task.num_agents} agents, {task.num_goals} goals)"
    )
    if states > most:
        raise ValueError(f"{told}; at most {most:,} are solved: {REMEDY}")
    if task.max_cells > MAX_TABLE_CELLS:
        raise ValueError(f"{told}; mazes are solved up to {MAX_TABLE_CELLS} cells: {REMEDY}")
    sets = sum(comb(task.max_cells, left) for left in range(1, task.num_goals + 1))
    needed = states * each + 4 * sets * task.num_goals
    check_memory(told, needed, REMEDY, MAX_BYTES)
    return states


@dataclass(frozen=True, eq=False)
class JointStates:
    """The states of a task in one maze, by number; see `joint_states_of`.

    Attributes:
        task: the game.
        count: how many states there are.
        masks: [groups] int64, bit e for evader number e that is free.
        offsets: [groups + 1] int64, the first state of each group.
        sizes: [groups] int64, the states of one set of goals.
        group_of: [2**evaders] int64, the group of a mask; -1 where nobody is free.
        sets: [sets, goals] int32, cells in order; -1 behind the last.
        binomials: [cells, goals + 1] int64, ways to choose so many of so many cells.
        bases: [goals + 2] int64, the first set of so many goals.
    """

    task: Task
    count: int
    masks: NDArray[np.int64] = field(repr=False)
    offsets: NDArray[np.int64] = field(repr=False)
    sizes: NDArray[np.int64] = field(repr=False)
    group_of: NDArray[np.int64] = field(repr=False)
    sets: NDArray[np.int32] = field(repr=False)
    binomials: NDArray[np.int64] = field(repr=False)
    bases: NDArray[np.int64] = field(repr=False)

    @property
    def for_kernels(self) -> tuple[NDArray[np.integer], ...]:
        """The arrays as `joint_kernels.Numbering` has them."""
        return (
            self.masks,
            self.offsets,
            self.sizes,
            self.group_of,
            self.sets,
            self.binomials,
            self.bases,
        )

    def games(self, first: int, count: int) -> tuple[Games, NDArray[np.bool_]]:
        """Games that stand in the states from `first` on, none of which was ever played.

        Goals are in the order of their cells, absent ones last; captured evaders stand where the
        first chaser does.

        Returns:
            The games, and [count] bool: whether a state can stand between two steps at all. In no
            game a chaser stands on a free evader, or somebody who collects goals on one.
        """
        task = self.task
        games = layout.empty_games(count, task.num_agents, task.num_goals)
        real = np.zeros(count, dtype=np.bool_)
        fill: Any = fill_games
        fill(*games, tuple(task.teams), task.max_cells, *self.for_kernels, first, real)
        return games, real

    def numbers(self, games: Games) -> NDArray[np.int64]:
        """[games] int64, the states of any games of the task; -1 for one that is over."""
        task = self.task
        count, cells, chasers = len(games.steps), task.max_cells, task.num_chasers
        mask, place = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        for agent in range(task.num_agents):
            free = games.active[:, agent] != 0
            place = np.where(free, place * cells + games.position[:, agent], place)
            if chasers <= agent < chasers + task.num_evaders:
                mask |= free.astype(np.int64) << (agent - chasers)
        group = self.group_of[mask]
        number = self.offsets[group] + place
        if task.num_goals:
            ordered = np.sort(games.goal, axis=1)  # absent ones first
            there = ordered >= 0
            rank = there.cumsum(axis=1)
            of_each = self.binomials[np.maximum(ordered, 0), rank]
            left = there.sum(axis=1)
            number += (self.bases[left] + (of_each * there).sum(axis=1)) * self.sizes[group]
            group = np.where(left == 0, -1, group)
        return np.where(group < 0, -1, number)

    def chunks(self, first: int = 0) -> Iterator[tuple[int, Games, NDArray[np.bool_]]]:
        """All states from `first` on, some after the other: the number of the first, and `games`
        of them."""
        for number in range(first, self.count, AT_ONCE):
            yield number, *self.games(number, min(AT_ONCE, self.count - number))

    def starts(self) -> Iterator[NDArray[np.int64]]:
        """The numbers of all states that an episode can begin with, all equally likely, in parts.

        Everybody and every goal has a cell of its own, chasers and evaders are at least
        `min_start_distance` path steps apart; with `start="marks"` who has a mark stands on it.
        """
        task, maze = self.task, self.task.mazes[0]
        first = int(self.offsets[-2])
        if task.num_goals:
            first += int(self.bases[task.num_goals] * self.sizes[-1])
        agents, goals = self._marked
        for number, games, good in self.chunks(first):
            cells = np.sort(np.concatenate([games.position, games.goal], axis=1), axis=1)
            good &= (np.diff(cells, axis=1) != 0).all(axis=1)
            for chaser in range(task.num_chasers):
                for evader in range(task.num_chasers, task.num_chasers + task.num_evaders):
                    away = maze.distances[games.position[:, chaser], games.position[:, evader]]
                    good &= away >= task.min_start_distance
            for agent, cell in agents.items():
                good &= games.position[:, agent] == cell
            for cell in goals:
                good &= (games.goal == cell).any(axis=1)
            yield number + np.flatnonzero(good)

    @cached_property
    def _marked(self) -> tuple[dict[int, int], list[int]]:
        """The cells of agents on marks, and those of goals on marks, at starts."""
        task, maze = self.task, self.task.mazes[0]
        agents: dict[int, int] = {}
        if task.start != "marks":
            return agents, []
        marks = [int(cell) for cell in maze.goal_marks]
        if maze.start_mark is not None:
            agents[0] = int(maze.start_mark)
        if task.num_goals:
            return agents, marks[: task.num_goals]
        evaders = range(task.num_chasers, task.num_chasers + task.num_evaders)
        return agents | dict(zip(evaders, marks, strict=False)), []

    def mean_over_starts(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """[...] float64, the mean of `values` [states, ...] over the starts that the game draws."""
        total, count = np.zeros(values.shape[1:]), 0
        for numbers in self.starts():
            total += values[numbers].sum(axis=0)
            count += len(numbers)
        if count == 0:
            raise ValueError(
                f"min_start_distance {self.task.min_start_distance}: no start is so far apart"
            )
        return np.asarray(total / count)


def joint_states_of(task: Task) -> JointStates:
    """The states of a task; `check_joint_states` goes first.

    Raises:
        ValueError: as `count_joint_states`.
    """
    count = count_joint_states(task)
    cells, evaders, goals = task.max_cells, task.num_evaders, task.num_goals
    masks = sorted(range(min(evaders, 1), 2**evaders), key=lambda mask: (mask.bit_count(), mask))
    others = task.num_chasers + task.num_runners
    sizes = np.array([cells ** (others + mask.bit_count()) for mask in masks], dtype=np.int64)
    group_of = np.full(2**evaders, -1, dtype=np.int64)
    group_of[masks] = np.arange(len(masks))
    bases = [0, *np.cumsum([0, *(comb(cells, left) for left in range(1, goals + 1))]).tolist()]
    sets = np.full((max(bases[-1], 1), goals), -1, dtype=np.int32)
    for left in range(1, goals + 1):
        # In the order of the largest cell, then of the next: the place of cells c1 < c2 < ... is
        # C(c1, 1) + C(c2, 2) + ... (Lehmer, 1964).
        chosen = np.array(list(combinations(range(cells), left)), dtype=np.int32)
        sets[bases[left] : bases[left + 1], :left] = chosen[np.lexsort(chosen.T)]
    binomials = [[comb(cell, left) for left in range(goals + 1)] for cell in range(cells)]
    offsets = np.concatenate([[0], np.cumsum(sizes * len(sets))])
    return JointStates(
        task,
        count,
        np.array(masks, dtype=np.int64),
        offsets.astype(np.int64),
        sizes,
        group_of,
        sets,
        np.array(binomials, dtype=np.int64),
        np.array(bases, dtype=np.int64),
    )


def arrays_of_task(task: Task) -> tuple[NDArray[np.generic], ...]:
    """The rules and the maze as kernels take them: numbers, pay, and the arrays of the maze."""
    return (task.numbers_for_kernels(), task.rewards_for_kernels(), *lay_out(task.mazes))
