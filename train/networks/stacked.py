"""Several networks of two hidden layers and one output, on the same inputs, run as one.

With the gradient written out: torch's own takes an array as large as all hidden units for every
bias, activation and mask, and on a processor those cost as much time as a third of the products.
"""

from __future__ import annotations

from typing import Any

import torch


class StackedLayers(torch.autograd.Function):
    """Values [count, batch] of inputs [batch, numbers], by `count` networks.

    Weights are [count, inputs, outputs] and biases [count, 1, outputs] for each of three layers.
    Equal to what torch differentiates by itself, and tested against it.
    """

    @staticmethod
    def forward(
        ctx: Any,
        inputs: torch.Tensor,
        tanh: bool,
        first: torch.Tensor,
        first_bias: torch.Tensor,
        second: torch.Tensor,
        second_bias: torch.Tensor,
        last: torch.Tensor,
        last_bias: torch.Tensor,
    ) -> torch.Tensor:
        """[count, batch]."""
        activate = torch.tanh_ if tanh else torch.relu_
        hidden = activate(torch.bmm(inputs.expand(len(first), -1, -1), first).add_(first_bias))
        higher = activate(torch.bmm(hidden, second).add_(second_bias))
        ctx.save_for_backward(inputs, hidden, higher, first, second, last)
        ctx.tanh = tanh
        # One output: a batched product of a matrix and a vector is several times slower.
        values = [torch.mv(one, weight[:, 0]) for one, weight in zip(higher, last, strict=True)]
        return torch.stack(values).add_(last_bias.squeeze(-1))

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> Any:
        """Those of inputs and weights, where they are asked for."""
        inputs, hidden, higher, first, second, last = ctx.saved_tensors
        above = gradient[:, :, None] * last.mT
        _through(above, higher, ctx.tanh)
        below = torch.bmm(above, second.mT)
        _through(below, hidden, ctx.tanh)
        of_inputs = torch.bmm(below, first.mT).sum(dim=0) if ctx.needs_input_grad[0] else None
        if not ctx.needs_input_grad[2]:
            return of_inputs, *[None] * 7
        lasts = [torch.mv(one.T, slope) for one, slope in zip(higher, gradient, strict=True)]
        return (
            of_inputs,
            None,
            torch.bmm(inputs.T.expand(len(first), -1, -1), below),
            below.sum(dim=1, keepdim=True),
            torch.bmm(hidden.mT, above),
            above.sum(dim=1, keepdim=True),
            torch.stack(lasts)[:, :, None],
            gradient.sum(dim=1)[:, None, None],
        )


def _through(gradient: torch.Tensor, activated: torch.Tensor, tanh: bool) -> None:
    """Make the gradient of what an activation made that of what it was made of, in place."""
    if tanh:
        torch.ops.aten.tanh_backward.grad_input(gradient, activated, grad_input=gradient)
    else:
        torch.ops.aten.threshold_backward.grad_input(gradient, activated, 0, grad_input=gradient)


def stacked_values(inputs: torch.Tensor, tanh: bool, *layers: torch.Tensor) -> torch.Tensor:
    """[count, batch]: see `StackedLayers`, whose weights and biases `layers` are, in turns."""
    values: torch.Tensor = StackedLayers.apply(inputs, tanh, *layers)  # type: ignore[no-untyped-call]
    return values
