"""A policy and a value: one shared trunk, one each, or a critic that sees the whole team."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import nn
from torchrl.modules import MultiAgentMLP

from train.networks.distributions import Categorical, SquashedNormal
from train.networks.features import Features
from train.networks.layers import Hidden, Trunk, head


class ActorCritic(nn.Module):
    """A policy and a value: one shared trunk, or one each.

    Args:
        features: of what is observed.
        num_actions: to choose from; with `action_std` numbers of an action.
        hidden: the hidden layers.
        shared: whether policy and value share them.
        action_std: makes actions continuous; the standard deviation of every number of an action,
            before tanh, at first.

    Attributes:
        policy_trunk, value_trunk: the trunks; the same object where they are shared.
        policy_head: [width] -> [actions] logits, or [numbers] means before tanh.
        value_head: [width] -> [1].
        log_std: [numbers], the logarithms of the standard deviations, whatever is observed; None
            where actions are choices.
        form: what actions are drawn from.
    """

    log_std: nn.Parameter | None
    form: type[Categorical] | type[SquashedNormal]

    def __init__(
        self,
        features: Features,
        num_actions: int,
        hidden: Hidden,
        shared: bool = True,
        action_std: float | None = None,
    ) -> None:
        super().__init__()
        self.policy_trunk = Trunk(features, hidden)
        self.value_trunk = self.policy_trunk if shared else Trunk(features, hidden)
        self.policy_head = head(hidden.width, num_actions, 0.01)
        self.value_head = head(hidden.width, 1, 1.0)
        self.log_std, self.form = None, Categorical
        if action_std is not None:
            self.log_std = nn.Parameter(torch.full((num_actions,), math.log(action_std)))
            self.form = SquashedNormal

    @property
    def shared(self) -> bool:
        """Whether policy and value share their trunk."""
        return self.policy_trunk is self.value_trunk

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits [..., actions], or means [..., numbers], and value [..., 1]."""
        hidden, value_hidden = self.hidden(self.policy_trunk.prepare(observation))
        return self.policy_head(hidden), self.value_head(value_hidden)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions], or means [..., numbers] before tanh; without the value."""
        trunk = self.policy_trunk
        logits: torch.Tensor = self.policy_head(trunk(trunk.prepare(observation)))
        return logits

    def distribution(
        self, output: torch.Tensor, allowed: torch.Tensor | None = None
    ) -> Categorical | SquashedNormal:
        """What actions are drawn from.

        Args:
            output: of the policy head.
            allowed: [..., actions] bool, what may be done; None for anything.
        """
        if self.log_std is None:
            return Categorical(output, allowed)
        return SquashedNormal(output, self.log_std)

    def act(self, observation: torch.Tensor, noise: torch.Tensor | None = None) -> torch.Tensor:
        """[..., numbers] in [-1, 1]: continuous actions.

        Args:
            observation: [..., *shape].
            noise: [..., numbers], standard normal draws; None for the greedy action.
        """
        assert self.log_std is not None, "actions are choices; take `logits`"
        mean = self.logits(observation)
        return (mean if noise is None else mean + self.log_std.exp() * noise).tanh()

    def hidden(self, prepared: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What the two heads work on, [..., width] each; `policy_trunk.prepare` serves both."""
        hidden = self.policy_trunk(prepared)
        return hidden, hidden if self.shared else self.value_trunk(prepared)


class CentralActorCritic(ActorCritic):
    """A policy on what one agent observes, and a value of what its whole team observes (MAPPO).

    Observations are [..., k + 1, *shape]: the agent's own, then those of all k agents of its role.
    The critic is TorchRL's `MultiAgentMLP`, centralised: one network on all k observations at once
    (Yu et al., 2022). `logits` takes the agent's own observation alone, [..., *shape].

    Args:
        features: of the kind "index".
        num_actions: of every agent.
        members: k, agents of the role.
        hidden: its form is always "dense".
    """

    def __init__(self, features: Features, num_actions: int, members: int, hidden: Hidden) -> None:
        super().__init__(features, num_actions, replace(hidden, form="dense"), shared=False)
        del self.value_trunk
        self.critic = MultiAgentMLP(
            n_agent_inputs=features.num_rows,
            n_agent_outputs=hidden.width,
            n_agents=members,
            centralized=True,
            share_params=True,
            depth=1,
            num_cells=hidden.width,
            activation_class=nn.Tanh if hidden.activation == "tanh" else nn.ReLU,
        )

    @property
    def shared(self) -> bool:
        """False: the critic is a network of its own."""
        return False

    def hidden(self, prepared: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """[..., width] each for policy and value, from [..., k + 1, rows]."""
        team: torch.Tensor = self.critic(prepared[..., 1:, :].float())
        # With shared parameters a centralised critic says the same of every agent of the team.
        return self.policy_trunk(prepared[..., 0, :]), team[..., 0, :].relu()
