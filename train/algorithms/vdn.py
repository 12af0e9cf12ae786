"""Value decomposition networks (VDN): deep Q-learning of a team with a common reward."""

from __future__ import annotations

from typing import Any

import torch

from train.algorithms.collector import Columns
from train.algorithms.dqn import DQN, dqn_loss
from train.algorithms.learner import Build
from train.algorithms.replay import NEXT_IDLE, Minibatch
from train.networks.q_network import QNetwork
from train.networks.seat import Seat
from train.networks.separate import network_of_team


class VDN(DQN):
    """Sunehag et al. (2018), "Value-decomposition networks for cooperative multi-agent learning".

    Different from `DQN`: the value of a joint action is the sum of the values of all agents, each
    of its own observation and action, and is learned from the mean of their rewards. A row of the
    replay buffer is a step of a whole game. Agents that have left it add nothing. The agents may
    have a network each (`TeamSettings.sharing`). With one agent it is `DQN`.
    """

    @staticmethod
    def network_of(settings: Any, seat: Seat, build: Build) -> QNetwork:
        """As of DQN; with separate networks one for each agent, as `SeparateNetworks`."""
        return network_of_team(DQN.network_of, settings, seat, build)

    def loss(self, batch: Minibatch) -> tuple[torch.Tensor, torch.Tensor]:
        """`dqn_loss` of the values of joint actions."""
        if self.env.player.members == 1:
            return super().loss(batch)
        gamma, double = self.settings.gamma, self.settings.double
        return dqn_loss(self.network, self.target, batch, gamma, double, self.joint_value)

    @staticmethod
    def joint_value(
        network: Any, values: torch.Tensor, batch: Minibatch, when: str
    ) -> torch.Tensor:
        """[batch] the value of a joint action, from the values [batch, agents] of its parts.

        Args:
            network: that the values are of, or the target network.
            values: of the actions of all agents.
            batch: rows of the replay buffer.
            when: "" for the observations before the step, "next_" for those after it.
        """
        return (values * ~batch[f"{when}idle"]).sum(dim=1)

    def store(self, rollout: Columns) -> None:
        """Add a rollout [games * agents, steps] to the buffer, by game."""
        members = self.env.player.members
        rows = rollout if members == 1 else self.rows_of_games(rollout, members)
        super().store(rows)
        self.frames += (members - 1) * rows["reward"].numel()  # a frame is a step of one agent

    def rows_of_games(self, rollout: Columns, members: int) -> Columns:
        """The columns [games * agents, steps, ...] as [games, steps, agents, ...]; rewards and ends
        of a team [games, steps]."""
        columns = {
            name: column.view(-1, members, *column.shape[1:]).movedim(1, 2)
            for name, column in rollout.items()
        }
        return columns | {
            "idle": columns["idle"].squeeze(-1),
            NEXT_IDLE: columns["terminated"],
            "reward": columns["reward"].mean(dim=2),
            "terminated": columns["terminated"].all(dim=2),
            "done": columns["done"].all(dim=2),
        }
