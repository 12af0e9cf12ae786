"""Action values."""

from __future__ import annotations

import torch
from torch import nn

from train.networks.features import Features
from train.networks.fused import fused_hidden, fused_layers
from train.networks.layers import Hidden, Trunk, head
from train.networks.recurrent import Cell, cell_of


class DuelingHead(nn.Module):
    """A value and the actions' advantages over their mean (Wang et al., 2016, equation 9)."""

    def __init__(self, width: int, num_actions: int) -> None:
        super().__init__()
        self.value, self.advantage = head(width, 1, 1.0), head(width, num_actions, 0.1)

    def forward(self, hidden: torch.Tensor) -> torch.Tensor:
        """[..., actions] from [..., width]."""
        advantage = self.advantage(hidden)
        q_values: torch.Tensor = (
            self.value(hidden) + advantage - advantage.mean(dim=-1, keepdim=True)
        )
        return q_values


class QNetwork(nn.Module):
    """Action values.

    Args:
        features: of what is observed.
        num_actions: to choose from.
        hidden: the hidden layers.
        dueling: whether values and advantages have heads of their own.
        fused: whether hidden layers that have a fused form are computed so, on the CPU.

    Attributes:
        policy_trunk: the hidden layers.
        policy_head: [..., width] -> [..., actions].
        policy_memory: the cell between them; None where nothing is remembered.
    """

    policy_memory: Cell | None

    def __init__(
        self,
        features: Features,
        num_actions: int,
        hidden: Hidden,
        dueling: bool = False,
        fused: bool = True,
    ) -> None:
        super().__init__()
        self.policy_trunk = Trunk(features, hidden)
        self._fused = fused_layers(self.policy_trunk) if fused else None
        self.policy_memory = cell_of(hidden)
        self.policy_head = (
            DuelingHead(hidden.width, num_actions)
            if dueling
            else head(hidden.width, num_actions, 0.1)
        )

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] float32: the expected discounted return of each action."""
        q_values: torch.Tensor = self.policy_head(
            self.policy_trunk(self.policy_trunk.prepare(observation))
        )
        return q_values

    @property
    def update_form(self) -> str:
        """Which form of the hidden layers runs where nothing is remembered: "fused" or "torch"."""
        plain = self._fused if self.policy_memory is None else None
        return "fused" if plain and plain.second.weight.device.type == "cpu" else "torch"

    def quick(self, observation: torch.Tensor) -> torch.Tensor:
        """The same for observations [batch, *shape], quicker, up to the last bits."""
        trunk, layers = self.policy_trunk, self._fused
        if layers is not None and observation.is_cpu:
            q_values: torch.Tensor = self.policy_head(fused_hidden(layers, observation))
            return q_values
        prepare = trunk.prepare if torch.is_grad_enabled() else trunk.glance
        q_values = self.policy_head(trunk(prepare(observation)))
        return q_values

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """The same: the greedy action has the largest."""
        return self(observation)

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers that it remembers of a game, and 0."""
        return self.policy_memory.size if self.policy_memory else 0, 0

    def remember(
        self, observation: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Values of a step [games, actions], and the state [games, numbers] after it: 0 numbers
        where nothing is remembered."""
        if self.policy_memory is None:
            return self.quick(observation), state
        trunk = self.policy_trunk
        hidden, state = self.policy_memory.step(trunk(trunk.prepare(observation)), state)
        return self.policy_head(hidden), state

    def along(
        self, observation: torch.Tensor, state: torch.Tensor, episode_start: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Values [games, steps, actions] of sequences, and the states after every step.

        Args:
            observation: [games, steps, *shape].
            state: [games, numbers] before the first step.
            episode_start: [games, steps] bool: an episode begins here.
        """
        assert self.policy_memory is not None
        trunk = self.policy_trunk
        hidden, states = self.policy_memory(trunk(trunk.prepare(observation)), state, episode_start)
        return self.policy_head(hidden), states
