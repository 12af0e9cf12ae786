"""The hidden layers on "index" as one operation, with its gradient written out; on the CPU.

A small network spends as long on casts, copies and the bookkeeping of a dozen small operations as
on its matrix products. Here a kernel sums the rows of the first layer, which a product with
one-hots would, and does all else that is done there. The same function as `Trunk.forward`, whose
sums are taken in another order; where products are in bfloat16, the first layer is not.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import nn

from train.networks.joined_kernels import first_layer, first_layer_gradient
from train.networks.layers import IndexLayer, Trunk


class Joinable(NamedTuple):
    """The layers of a trunk that can be joined, found once: a module takes long to look one up."""

    first: IndexLayer
    second: nn.Linear
    bfloat16: bool


def joinable(trunk: Trunk) -> Joinable | None:
    """The layers of a trunk of the form that is written out here: rows without pairs, and ReLUs.

    None for any other.
    """
    first, second = trunk.first, trunk.rest[1]
    if not isinstance(first, IndexLayer) or first.pairs is not None:
        return None
    if not isinstance(trunk.rest[0], nn.ReLU) or not isinstance(second, nn.Linear):
        return None
    return Joinable(first, second, trunk.autocast_bfloat16)


def joined(layers: Joinable, observation: torch.Tensor) -> torch.Tensor:
    """[batch, width] float32 of observations [batch, numbers]; on the CPU."""
    if torch.is_grad_enabled():
        first, second, _ = layers
        weights = (first.weight, first.bias, second.weight, second.bias)
        hidden: torch.Tensor = HiddenLayers.apply(  # type: ignore[no-untyped-call]
            layers, observation.contiguous(), *weights
        )
        return hidden
    return hidden_layers(layers, observation)[1].float()


def hidden_layers(layers: Joinable, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Both hidden layers [batch, width], without their history.

    The first is float32; where products are in bfloat16 the second is too.
    """
    layer, second, bfloat16 = layers
    first = torch.empty(len(observation), len(layer.bias))
    given = (observation, layer.rows, layer.weight.detach(), layer.bias.detach(), first)
    first_layer(*(tensor.numpy() for tensor in given))
    weight, bias = second.weight.detach(), second.bias.detach()
    if not bfloat16:
        return first, torch.addmm(bias, first, weight.T).relu_()
    products = (one.bfloat16() for one in (bias, first, weight.T))
    return first, torch.addmm(*products).relu_()


def gradients_of(
    layers: Joinable,
    observation: torch.Tensor,
    first: torch.Tensor,
    behind: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """The gradients of both layers' weights and biases: table, bias, second weight, second bias.

    Args:
        layers: the hidden layers.
        observation: [batch, numbers].
        first: [batch, width] float32, as `hidden_layers` gave it.
        behind: [batch, width], the gradient before the second ReLU, in what products are in.
    """
    layer, second, _ = layers
    form = behind.dtype
    of_weight = (behind.T @ first.to(form)).float()
    ahead = (behind @ second.weight.detach().to(form)).float()
    of_table, of_bias = torch.zeros_like(layer.weight), torch.zeros_like(layer.bias)
    given = (observation, layer.rows, first, ahead, of_table, of_bias)
    first_layer_gradient(*(tensor.detach().numpy() for tensor in given))
    return of_table, of_bias, of_weight, behind.sum(0, dtype=torch.float32)


class HiddenLayers(torch.autograd.Function):
    """`hidden_layers` with its gradient, for all weights."""

    @staticmethod
    def forward(
        ctx: Any, layers: Joinable, observation: torch.Tensor, *_: torch.Tensor
    ) -> torch.Tensor:
        """[batch, width] float32.

        Args:
            ctx: keeps what the gradient needs.
            layers: whose weights the rest are, for autograd to know of them.
            observation: [batch, numbers].
        """
        first, second = hidden_layers(layers, observation)
        ctx.save_for_backward(observation, first, second)
        ctx.layers = layers
        return second.float()

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """The gradients of the four weights, from that of the result [batch, width]."""
        observation, first, second = ctx.saved_tensors
        behind = torch.ops.aten.threshold_backward(grad.to(second.dtype), second, 0)
        return None, None, *gradients_of(ctx.layers, observation, first, behind)
