"""Opponents as tables: the action probabilities of networks for all pairs of cells.

In a duel a network without memory is a function of two cells. Snapshots never change, and the
latest opponent is constant between updates. So each network is evaluated once per rollout on all
pairs of cells, and actions are drawn from the table. The probabilities equal those of the network
up to rounding, as matrix products of other sizes round differently.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import GameView, Policy
from pursuit.tasks.task import Task
from train.networks.policy import LearnedPolicy

MAX_PAIRS = 2**16
"""Maximum number of pairs of cells in a table: 15 × 15 mazes fit, with 2 MB."""


class CellTables:
    """The tables of the members of a pool.

    Args:
        worth: maximum number of pairs of cells for tables of an opponent that learns: the frames of
            a rollout.
    """

    def __init__(self, worth: int) -> None:
        self.worth = worth
        self._kept: dict[int, tuple[Policy, int]] = {}  # by identity: the policy, and its place
        self._known: dict[int, int] = {}  # the version of the weights in the table of each place
        self._cumulative = np.empty((0, 0, 0))
        self._key: tuple[int, ...] = ()
        self._members: list[Policy | None] = []  # kept alive, as they are identified by id()
        self._places = np.zeros(0, dtype=np.int64)

    @property
    def cumulative(self) -> NDArray[np.float64]:
        """[tables, pairs of cells, actions], sums over the actions; live."""
        return self._cumulative

    def places(self, policies: Sequence[Policy | None], task: Task) -> NDArray[np.int64]:
        """[policies] the index of the table of each policy, updated; -1 for none.

        Args:
            policies: the members, None for those not in memory; all but the first never change.
            task: of the games; a duel in one maze, or there are no tables.
        """
        key = tuple(map(id, policies))
        if key != self._key:
            self._places = self._place(policies, task)
            self._key, self._members = key, list(policies)
        elif len(key) and self._places[0] >= 0:
            self._refresh(int(self._places[0]), self._members[0], task)
        return self._places

    def draw(
        self, places: NDArray[np.int64], view: GameView, games: Any, draws: NDArray[np.float64]
    ) -> NDArray[np.int32]:
        """[n] int32, the actions in some games of a view.

        Args:
            places: [n] of the table for each.
            view: all games.
            games: which n of them these are: indices or a slice.
            draws: [n] in [0, 1).
        """
        cells = view.positions[games]
        pairs = cells[:, view.seat] * np.int64(view.task.mazes[0].num_cells)
        chances = self._cumulative[places, pairs + cells[:, 1 - view.seat]]
        scaled = draws[:, None] * chances[:, -1:]
        actions: NDArray[np.int32] = (scaled >= chances).sum(axis=1, dtype=np.int32)
        return np.minimum(actions, np.int32(chances.shape[1] - 1))

    def _place(self, policies: Sequence[Policy | None], task: Task) -> NDArray[np.int64]:
        """[policies]: assign tables to new policies, and free those of removed ones."""
        found = np.full(len(policies), -1)
        if not task.is_duel or len(task.mazes) != 1:
            return found
        maze, pairs = task.mazes[0], task.mazes[0].num_cells ** 2
        here = {id(policy) for policy in policies}
        self._kept = {name: kept for name, kept in self._kept.items() if name in here}
        taken = {place for _, place in self._kept.values()}
        self._known = {place: known for place, known in self._known.items() if place in taken}
        free = sorted(set(range(len(taken) + len(policies))) - taken, reverse=True)
        for number, policy in enumerate(policies):
            most = MAX_PAIRS if number else min(self.worth, MAX_PAIRS)
            if not isinstance(policy, LearnedPolicy) or pairs > most:
                continue
            own = policy.task
            if not (own.is_duel and own.stay_action == task.stay_action and policy.plays_in(maze)):
                continue
            if id(policy) not in self._kept:
                place = free.pop()
                taken.add(place)
                self._kept[id(policy)] = policy, place
            found[number] = self._kept[id(policy)][1]
        count = 1 + max(taken, default=-1)
        if count > len(self._cumulative):
            spare = max(count, 5 * len(self._cumulative) // 4)  # copied less often
            larger = np.zeros((spare, pairs, task.num_actions))
            if len(self._cumulative):
                larger[: len(self._cumulative)] = self._cumulative
            self._cumulative = larger
        for number, place in enumerate(found.tolist()):
            if place >= 0 and (number == 0 or place not in self._known):
                self._refresh(place, policies[number], task)
        return found

    def _refresh(self, place: int, policy: Policy | None, task: Task) -> None:
        """Update a table if the version counters of the weights have changed."""
        assert isinstance(policy, LearnedPolicy)
        version = sum(weights._version for weights in policy.network.parameters())
        if self._known.get(place) != version:
            table = policy.action_probabilities(task.mazes[0], task.stay_action)
            flat = table.reshape(-1, table.shape[-1])
            np.cumsum(flat, axis=1, out=self._cumulative[place])
            self._known[place] = version
