"""Action value networks."""

from __future__ import annotations

import torch
from torch import nn

from train.networks.features import Features
from train.networks.fused import fused_hidden, fused_layers
from train.networks.layers import Hidden, Trunk, head


class DuelingHead(nn.Module):
    """A value and the actions' centred advantages (Wang et al., 2016, equation 9)."""

    def __init__(self, width: int, num_actions: int) -> None:
        super().__init__()
        self.value, self.advantage = head(width, 1, 1.0), head(width, num_actions, 0.1)

    def forward(self, hidden: torch.Tensor) -> torch.Tensor:
        """[..., actions] from [..., width]."""
        advantage = self.advantage(hidden)
        return self.value(hidden) + advantage - advantage.mean(dim=-1, keepdim=True)


class QNetwork(nn.Module):
    """A network of action values.

    Args:
        features: of the observation.
        num_actions: number of actions.
        hidden: the hidden layers.
        dueling: whether values and advantages have separate heads.
        fused: whether to use fused hidden layers where possible, on the CPU.

    Attributes:
        policy_trunk: the hidden layers.
        policy_head: [..., width] -> [..., actions].
    """

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
        sizes = hidden.width, num_actions
        self.policy_head = DuelingHead(*sizes) if dueling else head(*sizes, 0.1)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] float32: the expected discounted return of each action."""
        trunk = self.policy_trunk
        return self.policy_head(trunk(trunk.prepare(observation)))

    @property
    def update_form(self) -> str:
        """The form of the hidden layers in use: "fused" or "torch"."""
        fused = self._fused
        return "fused" if fused and fused.second.weight.device.type == "cpu" else "torch"

    def forward_inference(self, observation: torch.Tensor) -> torch.Tensor:
        """As `forward` for observations [batch, *shape], faster, and equal up to rounding."""
        trunk, layers = self.policy_trunk, self._fused
        if layers is not None and observation.is_cpu:
            return self.policy_head(fused_hidden(layers, observation))
        prepare = trunk.prepare if torch.is_grad_enabled() else trunk.prepare_inference
        return self.policy_head(trunk(prepare(observation)))

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """The action values: the greedy action has the largest."""
        return self(observation)
