"""QMIX: value decomposition networks whose values are mixed by the state."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

from train.algorithms.collector import NEXT_CRITIC, Columns
from train.algorithms.learner import Build
from train.algorithms.replay import Minibatch
from train.algorithms.vdn import VDN
from train.networks.features import Features
from train.networks.layers import Hidden, Trunk
from train.networks.policy import CRITIC
from train.networks.q_network import QNetwork


class QMIX(VDN):
    """Rashid et al. (2018), "QMIX: monotonic value function factorisation for deep multi-agent
    reinforcement learning".

    Different from `VDN`: the value of a joint action is not the sum of the agents' values, but a
    network of them and of the state (`Mixer`), which rises with each, so that the greedy joint
    action is still that of the greedy agents. With one agent it is `DQN`.
    """

    @staticmethod
    def network_of(settings: Any, seat: Any, build: Build) -> QNetwork:
        """As of VDN, with a mixing network, `mixer`, for several agents."""
        network = VDN.network_of(settings, seat, build)
        if seat.members > 1:
            mixer = Mixer(seat.critic_features, seat.members, settings.mixing_width)
            network.mixer = mixer.to(build.device)
        return network

    @staticmethod
    def joint_value(
        network: Any, values: torch.Tensor, batch: Minibatch, when: str
    ) -> torch.Tensor:
        """As of VDN, mixed by the state; agents that have left count 0."""
        return network.mixer(values * ~batch[f"{when}idle"], batch[f"{when}{CRITIC}"])

    def rows_of_games(self, rollout: Columns, members: int) -> Columns:
        """As of VDN, with the states once a game, as of its first agent."""
        columns = super().rows_of_games(rollout, members)
        return columns | {name: columns[name][:, :, 0] for name in (CRITIC, NEXT_CRITIC)}


class Mixer(nn.Module):
    """The value of a joint action from the agents' values, in which it never falls: Rashid et al.
    (2018), figure 2, with one embedding of the state for all weights.

    Args:
        features: of the observation of the state.
        agents: of the team.
        width: hidden units.
    """

    def __init__(self, features: Features, agents: int, width: int) -> None:
        super().__init__()
        self.state = Trunk(features, Hidden(width))
        self.sizes = [agents * width, width, width]
        self.weights = nn.Linear(width, sum(self.sizes))
        self.offset = nn.Linear(width, 1)

    def forward(self, values: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """[batch] from the values [batch, agents] and the observations of the state."""
        seen = self.state(self.state.prepare(state))
        first, bias, second = torch.split(self.weights(seen), self.sizes, dim=-1)
        layer = first.abs().view(*values.shape, -1)
        hidden = nn.functional.elu((values[..., None] * layer).sum(dim=1) + bias)
        return (hidden * second.abs()).sum(dim=1) + self.offset(seen).squeeze(-1)
