"""Sweeps over all states of a game, in an order in which sets of states converge."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze_arrays import lay_out
from pursuit.memory import check_memory
from pursuit.rules import layout
from scripted_agents.exact.joint.kernels import FILL_STORE
from scripted_agents.exact.joint.layout import (
    NO_SLIPS,
    Backup,
    Players,
    Quantities,
    Store,
    Workspace,
)
from scripted_agents.exact.joint.opponents import OtherPolicies
from scripted_agents.exact.joint.states import JointStates
from scripted_agents.exact.joint.sweep_kernels import list_optimal, sweep
from scripted_agents.exact.limits import MAX_STORE_BYTES
from scripted_agents.exact.long_work import Solving
from scripted_agents.exact.tolerances import JOINT_TOLERANCE, MAX_SWEEPS, MAX_THREADS, SWEEP_WINDOW

SAME = 1e-14
"""Change, relative to the largest value, below which backward induction has converged."""

MOST_TOGETHER = 16_384
"""States of one part of a sweep: the parts are shared out to threads."""

THREADED_STATES = 100_000
"""From this number of states on a sweep is worth sharing out to threads."""


@dataclass(frozen=True)
class Quantity:
    """A quantity that is summed over the steps of a game.

    Attributes:
        reward_weights: [agents], the weight of each agent's reward.
        lasting: [agents], 1: a step counts 1 while any of these agents is free.
        ending: the value of the end of the game.
    """

    reward_weights: Sequence[float]
    lasting: Sequence[int]
    ending: float = 0.0


@dataclass(frozen=True, eq=False)
class Problem:
    """The arguments of sweeps.

    Attributes:
        states: of the game.
        deciding: the indices of the deciding agents, which minimise the first quantity.
        others: the policies of the other agents, by index.
        quantities: the quantities.
        sign: -1 to maximise the first quantity.
        discount: of each step.
        only_whether: 1 for values above 0.
        moves_first: of equally good actions moves are chosen before standing still.
    """

    states: JointStates
    deciding: tuple[int, ...]
    others: OtherPolicies
    quantities: tuple[Quantity, ...]
    sign: float = 1.0
    discount: float = 1.0
    only_whether: bool = False
    moves_first: bool = True

    def for_kernels(self) -> tuple[Any, ...]:
        """The game, its players and quantities: the arguments of `sweep`."""
        task, wanted = self.states.task, self.quantities
        players = [*((seat,) for seat in self.deciding), *self.others.players]
        return (
            task.numbers_for_kernels(),
            task.rewards_for_kernels(),
            lay_out(task.mazes),
            layout.scratch_for(task.max_cells, task.num_agents, task.num_goals),
            self.states.numbering,
            Players(
                np.array([seat for seats in players for seat in seats], dtype=np.int64),
                np.cumsum([0, *map(len, players)], dtype=np.int64),
                len(self.deciding),
                self.moves_first,
                self.others.codes,
                self.others.rows,
            ),
            Quantities(
                np.array([q.reward_weights for q in wanted], dtype=np.float64),
                np.array([q.lasting for q in wanted], dtype=np.int64),
                np.array([q.ending for q in wanted], dtype=np.float64),
            ),
        )

    def workspace(self) -> Workspace:
        """Scratch memory of one state."""
        task, number = self.states.task, len(self.quantities)
        agents, goals = task.num_agents, task.num_goals
        most = task.num_actions ** max([1, *map(len, self.others.players)])
        return Workspace(
            cells=np.zeros(agents, dtype=np.int64),
            active=np.zeros(agents, dtype=np.int64),
            goals=np.zeros(goals, dtype=np.int64),
            actions=np.zeros((1, agents), dtype=np.int32),
            option=np.zeros((agents, most), dtype=np.int64),
            many=np.zeros(agents, dtype=np.int64),
            keeps=np.zeros(agents, dtype=np.int64),
            pick=np.zeros(agents, dtype=np.int64),
            chance=np.zeros((agents, most)),
            worth=np.zeros((task.num_actions ** len(self.deciding), number)),
            best=np.zeros(number),
        )

    @cached_property
    def levels(self) -> list[NDArray[np.int64]]:
        """[sets, 2] of each level, the first state of a set of goals (and exits) and the one after
        its last.

        A step leads to the same set, or to a set of an earlier level. Groups without agents that
        count are omitted, as their values are 0.
        """
        numbering, found = self.states.numbering, []
        for group, mask in enumerate(numbering.masks.tolist()):
            if not self.counts(mask):
                continue
            size, each = numbering.sizes[group], len(numbering.sets)
            bases = numbering.bases[1:].tolist() if self.states.task.num_goals else [0, 1]
            for first, last in pairwise(bases):
                of_exits = each * np.arange(len(numbering.exits))[:, None]
                sets = (of_exits + np.arange(first, last)).ravel()
                begins = numbering.offsets[group] + size * sets
                found.append(np.stack([begins, begins + size], axis=1))
        return found

    def counts(self, mask: int) -> bool:
        """Whether any agent that counts is free, if these evaders are."""
        task = self.states.task
        for agent in range(task.num_agents):
            evader = agent - task.num_chasers
            captured = 0 <= evader < task.num_evaders and not mask >> evader & 1
            if not captured and any(
                q.reward_weights[agent] or q.lasting[agent] for q in self.quantities
            ):
                return True
        return any(q.ending and not any(q.lasting) for q in self.quantities)


class Sweeper:
    """Sweeps over a problem, with its threads; a context manager.

    Args:
        problem: the arguments of sweeps.
        values: [states, quantities] float64, the initial values.
        choice: [states] int16, output: the joint actions of the deciding players.

    Attributes:
        later: [states, quantities] float64, the values after the step that `choice` is for.

    Raises:
        ValueError: the transitions do not fit into memory.
    """

    def __init__(
        self, problem: Problem, values: NDArray[np.float64], choice: NDArray[np.int16]
    ) -> None:
        self.problem, self.values, self.choice = problem, values, choice
        self.later = values
        self._solving = Solving(f"exact solution of {len(values):,} states")
        self.store = filled_store(problem)
        self._backup = Backup(problem.sign, problem.discount, problem.only_whether)
        self._threads = threads_for(len(values))
        self._rooms = [problem.workspace() for _ in range(self._threads)]
        self._pool = ThreadPoolExecutor(self._threads)

    def __enter__(self) -> Sweeper:
        return self

    def __exit__(self, *raised: object) -> None:
        self._pool.shutdown()

    def converge(self) -> bool:
        """Sweep until the values converge, level after level; return whether they do."""
        discount = self.problem.discount
        for level in self.problem.levels:
            going = np.arange(len(level))
            before, past, now = np.zeros((3, len(level)))
            past[:] = 1.0
            for number in range(1, MAX_SWEEPS + 1):
                self._solving(np.nan)
                change, largest = self.sweep(level[going], self.values)
                scale = np.maximum(largest, 1.0)
                # Further changes are about a geometric series; its rate is that of two windows.
                rate = np.divide(change, before[going], out=np.zeros_like(change), where=number > 1)
                now[going] = np.maximum(now[going], rate)
                rate, before[going] = np.maximum(past[going], now[going]), change
                if number % SWEEP_WINDOW == 0:
                    past, now = now, np.zeros_like(now)
                done = change <= 1e-15 * scale
                if discount < 1.0:
                    done |= change * discount <= (1.0 - discount) * JOINT_TOLERANCE * scale
                done |= (rate < 1.0) & (change * rate <= (1.0 - rate) * JOINT_TOLERANCE * scale)
                going = going[~done]
                if len(going) == 0:
                    break
            else:
                return False
        return True

    def steps(self, horizon: int) -> Iterator[int]:
        """Backward induction, yielding the number of steps: to the horizon, or until no value
        changes by more than SAME of the largest value.

        `values` and `choice` are then those of this step.
        """
        parts = np.concatenate([_cut(level) for level in self.problem.levels])
        target = self.values.copy()
        for step in range(1, horizon + 1):
            self._solving(step / horizon)
            change, largest = self.sweep(parts, target)
            self.values, target = target, self.values
            self.later = target
            yield step
            if (change <= SAME * np.maximum(largest, 1.0)).all():
                return

    def sweep(
        self, segments: NDArray[np.int64], target: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sweep once; the largest change of each segment [n], and its largest value [n]."""
        changes = np.zeros((len(segments), 2))
        bounds = [len(segments) * i // self._threads for i in range(self._threads + 1)]

        def part(number: int) -> None:
            own = slice(bounds[number], bounds[number + 1])
            sweep(
                self._rooms[number], self.store, self._backup, self.values, target, self.choice,
                segments[own], changes[own],
            )  # fmt: skip

        if self._threads == 1:
            part(0)
        else:
            list(self._pool.map(part, range(self._threads)))
        return changes[:, 0], changes[:, 1]

    def optimal(self) -> NDArray[np.bool_] | None:
        """[states, actions] bool, all optimal actions of the step that `choice` is for, of those
        that keep the cell only the one that `choice` can hold; None unless one agent decides."""
        if len(self.problem.deciding) != 1:
            return None
        actions = self.problem.states.task.num_actions
        optimal = np.zeros((self.problem.states.count, actions), dtype=bool)
        list_optimal(self._rooms[0], self.store, self._backup, self.later, optimal)
        return optimal


def threads_for(states: int) -> int:
    """The number of threads for so many states."""
    return min(os.cpu_count() or 1, MAX_THREADS) if states >= THREADED_STATES else 1


def _cut(level: NDArray[np.int64]) -> NDArray[np.int64]:
    """[parts, 2] the sets of a level in parts of at most MOST_TOGETHER states."""
    size = int(level[0, 1] - level[0, 0])
    pieces = -(-size // MOST_TOGETHER)
    ends = level[:, :1] + np.array([size * i // pieces for i in range(pieces + 1)])
    return np.stack([ends[:, :-1].ravel(), ends[:, 1:].ravel()], axis=1)


# -- what is kept ----------------------------------------------------------------------------------


def filled_store(problem: Problem, wanted: NDArray[np.bool_] | None = None) -> Store:
    """The transitions of all states, or of the `wanted` ones [states].

    Raises:
        ValueError: they do not fit into memory.
    """
    store = _empty_store(problem, wanted)
    task, count = problem.states.task, problem.states.count
    threads = threads_for(count)
    bounds = [count * i // threads for i in range(threads + 1)]

    def part(number: int) -> None:
        memory = layout.allocate(1, task.num_agents, task.num_goals, task.most_exits)
        memory = memory._replace(rewards=memory.rewards.astype(np.float64))
        own = bounds[number], bounds[number + 1]
        kind = task.is_duel, task.num_goals > 0, task.options == layout.PLAIN
        FILL_STORE[kind](memory, *problem.for_kernels(), problem.workspace(), store, *own)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(part, range(threads)))
    return store


def _empty_store(problem: Problem, wanted: NDArray[np.bool_] | None) -> Store:
    """A store with space for the transitions of the states."""
    states, number, task = problem.states, len(problem.quantities), problem.states.task
    slips = np.array([task.slips[seat] for seat in problem.deciding])
    axes = np.zeros((states.count, len(slips), 2), dtype=np.int16)
    cells = task.mazes[0].neighbors[:, : task.num_actions].tolist()
    ways = np.array([len(set(row)) for row in cells])  # different cells that actions lead to
    pairs, edges = np.zeros((2, states.count + 1), dtype=np.int64)
    for first, games, real in states.chunks():
        last = first + len(real)
        kept = real if wanted is None else real & wanted[first:last]
        options = np.where(games.active != 0, ways[games.position], 1)
        ours = options[:, list(problem.deciding)].prod(axis=1)
        theirs = options.prod(axis=1) // ours
        pairs[first + 1 : last + 1] = ours * theirs * kept
        edges[first + 1 : last + 1] = (ours * number + theirs) * kept
    np.cumsum(pairs, out=pairs)
    np.cumsum(edges, out=edges)
    check_memory(
        f"task {task.name!r}: a table of the transitions of {states.count:,} states",
        24 * states.count + 4 * int(pairs[-1]) + 10 * int(edges[-1]),
        "take a smaller maze, or fewer agents or goals",
        MAX_STORE_BYTES,
    )
    return Store(
        pairs,
        edges,
        np.zeros((states.count, 4), dtype=np.int32),
        np.zeros(pairs[-1], dtype=np.int32),
        np.zeros(edges[-1]),
        np.zeros(edges[-1], dtype=np.int16),
        *((slips, axes) if slips.any() else NO_SLIPS),
    )
