"""Networks for continuous actions: deterministic and Gaussian actors, and critics."""

from __future__ import annotations

from math import log, pi
from typing import ClassVar

import torch
from torch import nn

from train.networks.features import Features
from train.networks.layers import Flat, Hidden, Trunk, head

LOG_STD = (-20.0, 2.0)
"""Bounds of the logarithms of standard deviations (Haarnoja et al., 2018, their code)."""


class SquashedActor(nn.Module):
    """The base of policies of continuous actions, squashed by tanh.

    Attributes:
        trunk: the hidden layers.
        head: [..., width] -> [..., OUTPUTS * actions].
    """

    OUTPUTS: ClassVar[int] = 1

    def __init__(self, features: Features, num_actions: int, hidden: Hidden) -> None:
        super().__init__()
        self.trunk = Trunk(features, hidden)
        self.head = head(hidden.width, self.OUTPUTS * num_actions, 0.01)


class DeterministicActor(SquashedActor):
    """A deterministic policy: the head gives the actions before tanh."""

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., actions] in [-1, 1], from `trunk.prepare(observation)`."""
        return self.head(self.trunk(prepared)).tanh()

    def act(self, observation: torch.Tensor, noise: torch.Tensor | None = None) -> torch.Tensor:
        """[..., actions] in [-1, 1]; `noise` is ignored, as the policy is deterministic."""
        return self(self.trunk.prepare(observation))


class GaussianActor(SquashedActor):
    """A Gaussian policy: the head gives means and logarithms of standard deviations."""

    OUTPUTS = 2

    def forward(self, prepared: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Means and logarithms of standard deviations, [..., actions] each, before tanh.

        Takes `trunk.prepare(observation)`.
        """
        mean, log_std = self.head(self.trunk(prepared)).chunk(2, dim=-1)
        return mean, log_std.clamp(*LOG_STD)

    def draw(self, prepared: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Actions [..., actions], with gradients, and the logarithms of their densities [...].

        The density of tanh(u) is that of u over the derivative 1 - tanh(u)^2 = 4 / (e^u + e^-u)^2.
        Its logarithm 2 (log 2 - u - softplus(-2u)) is exact where tanh(u) rounds to 1.
        """
        mean, log_std = self(prepared)
        noise = torch.randn_like(mean)
        before = mean + log_std.exp() * noise
        slope = 2.0 * (log(2.0) - before - nn.functional.softplus(-2.0 * before))
        each = -0.5 * noise.square() - log_std - 0.5 * log(2.0 * pi) - slope
        return before.tanh(), each.sum(dim=-1)

    def act(self, observation: torch.Tensor, noise: torch.Tensor | None = None) -> torch.Tensor:
        """[..., actions] in [-1, 1].

        Args:
            observation: [..., *shape].
            noise: [..., actions], standard normal draws; None for the mean before tanh.
        """
        mean, log_std = self(self.trunk.prepare(observation))
        before = mean if noise is None else mean + log_std.exp() * noise
        return before.tanh()


class Critics(nn.Module):
    """Several action value networks of the same form, evaluated as one.

    Their weights are stacked, so that each layer is one batched product.

    Args:
        features: of flat observations.
        num_actions: dimensions of an action.
        hidden: two layers.
        count: number of networks.

    Raises:
        ValueError: observations that are not flat.

    Attributes:
        weights: [count, inputs, outputs] for each of the three layers.
        biases: [count, 1, outputs].
    """

    def __init__(self, features: Features, num_actions: int, hidden: Hidden, count: int) -> None:
        super().__init__()
        if features.kind != "flat":
            raise ValueError(
                f"observations of kind {features.kind!r}; critics of continuous actions need flat "
                "ones"
            )
        # Initialised as the layers of `Trunk`.
        layers: list[list[nn.Linear]] = []
        for _ in range(count):
            second = head(hidden.width, hidden.width, 2.0**0.5)
            inputs = Flat(features, hidden.width).linear.in_features + num_actions
            first, last = nn.Linear(inputs, hidden.width), head(hidden.width, 1, 1.0)
            layers.append([first, second, last])
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for parts in zip(*layers, strict=True):
            self.weights.append(torch.stack([part.weight.detach().T for part in parts]))
            self.biases.append(torch.stack([part.bias.detach()[None] for part in parts]))
        self.tanh = hidden.activation == "tanh"
        self.autocast_bfloat16 = hidden.bfloat16

    def forward(self, prepared: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """[count, batch] float32.

        Args:
            prepared: [batch, observation size], from an actor's `trunk.prepare`.
            action: [batch, actions].
        """
        return self._values(prepared, action, list(self.weights), list(self.biases))

    def frozen(self, prepared: torch.Tensor, action: torch.Tensor, count: int) -> torch.Tensor:
        """[count, batch]: values of the first `count` networks, without gradients of weights."""
        kinds = ([part.detach()[:count] for part in kind] for kind in (self.weights, self.biases))
        return self._values(prepared, action, *kinds)

    def _values(
        self,
        prepared: torch.Tensor,
        action: torch.Tensor,
        weights: list[torch.Tensor],
        biases: list[torch.Tensor],
    ) -> torch.Tensor:
        activate = torch.tanh_ if self.tanh else torch.relu_
        hidden = torch.cat([prepared, action], dim=-1).expand(len(weights[0]), -1, -1)
        with torch.autocast(prepared.device.type, torch.bfloat16, enabled=self.autocast_bfloat16):
            for weight, bias in zip(weights[:2], biases[:2], strict=True):
                hidden = activate(torch.bmm(hidden, weight).add_(bias))
        # One output: a batched matrix-vector product is several times slower.
        columns = zip(hidden.float(), weights[2], strict=True)
        values = [torch.mv(each, weight[:, 0]) for each, weight in columns]
        return torch.stack(values).add_(biases[2].squeeze(-1))


def polyak_update(targets: nn.Module, networks: nn.Module, tau: float) -> None:
    """Polyak averaging: move the weights of `targets` by the share `tau` towards `networks`.

    Equal to TorchRL's `SoftUpdate`, and tested against it; one operation for all weights. Buffers,
    such as statistics of batches, are copied.
    """
    if tau > 0.0:
        with torch.no_grad():
            torch._foreach_lerp_(list(targets.parameters()), list(networks.parameters()), tau)
            for target, own in zip(targets.buffers(), networks.buffers(), strict=True):
                target.copy_(own)
