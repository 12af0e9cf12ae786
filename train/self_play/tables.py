"""Opponents as tables: the action probabilities of networks in all states.

In a duel a network without memory is a function of two cells, in a small game of the state.
Snapshots never change, and the latest opponent is constant between updates. So each network is
evaluated once per rollout in all states, and actions are drawn from the table. The probabilities
equal those of the network up to rounding, as matrix products of other sizes round differently.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pursuit.simulator.batch import Rules

MAX_ROWS = 2**16
"""Maximum number of states (pairs of cells) in a table: 15 × 15 mazes fit, with 2 MB."""


class View(Protocol):
    """What tables need of a view of games."""

    def table_rows_of(self, games: NDArray[np.intp] | slice) -> NDArray[np.integer[Any]]:
        """[n] the rows of tables for the states of these games."""


class CellTables:
    """The tables of the members of a pool.

    Args:
        worth: maximum number of states for tables of an opponent that learns: the frames of a
            rollout.

    Attributes:
        cumulative: [tables, states, actions], sums over the actions; live.
    """

    def __init__(self, worth: int) -> None:
        self.worth = worth
        self.cumulative = np.empty((0, 0, 0))
        self._members: list[Any] = []  # kept alive, as they are identified by id()
        self._key: tuple[int, ...] = ()
        self._places = np.zeros(0, dtype=np.int64)
        self._weights: list[Tensor] = []  # of the first member; listing them takes long
        self._version = -1  # of the weights in its table

    def places(self, policies: Sequence[Any], task: Rules) -> NDArray[np.int64]:
        """[policies] the index of the table of each policy, updated; -1 for none.

        Args:
            policies: the members, None for those not in memory; all but the first never change.
                Those with a `state_table` in the task have tables (as of `LearnedPolicy`).
            task: of the games.
        """
        key = tuple(map(id, policies))
        if key != self._key:
            self._rebuild(policies, task)
            self._key, self._members = key, list(policies)
        elif len(key) and self._places[0] >= 0 and _version_of(self._weights) != self._version:
            self._version = _version_of(self._weights)
            self.cumulative[0] = _table_of(self._members[0], task)
        return self._places

    def draw(
        self,
        places: NDArray[np.int64],
        view: View,
        games: NDArray[np.intp] | slice,
        draws: NDArray[np.float64],
    ) -> NDArray[np.int32]:
        """[n] int32, the actions in some games of a view.

        Args:
            places: [n] of the table for each.
            view: all games.
            games: which n of them these are: indices or a slice.
            draws: [n] in [0, 1).
        """
        chances = self.cumulative[places, view.table_rows_of(games)]
        scaled = draws[:, None] * chances[:, -1:]
        actions: NDArray[np.int32] = (scaled >= chances).sum(axis=1, dtype=np.int32)
        return np.minimum(actions, np.int32(chances.shape[1] - 1))

    def _rebuild(self, policies: Sequence[Any], task: Rules) -> None:
        """Tables of these policies; those of members that stay are kept."""
        known = {
            id(member): self.cumulative[place]
            for member, place in zip(self._members[1:], self._places[1:], strict=True)
            if place >= 0
        }
        tables: list[NDArray[np.float64]] = []
        self._places = np.full(len(policies), -1)
        for number, policy in enumerate(policies):
            counted = getattr(policy, "table_rows", None)  # policies need not have tables
            rows = None if counted is None else counted(task)
            if rows is not None and rows <= (MAX_ROWS if number else min(self.worth, MAX_ROWS)):
                self._places[number] = len(tables)
                if number == 0:
                    self._weights = [*policy.network.parameters()]
                    self._version = _version_of(self._weights)
                table = known.get(id(policy)) if number else None
                tables.append(_table_of(policy, task) if table is None else table)
        self.cumulative = np.stack(tables) if tables else np.empty((0, 0, 0))


def _version_of(weights: Sequence[Tensor]) -> int:
    """A number that grows with every change of weights."""
    return sum(each._version for each in weights)


def _table_of(policy: Any, task: Rules) -> NDArray[np.float64]:
    """[states, actions]: sums of the probabilities over the actions."""
    table: NDArray[np.float64] = policy.state_table(task)
    return table.cumsum(axis=1)
