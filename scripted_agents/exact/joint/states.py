"""The states of a game as a whole: how many there are, their numbers, and which of them are starts.

A *state* is all that the rest of a game depends on: which evaders are free, the cells of all free
agents, and the cells that hold goals. Which agents collected goals is not part of it, as it
has no effect on the rest. `kernels` describes how states are numbered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from pursuit.rules import layout
from pursuit.rules.layout import Games
from pursuit.tasks.task import Task
from pursuit.validation import as_array, whole
from scripted_agents.exact.joint.kernels import fill_games, fill_numbers
from scripted_agents.exact.joint.layout import Numbering
from scripted_agents.exact.limits import count_joint_states

AT_ONCE = 65_536
"""States that are looked at in one pass, where all at once would not fit into memory."""


@dataclass(frozen=True, eq=False)
class JointStates:
    """The states of a task in one maze, by number; see `joint_states_of`.

    Attributes:
        task: the game.
        count: how many states there are.
        numbering: their groups (free evaders) and sets (which cells hold goals), for kernels.
    """

    task: Task
    count: int
    numbering: Numbering = field(repr=False)

    def games(self, first: int, count: int) -> tuple[Games, NDArray[np.bool_]]:
        """Games in the states from `first` on.

        Goals are in the order of their cells, absent ones last; captured evaders are where
        the first chaser is.

        Returns:
            The games, and [count] bool: whether a state can occur between steps, that is, without a
            collector in the cell of a goal, an evader on an exit or, where that is always a
            capture, a chaser in the cell of a free evader.
        """
        task = self.task
        games = layout.empty_games(count, task.num_agents, task.num_goals, task.most_exits)
        real = np.zeros(count, dtype=np.bool_)
        always = task.options[:3] == layout.PLAIN[:3]
        fill_games(games, task.teams, task.max_cells, self.numbering, first, always, real)
        return games, real

    def numbers(self, games: Games) -> NDArray[np.int64]:
        """[games] int64, the states of any games of the task; -1 for one that is over."""
        numbers = np.empty(len(games.steps), dtype=np.int64)
        task, own = self.task, layout.copied_games(games, slice(None))  # one type: compiled once
        fill_numbers(own, task.teams, task.max_cells, self.numbering, numbers)
        return numbers

    def chunks(self, first: int = 0) -> Iterator[tuple[int, Games, NDArray[np.bool_]]]:
        """All states from `first` on, some after the other: the number of the first, and `games`
        of them."""
        for number in range(first, self.count, AT_ONCE):
            yield number, *self.games(number, min(AT_ONCE, self.count - number))

    def starts(self, least: int | None = None) -> Iterator[NDArray[np.int64]]:
        """The numbers of all states that an episode can begin with, all equally likely, in parts.

        All agents and goals are in different cells, chasers and evaders are at least `least`
        path steps apart (by default the task's `min_start_distance`), evaders and goals are on no
        exit. With `start="marks"` all agents and goals with a mark are on it.
        """
        task, maze = self.task, self.task.mazes[0]
        least = task.min_start_distance if least is None else whole("least", least)
        numbering = self.numbering
        first = int(numbering.offsets[-2])
        if task.num_goals and len(numbering.exits) == 1:
            first += int(numbering.bases[task.num_goals] * numbering.sizes[-1])
        agents, goals = self._marked
        for number, games, good in self.chunks(first):
            cells = np.sort(np.concatenate([games.position, games.goal], axis=1), axis=1)
            good &= (np.diff(cells, axis=1) != 0).all(axis=1)
            for chaser in range(task.num_chasers):
                for evader in range(task.num_chasers, task.num_chasers + task.num_evaders):
                    away = maze.distances[games.position[:, chaser], games.position[:, evader]]
                    good &= away >= least
            for agent, cell in agents.items():
                good &= games.position[:, agent] == cell
            for cell in goals:
                good &= (games.goal == cell).any(axis=1)
            good &= (games.steps == 0) & (games.goal >= 0).all(axis=1)
            good &= ~(games.goal[:, :, None] == games.exit[:, None]).any(axis=(1, 2))
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

    def mean_over_starts(
        self, values: NDArray[np.float64], least: int | None = None
    ) -> NDArray[np.float64]:
        """[...] float64, the mean of `values` [states, ...] over `starts`.

        Raises:
            ValueError: there are none, or other values.
        """
        rule = f"give a number for each of the {self.count:,} states"
        values = as_array("values", values, "biuf", rule)
        if values.shape[:1] != (self.count,):
            raise ValueError(f"values of shape {values.shape}; {rule}")
        total, count = np.zeros(values.shape[1:]), 0.0
        for numbers in self.starts(least):
            weights = self.weights(numbers)
            if weights is None:
                total += values[numbers].sum(axis=0)
                count += len(numbers)
            else:
                total += np.tensordot(weights, values[numbers], axes=1)
                count += float(weights.sum())
        if count == 0:
            raise ValueError(
                f"min_start_distance {self.task.min_start_distance}: no start is so far apart"
            )
        return np.asarray(total / count)

    def weights(self, numbers: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """[starts] float64, how likely each of these starts is; None if all are equally likely.

        Goals are drawn last, from the cells without agent and exit, so that each place is likelier
        where an agent is on an exit.
        """
        task = self.task
        if not task.num_goals or not task.most_exits:
            return None
        if task.start == "marks":
            raise ValueError("starts at marks with goals and exits: no mean over starts is known")
        if not len(numbers):
            return np.zeros(0)
        first = int(numbers[0])
        games, _ = self.games(first, int(numbers[-1]) - first + 1)
        cells, exits = games.position[numbers - first], games.exit[numbers - first]
        shared = (cells[:, :, None] == exits[:, None]).sum(axis=(1, 2))
        free = task.max_cells - task.num_agents - (exits >= 0).sum(axis=1) + shared
        ways = [comb(count, task.num_goals) for count in range(task.max_cells + 1)]
        return 1.0 / np.array(ways, dtype=np.float64)[free]


def joint_states_of(task: Task) -> JointStates:
    """The states of a task; `check_joint_states` goes first.

    Raises:
        ValueError: as `count_joint_states`.
    """
    count = count_joint_states(task)
    cells, evaders, goals = task.max_cells, task.num_evaders, task.num_goals
    masks = sorted(range(min(evaders, 1), 2**evaders), key=lambda mask: (mask.bit_count(), mask))
    others, halves = task.num_chasers + task.num_runners, task.steps_per_round
    exits = exit_sets_of(task)
    sizes = [halves * cells ** (others + mask.bit_count()) for mask in masks]
    group_of = np.full(2**evaders, -1, dtype=np.int64)
    group_of[masks] = np.arange(len(masks))
    bases = [0, *np.cumsum([0, *(comb(cells, left) for left in range(1, goals + 1))]).tolist()]
    sets = np.full((max(bases[-1], 1), goals), -1, dtype=np.int32)
    for left in range(1, goals + 1):
        sets[bases[left] : bases[left + 1], :left] = _sets_of(cells, left)
    most = max(goals, exits.shape[1])
    binomials = [[comb(cell, left) for left in range(most + 1)] for cell in range(cells)]
    offsets = np.concatenate([[0], np.cumsum(np.array(sizes) * len(sets) * len(exits))])
    numbering = Numbering(
        masks=np.array(masks, dtype=np.int64),
        offsets=offsets.astype(np.int64),
        sizes=np.array(sizes, dtype=np.int64),
        group_of=group_of,
        sets=sets,
        binomials=np.array(binomials, dtype=np.int64),
        bases=np.array(bases, dtype=np.int64),
        halves=halves,
        exits=exits,
    )
    return JointStates(task, count, numbering)


def exit_sets_of(task: Task) -> NDArray[np.int32]:
    """[sets, exits] int32: the fixed exits of a task in one maze, or all sets that it can draw."""
    if task.num_exits:
        return _sets_of(task.max_cells, task.num_exits)
    return np.array([task.fixed_exits[0]], dtype=np.int32).reshape(1, -1)


def _sets_of(cells: int, size: int) -> NDArray[np.int32]:
    """[sets, size] int32: all sets of so many cells, the place of each set its number.

    In the order of the largest cell, then of the next: the place of cells c1 < c2 < ... is
    C(c1, 1) + C(c2, 2) + ... (Lehmer, 1964).
    """
    chosen = np.array(list(combinations(range(cells), size)), dtype=np.int32)
    return chosen[np.lexsort(chosen.T)]
