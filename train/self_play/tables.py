"""Opponents as tables: the action probabilities of networks for all pairs of cells.

In a duel a network without memory is a function of two cells. Snapshots never change, and the
latest opponent is constant between updates. So each network is evaluated once per rollout on all
pairs of cells, and actions are drawn from the table. The probabilities equal those of the network
up to rounding, as matrix products of other sizes round differently.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pursuit.simulator.policy import GameView, Policy
from pursuit.tasks.task import Task
from scripted_agents.games.simulator import GameTask, StateView
from train.networks.policy import LearnedPolicy, NetworkPolicy
from train.networks.small_game_policy import SmallGamePolicy

MAX_PAIRS = 2**16
"""Maximum number of pairs of cells in a table: 15 × 15 mazes fit, with 2 MB."""


class CellTables:
    """The tables of the members of a pool.

    Args:
        worth: maximum number of pairs of cells or states for tables of an opponent that learns: the
            frames of a rollout.

    Attributes:
        cumulative: [tables, pairs of cells, actions], sums over the actions; live.
    """

    def __init__(self, worth: int) -> None:
        self.worth = worth
        self.cumulative = np.empty((0, 0, 0))
        self._members: list[Policy | None] = []  # kept alive, as they are identified by id()
        self._key: tuple[int, ...] = ()
        self._places = np.zeros(0, dtype=np.int64)
        self._weights: list[Tensor] = []  # of the first member; listing them takes long
        self._version = -1  # of the weights in its table

    def places(self, policies: Sequence[Policy | None], task: Task | GameTask) -> NDArray[np.int64]:
        """[policies] the index of the table of each policy, updated; -1 for none.

        Args:
            policies: the members, None for those not in memory; all but the first never change.
            task: of the games; a duel in one maze or a small game, or there are no tables.
        """
        key = tuple(map(id, policies))
        if key != self._key:
            self._rebuild(policies, task)
            self._key, self._members = key, list(policies)
        elif len(key) and self._places[0] >= 0:
            first = self._members[0]
            assert isinstance(first, NetworkPolicy)
            if (version := _version_of(self._weights)) != self._version:
                self._version, self.cumulative[0] = version, _table_of(first, task)
        return self._places

    def draw(
        self,
        places: NDArray[np.int64],
        view: GameView | StateView,
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
        if isinstance(view, StateView):
            rows = view.state[games]
        else:
            cells = view.positions[games]
            pairs = cells[:, view.seat] * np.int64(view.task.mazes[0].num_cells)
            rows = pairs + cells[:, 1 - view.seat]
        chances = self.cumulative[places, rows]
        scaled = draws[:, None] * chances[:, -1:]
        actions: NDArray[np.int32] = (scaled >= chances).sum(axis=1, dtype=np.int32)
        return np.minimum(actions, np.int32(chances.shape[1] - 1))

    def _rebuild(self, policies: Sequence[Policy | None], task: Task | GameTask) -> None:
        """Tables of these policies; those of members that stay are kept."""
        known = {
            id(member): self.cumulative[place]
            for member, place in zip(self._members[1:], self._places[1:], strict=True)
            if place >= 0
        }
        tables: list[NDArray[np.float64]] = []
        self._places = np.full(len(policies), -1)
        for number, policy in enumerate(policies):
            most = MAX_PAIRS if number else min(self.worth, MAX_PAIRS)
            if isinstance(policy, NetworkPolicy) and _fits(policy, task, most):
                self._places[number] = len(tables)
                if number == 0:
                    self._weights = [*policy.network.parameters()]
                    self._version = _version_of(self._weights)
                table = known.get(id(policy)) if number else None
                tables.append(_table_of(policy, task) if table is None else table)
        self.cumulative = np.stack(tables) if tables else np.empty((0, 0, 0))


def _fits(policy: NetworkPolicy, task: Task | GameTask, most: int) -> bool:
    """Whether a policy has a table in a task, of at most so many pairs of cells or states."""
    if isinstance(task, GameTask):
        return task.game.num_states <= most
    if not isinstance(policy, LearnedPolicy):
        return False
    own, duel = policy.task, task.is_duel and len(task.mazes) == 1
    if not duel or not own.is_duel or task.mazes[0].num_cells ** 2 > most:
        return False
    return own.stay_action == task.stay_action and policy.plays_in(task.mazes[0])


def _version_of(weights: Sequence[Tensor]) -> int:
    """A number that grows with every change of weights."""
    return sum(each._version for each in weights)


def _table_of(policy: NetworkPolicy, task: Task | GameTask) -> NDArray[np.float64]:
    """[pairs of cells or states, actions]: sums of the probabilities over the actions."""
    if isinstance(policy, SmallGamePolicy):
        return policy.state_probabilities().cumsum(axis=1)
    assert isinstance(policy, LearnedPolicy) and isinstance(task, Task)
    table = policy.action_probabilities(task.mazes[0], task.stay_action)
    return table.reshape(-1, table.shape[-1]).cumsum(axis=1)
