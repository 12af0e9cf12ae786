"""Sweeps over all states of a game, in an order in which they can be settled."""

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

from pursuit.memory import free_memory
from pursuit.rules import layout
from scripted_agents.joint_kernels import MOST_ACTIONS, sweep
from scripted_agents.joint_opponents import Others
from scripted_agents.joint_states import JointStates, arrays_of_task
from scripted_agents.joint_stored_kernels import sweep_stored

SAME = 1e-14
"""Change, relative to the largest value, below which one more step back changes nothing."""

WINDOW = 9
"""How many changes in a row tell the rate at which they shrink."""

MAX_STORE_BYTES = 2 * 10**9
"""Bound on what is kept of the steps that follow each state."""

TOLERANCE = 1e-10
"""How exact a settled state is, relative to the largest value beside it."""

MAX_SWEEPS = 100_000

MOST_TOGETHER = 16_384
"""States of one part of a sweep: the parts are shared out to threads."""

THREADED_STATES = 100_000
"""From this number of states on a sweep is worth sharing out to threads."""

MAX_THREADS = 8


@dataclass(frozen=True)
class Quantity:
    """What is summed up along a game.

    Attributes:
        paid: [agents], how much of what each is paid counts.
        lasting: [agents], 1: a step counts 1 as long as any of these is free.
        ending: what the end of the game counts.
    """

    paid: Sequence[float]
    lasting: Sequence[int]
    ending: float = 0.0


@dataclass(frozen=True, eq=False)
class Problem:
    """What is swept over.

    Attributes:
        states: of the game.
        deciding: the seats that decide; of the first quantity they make as little as they can.
        others: what the other seats play, in the order of their numbers.
        quantities: what is summed up.
        sign: -1 to make as much of it.
        discount: of what the next step counts.
        only_whether: 1 for whatever is above 0.
    """

    states: JointStates
    deciding: tuple[int, ...]
    others: Others
    quantities: tuple[Quantity, ...]
    sign: float = 1.0
    discount: float = 1.0
    only_whether: bool = False

    @property
    def order(self) -> tuple[int, ...]:
        """All seats, those that decide first."""
        task = self.states.task
        return self.deciding + tuple(s for s in range(task.num_agents) if s not in self.deciding)

    def worker(self) -> tuple[Any, ...]:
        """What `settle` is given first, with room of its own for one thread."""
        task, number = self.states.task, len(self.quantities)
        agents, goals = task.num_agents, task.num_goals
        return (
            *layout.allocate(1, agents, goals),
            *arrays_of_task(task),
            layout.scratch_for(task.max_cells, agents, goals),
            *self.states.for_kernels,
            np.array(self.order, dtype=np.int64),
            len(self.deciding),
            *self.others,
            np.array([q.paid for q in self.quantities], dtype=np.float64),
            np.array([q.lasting for q in self.quantities], dtype=np.int64),
            np.array([q.ending for q in self.quantities], dtype=np.float64),
            np.zeros(agents, dtype=np.int64),
            np.zeros(agents, dtype=np.int64),
            np.zeros(goals, dtype=np.int64),
            np.zeros((1, agents), dtype=np.int32),
            np.zeros((agents, MOST_ACTIONS), dtype=np.int64),
            np.zeros(agents, dtype=np.int64),
            np.zeros((agents, MOST_ACTIONS)),
            np.zeros(number),
            np.zeros(number),
            self.sign,
            self.discount,
            self.only_whether,
        )

    @cached_property
    def levels(self) -> list[NDArray[np.int64]]:
        """[sets, 2] of each level, the first state of a set of goals and the one after its last.

        What a step leads to is in the same set, or in one of an earlier level. Groups in which
        nobody counts are left out: there is nothing to come.
        """
        states, found = self.states, []
        for group, mask in enumerate(states.masks.tolist()):
            if not self._counts(mask):
                continue
            begins = states.offsets[group] + states.sizes[group] * np.arange(len(states.sets) + 1)
            bases = states.bases[1:].tolist() if states.task.num_goals else [0, 1]
            for first, last in pairwise(bases):
                found.append(np.stack([begins[first:last], begins[first + 1 : last + 1]], axis=1))
        return found

    def _counts(self, mask: int) -> bool:
        """Whether anybody who counts is free, where these evaders are."""
        task = self.states.task
        for agent in range(task.num_agents):
            evader = agent - task.num_chasers
            captured = 0 <= evader < task.num_evaders and not mask >> evader & 1
            if not captured and any(q.paid[agent] or q.lasting[agent] for q in self.quantities):
                return True
        return any(q.ending and not any(q.lasting) for q in self.quantities)


