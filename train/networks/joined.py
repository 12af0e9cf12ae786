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
    first, second, bfloat16 = layers
    weights = (first.weight, first.bias, second.weight, second.bias)
    given = (observation.contiguous(), first.rows, *weights, bfloat16)
    if torch.is_grad_enabled():
        hidden: torch.Tensor = HiddenLayers.apply(*given)  # type: ignore[no-untyped-call]
        return hidden
    return _forward(*given)[1].float()


def _forward(
    observation: torch.Tensor,
    rows: torch.Tensor,
    table: torch.Tensor,
    bias: torch.Tensor,
    weight: torch.Tensor,
    second_bias: torch.Tensor,
    bfloat16: bool,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Both hidden layers [batch, width]: in float32, and in what products are in."""
    first = torch.empty(len(observation), len(bias))
    given = (observation, rows, table.detach(), bias.detach(), first)
    first_layer(*(tensor.numpy() for tensor in given))
    if not bfloat16:
        return first, torch.addmm(second_bias, first, weight.T).relu_()
    products = (one.bfloat16() for one in (second_bias, first, weight.T))
    return first, torch.addmm(*products).relu_()


class HiddenLayers(torch.autograd.Function):
    """`_forward` with its gradient, for all weights."""

    @staticmethod
    def forward(
        ctx: Any,
        observation: torch.Tensor,
        rows: torch.Tensor,
        table: torch.Tensor,
        bias: torch.Tensor,
        weight: torch.Tensor,
        second_bias: torch.Tensor,
        bfloat16: bool,
    ) -> torch.Tensor:
        """[batch, width] float32.

        Args:
            ctx: keeps what the gradient needs.
            observation: [batch, numbers].
            rows: [numbers] int64, the row of the table that each number names.
            table: [rows + 1, width]; the last row is none.
            bias: [width].
            weight: [width, width], of the second layer.
            second_bias: [width].
            bfloat16: whether the products of the second layer are in bfloat16.
        """
        layers = _forward(observation, rows, table, bias, weight, second_bias, bfloat16)
        ctx.save_for_backward(observation, rows, *layers, weight)
        ctx.size = len(table)
        return layers[1].float()

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """The gradients of the four weights, from that of the result [batch, width]."""
        observation, rows, first, second, weight = ctx.saved_tensors
        form, width = second.dtype, first.shape[1]
        behind = torch.ops.aten.threshold_backward(grad.to(form), second, 0)
        of_weight = (behind.T @ first.to(form)).float()
        ahead = (behind @ weight.to(form)).float()
        of_table, of_bias = torch.zeros(ctx.size, width), torch.zeros(width)
        given = (observation, rows, first, ahead, of_table, of_bias)
        first_layer_gradient(*(tensor.numpy() for tensor in given))
        of_second_bias = behind.sum(0, dtype=torch.float32)
        return None, None, of_table, of_bias, of_weight, of_second_bias, None
