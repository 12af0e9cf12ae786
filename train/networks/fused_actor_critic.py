"""Fused actor-critic networks on the CPU, with explicit sampling and gradients.

For small networks, half the time of PPO and A2C goes into small operations and products with few
columns, which the kernels of `fused_kernels` replace. The functions equal `ActorCritic` and
`ppo_loss` up to rounding; with bfloat16 the first layer stays float32.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch

from train.networks.actor_critic import ActorCritic
from train.networks.distributions import Categorical
from train.networks.fused import (
    FusedLayers,
    fused_layers,
    gradients_of,
    hidden_layers,
    second_layer,
)
from train.networks.fused_kernels import below_heads, clipped_loss, draw_actions


class Drawn(NamedTuple):
    """The actions drawn for a batch of observations.

    Attributes:
        action: [batch] int64.
        action_log_prob: [batch] float32, of the action.
        value: [batch] float32.
    """

    action: torch.Tensor
    action_log_prob: torch.Tensor
    value: torch.Tensor


class LossCoefficients(NamedTuple):
    """The coefficients of the losses of PPO and A2C.

    Attributes:
        clip: clipping range of the probability ratio; infinity for none.
        value_coef: weight of the value loss; None without a value function.
        entropy_coef: weight of the entropy bonus.
        standardize: whether advantages are scaled to mean 0 and standard deviation 1 first; those
            of a single frame are not.
        kl_coef: weight of KL(collecting policy, policy); only `TorchEngine` supports it.
        imitation: weight of the cross-entropy to the imitated policy, in [0, 1]; the objective has
            the rest. Only `TorchEngine` supports it.
    """

    clip: float
    value_coef: float | None
    entropy_coef: float
    standardize: bool = True
    kl_coef: float = 0.0
    imitation: float = 0.0


class FusedActorCritic:
    """The fused form of an `ActorCritic`, which owns the weights.

    Args:
        network: one that `fused_actor_critic` supports.
        layers: its hidden layers.
    """

    def __init__(self, network: ActorCritic, layers: FusedLayers) -> None:
        self.layers, self.policy, self.value_head = layers, network.policy_head, network.value_head
        self._scratch = torch.empty(self.policy.out_features)
        self.cast_weights()

    @torch.no_grad()
    def cast_weights(self) -> None:
        """Prepare the weights for `draw` and `value`, until they change: casts and copies."""
        self._second, self._both_heads = second_layer(self.layers), self._heads()

    def _heads(self) -> tuple[torch.Tensor, torch.Tensor]:
        """[actions + 1, width] and [actions + 1]: weight and bias of both heads."""
        heads = (self.policy, self.value_head)
        weight = torch.cat([head.weight.detach() for head in heads])
        return weight, torch.cat([head.bias.detach() for head in heads])

    @torch.no_grad()
    def draw(self, observation: torch.Tensor) -> Drawn:
        """Actions for observations [batch, numbers], drawn with torch's generator."""
        hidden = hidden_layers(self.layers, observation, self._second).second.float()
        weight, bias = self._both_heads
        batch = len(observation)
        outputs = torch.empty(batch, len(bias))
        action, log_prob = torch.empty(batch, dtype=torch.int64), torch.empty(batch)
        uniform = torch.rand(batch)
        tensors = (hidden, weight, bias, uniform, outputs, action, log_prob, self._scratch)
        draw_actions(*_arrays(tensors))
        return Drawn(action, log_prob, outputs[:, -1])

    @torch.no_grad()
    def value(self, observation: torch.Tensor) -> torch.Tensor:
        """[batch]: values of observations [batch, numbers]."""
        hidden = hidden_layers(self.layers, observation, self._second).second.float()
        head = self.value_head
        return torch.addmv(head.bias.expand(len(hidden)), hidden, head.weight[0])

    @torch.no_grad()
    def set_gradients(
        self, frames: Mapping[str, torch.Tensor], coefficients: LossCoefficients
    ) -> dict[str, torch.Tensor]:
        """Writes the gradients of the loss to `grad` of all parameters.

        Args:
            frames: [batch] "observation", "action", "action_log_prob", "advantage", "value_target".
            coefficients: of the loss.

        Returns:
            Means over the frames for the log, as of `ppo_loss`.
        """
        value_coef, observation = coefficients.value_coef, frames["observation"]
        assert value_coef is not None
        passed = hidden_layers(self.layers, observation)
        hidden = passed.second.float()
        weight, bias = self._heads()
        slopes, sums = torch.empty(len(hidden), len(bias)), torch.zeros(6, dtype=torch.float64)
        weighed = torch.tensor(coefficients[:4], dtype=torch.float64)
        names = ("action", "action_log_prob", "advantage", "value_target")
        columns = [frames[name] for name in names]
        tensors = (hidden, weight, bias, *columns, weighed, slopes, sums, self._scratch)
        clipped_loss(*_arrays(tensors))
        behind = torch.empty_like(hidden)
        below_heads(*_arrays((hidden, weight, slopes, behind)))
        of_weight, of_bias = slopes.T @ hidden, slopes.sum(0)
        behind = behind.to(passed.second.dtype)
        of_layers = gradients_of(self.layers, observation, passed, behind)
        layer, below, _ = self.layers
        gradients = {
            self.policy.weight: of_weight[:-1],
            self.policy.bias: of_bias[:-1],
            self.value_head.weight: of_weight[-1:],
            self.value_head.bias: of_bias[-1:],
        }
        weights = (layer.weight, layer.bias, below.weight, below.bias)
        gradients |= zip(weights, of_layers, strict=True)
        for one, gradient in gradients.items():
            one.grad = gradient if one.requires_grad else None
        objective, error, entropy, clipped, change, gain = (sums / len(hidden)).float().unbind()
        terms = {"loss_critic": value_coef * error, "entropy": entropy}
        if math.isinf(coefficients.clip):  # the ratios are 1, so that the gradients are the same
            return {"loss_objective": -gain, **terms}
        measured = {"clip_fraction": clipped, "kl_approx": -change}
        return {"loss_objective": objective, **terms, **measured}


def _arrays(tensors: tuple[torch.Tensor, ...]) -> list[Any]:
    return [tensor.numpy() for tensor in tensors]


def fused_actor_critic(network: ActorCritic, device: str) -> FusedActorCritic | None:
    """The fused form of a network; None if it is not supported.

    Supported are discrete actions and one trunk for policy and value that has `fused_layers`,
    without recurrence, on the CPU. Subclasses are not, as they may compute something else.
    """
    plain = network.form is Categorical and network.policy_memory is None
    if device != "cpu" or not plain or type(network) is not ActorCritic:
        return None
    layers = fused_layers(network.policy_trunk) if network.shared else None
    return None if layers is None else FusedActorCritic(network, layers)
