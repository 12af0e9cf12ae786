"""Fused hidden layers for "index" observations on the CPU, with an explicit gradient.

A small network spends as much time in casts, copies and small operations as in its matrix products.
A kernel sums the rows of the first layer, and does the rest of that layer. The function equals
`Trunk.forward` up to the order of summation; with bfloat16 the first layer stays float32.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import nn

from train.networks.fused_kernels import first_layer, first_layer_gradient
from train.networks.layers import IndexLayer, Trunk


class FusedLayers(NamedTuple):
    """The layers of a trunk that can be fused, looked up once, as module lookups are slow."""

    first: IndexLayer
    second: nn.Linear
    bfloat16: bool


def fused_layers(trunk: Trunk) -> FusedLayers | None:
    """The layers of a trunk with an `IndexLayer` and ReLUs; None for all others.

    Subclasses are not fused, as they may compute something else.
    """
    first, rest = trunk.first, [*trunk.rest]
    if type(first) is not IndexLayer or type(trunk) is not Trunk:
        return None
    if [type(layer) for layer in rest] != [nn.ReLU, nn.Linear, nn.ReLU]:
        return None
    return FusedLayers(first, rest[1], trunk.autocast_bfloat16)


def fused_hidden(layers: FusedLayers, observation: torch.Tensor) -> torch.Tensor:
    """[batch, width] float32 of observations [batch, numbers]; on the CPU."""
    if torch.is_grad_enabled():
        first, second, _ = layers
        weights = (first.weight, first.bias, second.weight, second.bias)
        hidden: torch.Tensor = HiddenLayers.apply(  # type: ignore[no-untyped-call]
            layers, observation.contiguous(), *weights
        )
        return hidden
    return hidden_layers(layers, observation).second.float()


class Passed(NamedTuple):
    """Results of a forward pass, [batch, width] each.

    Attributes:
        first: float32, the first hidden layer.
        rounded: the same, in the type of the matrix products.
        second: the second hidden layer, in the type of the matrix products.
    """

    first: torch.Tensor
    rounded: torch.Tensor
    second: torch.Tensor


def second_layer(layers: FusedLayers) -> tuple[torch.Tensor, torch.Tensor]:
    """Bias [width] and transposed weight [width, width] of the second layer, in the type of the
    matrix products."""
    form = torch.bfloat16 if layers.bfloat16 else torch.float32
    return layers.second.bias.detach().to(form), layers.second.weight.detach().T.to(form)


def hidden_layers(
    layers: FusedLayers,
    observation: torch.Tensor,
    second: tuple[torch.Tensor, torch.Tensor] | None = None,
) -> Passed:
    """Both hidden layers of observations [batch, numbers], without autograd.

    `second` is the result of `second_layer`, where it is known already.
    """
    layer = layers.first
    first = torch.empty(len(observation), len(layer.bias))
    arrays = (observation, layer.rows, layer.weight.detach(), layer.bias.detach(), first)
    first_layer(*(tensor.numpy() for tensor in arrays))
    bias, weight = second or second_layer(layers)
    rounded = first.to(bias.dtype)
    return Passed(first, rounded, torch.addmm(bias, rounded, weight).relu_())


def gradients_of(
    layers: FusedLayers, observation: torch.Tensor, passed: Passed, behind: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """The gradients of both layers: first weight, first bias, second weight, second bias.

    Args:
        layers: the hidden layers.
        observation: [batch, numbers].
        passed: the result of `hidden_layers`.
        behind: [batch, width], the gradient before the second ReLU, in the type of the products.
    """
    layer, second, _ = layers
    of_weight = (behind.T @ passed.rounded).float()
    ahead = (behind @ second.weight.detach().to(behind.dtype)).float()
    of_table, of_bias = torch.zeros_like(layer.weight), torch.zeros_like(layer.bias)
    tensors = (observation, layer.rows, passed.first, ahead, of_table, of_bias)
    first_layer_gradient(*(tensor.detach().numpy() for tensor in tensors))
    return of_table, of_bias, of_weight, behind.sum(0, dtype=torch.float32)


class HiddenLayers(torch.autograd.Function):
    """`hidden_layers` with its explicit gradient for all weights."""

    @staticmethod
    def forward(
        ctx: Any, layers: FusedLayers, observation: torch.Tensor, *_: torch.Tensor
    ) -> torch.Tensor:
        """[batch, width] float32.

        Args:
            ctx: stores tensors for the backward pass.
            layers: the layers of the weights, which are passed as further arguments for autograd.
            observation: [batch, numbers].
        """
        passed = hidden_layers(layers, observation)
        ctx.save_for_backward(observation, *passed)
        ctx.layers = layers
        return passed.second.float()

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """The gradients of the four weights, from the gradient of the result [batch, width]."""
        observation, *kept = ctx.saved_tensors
        passed = Passed(*kept)
        behind = torch.ops.aten.threshold_backward(grad.to(passed.second.dtype), passed.second, 0)
        return None, None, *gradients_of(ctx.layers, observation, passed, behind)
