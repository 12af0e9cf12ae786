"""Independent Q-learning (IQL): deep Q-learning of every agent of a role on its own."""

from __future__ import annotations

from typing import Any

from train.algorithms.collector import Columns
from train.algorithms.dqn import DQN
from train.algorithms.learner import Build
from train.algorithms.replay import n_step_rows
from train.networks.q_network import QNetwork
from train.networks.seat import Seat
from train.networks.separate import network_of_team


class IQL(DQN):
    """Tan (1993), "Multi-agent reinforcement learning: independent vs. cooperative agents"; with
    deep networks Tampuu et al. (2017).

    Every agent of a role learns the values of its own actions from its own observations and
    rewards, as if the others were part of the environment. A row of the replay buffer is a step of
    one agent; agents that have left their game have none. Different from `DQN`: the agents may have
    a network each (`TeamSettings.sharing`). With one agent it is `DQN`.
    """

    @staticmethod
    def network_of(settings: Any, seat: Seat, build: Build) -> QNetwork:
        """As of DQN; with separate networks one for each agent, as `SeparateNetworks`."""
        return network_of_team(DQN.network_of, settings, seat, build)

    def store(self, rollout: Columns) -> None:
        """Add the steps of the agents that are in their games to the buffer."""
        self.frames += rollout["reward"].numel()
        rows = n_step_rows(rollout, self.settings.gamma, self.settings.n_steps)
        idle = rows.pop("idle", None)
        if idle is not None:
            rows = {name: column[~idle.flatten()] for name, column in rows.items()}
        self.replay.extend(rows)
