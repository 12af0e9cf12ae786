"""Networks of flat numbers, as other libraries have them, for observations of any form."""

from __future__ import annotations

from math import prod

import torch
from torch import nn

from train.networks.features import Features
from train.networks.layers import one_hot_sum
from train.networks.policy import PolicyNetwork


class FlatInputs(nn.Module):
    """Observations as [..., size] float32, scaled to about [0, 1]; of "index" the one-hot sum."""

    rows: torch.Tensor
    scale: torch.Tensor

    def __init__(self, features: Features) -> None:
        super().__init__()
        self.dims, self.indexed = len(features.shape), features.kind == "index"
        self.size = features.num_rows if self.indexed else prod(features.shape)
        high = torch.as_tensor(features.high, dtype=torch.float32).reshape(-1)
        self.register_buffer("rows", torch.from_numpy(features.rows), False)
        self.register_buffer("scale", 1.0 / high.clamp(min=1.0), False)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., size] of [..., *shape]."""
        if self.indexed:
            return one_hot_sum(self.rows[observation.long()], self.size)
        return observation.flatten(-self.dims).float() * self.scale


class FlatNetwork(nn.Module):
    """The network of a policy for any observation, from one for flat numbers.

    Args:
        inputs: of the observation.
        network: gives logits [..., actions] of [..., inputs.size].
    """

    def __init__(self, inputs: FlatInputs, network: PolicyNetwork) -> None:
        super().__init__()
        self.inputs, self.network = inputs, network

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] of [..., *shape]."""
        return self.network.logits(self.inputs(observation))
