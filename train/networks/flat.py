"""Networks of flat numbers, as other libraries have them, for observations of any form."""

from __future__ import annotations

from math import prod

import torch
from torch import nn

from train.networks.features import Features
from train.networks.policy import PolicyNetwork


class FlatInputs(nn.Module):
    """Observations as [..., size] float32, scaled to about [0, 1]; of "index" the one-hot sum."""

    rows: torch.Tensor
    scale: torch.Tensor

    def __init__(self, features: Features) -> None:
        super().__init__()
        self.dims, self.indexed = len(features.shape), features.kind == "index"
        self.size = features.num_rows if self.indexed else prod(features.shape)
        high = torch.as_tensor(features.high, dtype=torch.float32).reshape(-1).clamp(min=1.0)
        self.scaled = bool((high > 1.0).any())
        self.register_buffer("rows", torch.from_numpy(features.rows), False)
        self.register_buffer("scale", 1.0 / high, False)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., size] of [..., *shape]."""
        if not self.indexed:
            flat = observation.flatten(-self.dims).float()
            return flat * self.scale if self.scaled else flat
        rows = self.rows[observation.long()]
        summed = torch.zeros(*rows.shape[:-1], self.size + 1, device=rows.device)
        summed.scatter_add_(-1, rows, torch.ones((), device=rows.device).expand(rows.shape))
        return summed[..., : self.size]


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
