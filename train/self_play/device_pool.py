"""DevicePool: the opponents of self-play in games on a GPU, each in the games it was drawn for."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.device.calls import Call, call_of
from pursuit.device.waiting import draw_where
from pursuit.maze_arrays import lay_out
from pursuit.policy import Policy
from pursuit.rules import layout
from scripted_agents.table_kernels import play_pairs
from train.environments.device_policies import DeviceNetwork, shared, tensors_at
from train.networks.policy import NetworkPolicy
from train.self_play.pool import PoolPolicy


class DevicePool:
    """What `PoolPolicy.act` does, in a seat of games on a GPU; a `DevicePolicy`.

    Before a rollout it takes in who is in the pool, with new tables of those whose weights have
    changed. In a rollout nothing waits for the GPU: one kernel plays all that are tables, each
    scripted member is a kernel that passes over the other games, and a network without a table is
    asked about all games.

    Args:
        pool: the same for games on the CPU; its `opponents` are who plays in each game as a rollout
            begins. In the rollout that stands in `simulator.drawn`.
        shares: how often each member is drawn from now on.
        simulator: the games.
        seat: its number.
    """

    def __init__(
        self,
        pool: PoolPolicy,
        shares: Callable[[], NDArray[np.float64]],
        simulator: Any,
        seat: int,
    ) -> None:
        self._pool, self._shares = pool, shares
        self._simulator, self._seat, self._task = simulator, seat, simulator.task
        games, self._device = simulator.num_games, tensors_at(simulator)
        self._drawn = shared(simulator, simulator.drawn)
        self._column = shared(simulator, simulator.actions)[:, seat]
        self._arrays = {
            "wanted": simulator.array(np.zeros(games, dtype=bool)),
            "draws": simulator.array(np.zeros(games)),
            "table_of": simulator.array(np.zeros(games, dtype=np.int32)),
        }
        self._tensors = {name: shared(simulator, array) for name, array in self._arrays.items()}
        stream = layout.named(layout.stream_of, seat)
        draw = Call(draw_where, {"stream": stream}, "numbers", rows=("wanted",))
        cells = {"num_cells": self._task.max_cells}
        tables = Call(play_pairs, cells, "actions", rows=("table_of", "draws"))
        self._draw, self._play_tables = simulator.launch(draw), simulator.launch(tables, seat)
        self._cumulative: Any = None
        self._others: list[tuple[int, Any]] = []
        self._kept: dict[int, tuple[Policy, Any]] = {}  # by identity: who is no table, as it plays
        self._table_at = torch.zeros(1, dtype=torch.int32, device=self._device)
        self._draws_alone = torch.zeros(1, dtype=torch.bool, device=self._device)
        self._changes = (
            0  # of which kernels a step launches, and of where that lies which they read
        )

    def begin_rollout(self) -> None:
        """As `DevicePolicy`: the members, their tables, and who plays in which game."""
        pool = self._pool
        policies = [member.policy for member in pool.pool.members]
        places = pool.tables.places(policies, self._task)
        self._take_tables(places)
        self._drawn.copy_(torch.from_numpy(pool.opponents))
        if len(self._table_at) != len(places):
            self._table_at = torch.zeros(len(places), dtype=torch.int32, device=self._device)
            self._draws_alone = torch.zeros(len(places), dtype=torch.bool, device=self._device)
            self._changes += 1
        self._table_at.copy_(torch.from_numpy(places))
        # Scripted agents draw for themselves, and greedy networks not at all.
        alone = [isinstance(p, NetworkPolicy) and not p.greedy for p in policies]
        self._draws_alone.copy_(torch.tensor(alone))
        here = {*np.unique(pool.opponents).tolist(), *np.flatnonzero(self._shares()).tolist()}
        names = {id(policy) for policy in policies}
        self._kept = {name: kept for name, kept in self._kept.items() if name in names}
        others = [
            (place, self._player(policies[place])) for place in sorted(here) if places[place] < 0
        ]
        self._changes += others != self._others
        self._others = others

    def _take_tables(self, places: NDArray[np.int64]) -> None:
        """Copy tables that are new or have changed to the GPU."""
        tables = self._pool.tables
        if not (places >= 0).any():
            return
        changed, found = tables.take_changed(), tables.cumulative
        if self._cumulative is None or self._cumulative.shape != found.shape:
            self._cumulative = self._simulator.array(found)
            self._changes += 1
            return
        for place in changed:
            self._cumulative[place].copy_to_device(found[place])

    def _player(self, policy: Policy) -> Any:
        """A member that is no table, as it plays on the GPU."""
        if id(policy) not in self._kept:
            simulator, seat = self._simulator, self._seat
            played: Any
            if isinstance(policy, NetworkPolicy):
                played = DeviceNetwork(policy, simulator, seat)
            else:
                call = call_of(policy, self._task, seat, lay_out(self._task.mazes))
                played = simulator.launch(call, seat, chosen=True)
            self._kept[id(policy)] = policy, played
        return self._kept[id(policy)][1]

    def play(self) -> None:
        """As `DevicePolicy`."""
        drawn, tensors, arrays = self._drawn.long(), self._tensors, self._arrays
        several = (drawn != drawn[0]).any()
        tensors["wanted"].copy_(several | self._draws_alone[drawn])
        tensors["table_of"].copy_(self._table_at[drawn])
        self._draw(wanted=arrays["wanted"], numbers=arrays["draws"])
        actions, seat = self._simulator.actions, self._seat
        if self._cumulative is not None:
            given = {"table_of": arrays["table_of"], "draws": arrays["draws"]}
            self._play_tables(actions=actions, seat=seat, cumulative=self._cumulative, **given)
        for place, player in self._others:
            if isinstance(player, DeviceNetwork):
                found = player.actions(tensors["draws"]).to(self._column.dtype)
                self._column.copy_(torch.where(drawn == place, found, self._column))
            else:
                player(actions=actions, seat=seat, drawn=self._simulator.drawn, member=place)

    def depends(self) -> Hashable:
        """As `DevicePolicy`."""
        networks = [one for _, one in self._others if isinstance(one, DeviceNetwork)]
        return self._changes, tuple(network.depends() for network in networks)