class Sweeper:
    """Sweeps over a problem, with its threads; a context manager.

    Args:
        problem: what is swept over.
        values: [states, quantities] float64, where it begins.
        choice: [states] int16, which gets the joint actions of those who decide.
        store: whether what follows each state is kept, where it fits into MAX_STORE_BYTES: then
            only the first sweep steps.
    """

    def __init__(
        self,
        problem: Problem,
        values: NDArray[np.float64],
        choice: NDArray[np.int16],
        store: bool = True,
    ) -> None:
        self.problem, self.values, self.choice = problem, values, choice
        threads = 1
        if len(values) >= THREADED_STATES:
            threads = min(os.cpu_count() or 1, MAX_THREADS)
        self._workers = [problem.worker() for _ in range(threads)]
        self._pool = ThreadPoolExecutor(threads)
        self.store = _store_for(problem) if store else None
        self._known = False

    def __enter__(self) -> Sweeper:
        return self

    def __exit__(self, *raised: object) -> None:
        self._pool.shutdown()

    def settle(self) -> bool:
        """Sweep until the values stay as they are, level after level; whether they do."""
        discount = self.problem.discount
        for level in self.problem.levels:
            going = np.arange(len(level))
            before, past, now = np.zeros((3, len(level)))
            past[:] = 1.0
            self._known = False
            for number in range(1, MAX_SWEEPS + 1):
                change, largest = self._run(level[going], self.values)
                self._known = self.store is not None
                scale = np.maximum(largest, 1.0)
                # The changes to come are about a geometric series; its rate is that of two windows.
                rate = np.divide(change, before[going], out=np.zeros_like(change), where=number > 1)
                now[going] = np.maximum(now[going], rate)
                rate, before[going] = np.maximum(past[going], now[going]), change
                if number % WINDOW == 0:
                    past, now = now, np.zeros_like(now)
                done = change <= 1e-15 * scale
                if discount < 1.0:
                    done |= change * discount <= (1.0 - discount) * TOLERANCE * scale
                done |= (rate < 1.0) & (change * rate <= (1.0 - rate) * TOLERANCE * scale)
                going = going[~done]
                if len(going) == 0:
                    break
            else:
                return False
        return True

    def steps(self, horizon: int) -> Iterator[int]:
        """One step further back at every turn, until the horizon, or until nothing changes any more
        (by more than SAME of the largest value).

        `values` and `choice` are those of so many steps then.
        """
        parts = [_cut(level) for level in self.problem.levels]
        moving = [np.ones(int(of[-1]) + 1, dtype=bool) for _, of in parts]
        target = self.values.copy()
        for step in range(1, horizon + 1):
            settled = True  # all earlier levels are
            for level, (segments, of) in enumerate(parts):
                going = moving[level]
                if not going.any():
                    continue
                mine = going[of]
                change, largest = self._run(segments[mine], target)
                if settled:
                    still = np.zeros(len(going), dtype=bool)
                    np.logical_or.at(still, of[mine], change > SAME * np.maximum(largest, 1.0))
                    moving[level] = still
                settled &= not moving[level].any()
            self._known = self.store is not None
            self.values, target = target, self.values
            yield step
            if not any(going.any() for going in moving):
                return

    def _run(
        self, segments: NDArray[np.int64], target: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sweep once; the largest change of each segment [n], and its largest value [n]."""
        changes = np.zeros((len(segments), 2))
        threads = len(self._workers)
        bounds = [len(segments) * i // threads for i in range(threads + 1)]

        def part(number: int) -> None:
            some = slice(bounds[number], bounds[number + 1])
            arrays = (self.values, target, self.choice, segments[some], changes[some])
            worker = self._workers[number]
            if self._known and self.store is not None:
                kernel: Any = sweep_stored
                kernel(*self.store, *worker[-5:], *arrays)
                return
            store = _NO_STORE if self.store is None else (True, *self.store)
            kernel = sweep
            kernel(*worker, *store, *arrays)

        if threads == 1:
            part(0)
        else:
            list(self._pool.map(part, range(threads)))
        return changes[:, 0], changes[:, 1]


def _cut(level: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """[parts, 2] the sets of a level in parts of at most MOST_TOGETHER states, and of which set
    each is [parts]."""
    size = int(level[0, 1] - level[0, 0])
    pieces = -(-size // MOST_TOGETHER)
    ends = np.array([size * i // pieces for i in range(pieces + 1)])
    begins = level[:, :1] + ends[None]
    parts = np.stack([begins[:, :-1].ravel(), begins[:, 1:].ravel()], axis=1)
    return parts, np.repeat(np.arange(len(level)), pieces)


# -- what is kept ----------------------------------------------------------------------------------

_NOTHING = np.zeros(1, dtype=np.int64)
_NO_STORE = (
    False,
    _NOTHING,
    _NOTHING,
    np.zeros((1, 2), dtype=np.uint8),
    np.zeros(1, dtype=np.int32),
    np.zeros(1),
    np.zeros(1, dtype=np.int16),
)


def _store_for(problem: Problem) -> tuple[NDArray[Any], ...] | None:
    """Room for what follows each state, as `joint_kernels.Store` has it; None for too much."""
    states, number = problem.states, len(problem.quantities)
    task = states.task
    neighbors = task.mazes[0].neighbors[:, : task.num_actions]
    ways = np.array([len(set(row)) for row in neighbors.tolist()], dtype=np.int64)
    most = min(MAX_STORE_BYTES, free_memory() // 2)
    if 34 * states.count > most:
        return None
    pairs, edges = np.zeros((2, states.count + 1), dtype=np.int64)
    for first, games, real in states.chunks():
        some = slice(first + 1, first + 1 + len(real))
        options = np.where(games.active != 0, ways[games.position], 1)
        ours = options[:, list(problem.deciding)].prod(axis=1)
        theirs = options.prod(axis=1) // ours
        if (np.maximum(ours, theirs) > 255).any():
            return None
        pairs[some], edges[some] = ours * theirs * real, (ours * number + theirs) * real
    np.cumsum(pairs, out=pairs)
    np.cumsum(edges, out=edges)
    if 18 * states.count + 4 * pairs[-1] + 10 * edges[-1] > most:
        return None
    return (
        pairs,
        edges,
        np.zeros((states.count, 2), dtype=np.uint8),
        np.zeros(pairs[-1], dtype=np.int32),
        np.zeros(edges[-1]),
        np.zeros(edges[-1], dtype=np.int16),
    )
