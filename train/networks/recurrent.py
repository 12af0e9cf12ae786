"""A GRU between the trunk and the heads of a network.

Training processes whole sequences with an explicit gradient. torch's GRU cell allocates an array
for every gate, step and product, and `nn.GRU` cannot reset its state within a sequence.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn

from train.networks.layers import Hidden

GATES = 3

aten: Any = torch.ops.aten


class RecurrentCell(nn.Module):
    """A GRU (Cho et al., 2014) in torch's form, with a residual connection.

    The input is added to the output, so that without use of the state a policy is learned as fast
    as by a network without a GRU. The state is one row of numbers per game, and starts at 0.

    Args:
        width: size of input, output and state.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.size = width
        self.weight_ih = nn.Parameter(torch.empty(GATES * width, width))
        self.weight_hh = nn.Parameter(torch.empty(GATES * width, width))
        self.bias_ih = nn.Parameter(torch.zeros(GATES * width))
        self.bias_hh = nn.Parameter(torch.zeros(GATES * width))
        for weight in (self.weight_ih, self.weight_hh):
            for gate in weight.detach().chunk(GATES):
                nn.init.orthogonal_(gate)

    def step(self, inputs: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The output [games, width] and the next state [games, width].

        Args:
            inputs: [games, width].
            state: [games, width].
        """
        weights = (self.weight_ih, self.weight_hh, self.bias_ih, self.bias_hh)
        hidden = torch.gru_cell(inputs, state, *weights)
        return inputs + hidden, hidden

    def forward(
        self, inputs: torch.Tensor, state: torch.Tensor, episode_start: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """A whole sequence, with gradients through all steps.

        Args:
            inputs: [games, steps, width].
            state: [games, width] before the first step.
            episode_start: [games, steps] bool, the first steps of episodes, where the state is 0.

        Returns:
            The outputs [games, steps, width], and the states [games, steps, width] after every
            step, without gradient.
        """
        gates = nn.functional.linear(inputs.transpose(0, 1), self.weight_ih, self.bias_ih)
        keep = (~episode_start.T).to(gates.dtype)[:, :, None]
        run: Any = GRUSteps
        hidden, states = run.apply(gates, state, keep, self.weight_hh, self.bias_hh)
        return inputs + hidden.transpose(0, 1), states.transpose(0, 1)


def recurrent_cell_of(hidden: Hidden) -> RecurrentCell | None:
    """The recurrent cell after the hidden layers; None where there is none."""
    return RecurrentCell(hidden.width) if hidden.recurrent else None


def flattened(frames: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Sequences flattened to single frames.

    Args:
        frames: columns [games, steps, ...]; "loss_mask" [games, steps] bool selects the frames of
            the loss. Columns that only sequences have are dropped.
    """
    spent = {"observation", "prepared", "critic_prepared", "state", "episode_start", "loss_mask"}
    flat = {name: column.flatten(0, 1) for name, column in frames.items() if name not in spent}
    if "loss_mask" in frames:
        chosen = frames["loss_mask"].flatten().nonzero().squeeze(-1)
        flat = {name: column.index_select(0, chosen) for name, column in flat.items()}
    return flat


class GRUSteps(torch.autograd.Function):
    """All steps of a GRU; equal to `torch.gru_cell` in a loop (tested)."""

    @staticmethod
    def forward(
        ctx: Any,
        gates: torch.Tensor,
        state: torch.Tensor,
        keep: torch.Tensor,
        weight: torch.Tensor,
        bias: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Outputs [steps, games, width], twice: with gradient, and as states without.

        Args:
            ctx: stores tensors for the backward pass.
            gates: [steps, games, 3 * width], contribution of the inputs to the gates: reset,
                update, new.
            state: [games, width].
            keep: [steps, games, 1], 0 at the first step of an episode.
            weight: [3 * width, width] of the state.
            bias: [3 * width].
        """
        steps, games, width = len(gates), gates.shape[1], weight.shape[1]
        before, hidden, new, recalled = (gates.new_empty(steps, games, width) for _ in range(4))
        opened = gates.new_empty(steps, games, 2 * width)
        for step in range(steps):
            torch.mul(state, keep[step], out=before[step])
            own = torch.addmm(bias, before[step], weight.T)
            torch.add(gates[step, :, : 2 * width], own[:, : 2 * width], out=opened[step])
            opened[step].sigmoid_()
            reset, update = opened[step, :, :width], opened[step, :, width:]
            recalled[step] = own[:, 2 * width :]
            torch.addcmul(gates[step, :, 2 * width :], reset, recalled[step], out=new[step])
            torch.lerp(new[step].tanh_(), before[step], update, out=hidden[step])
            state = hidden[step]
        ctx.save_for_backward(keep, weight, before, opened, new, recalled)
        states = hidden.detach()
        ctx.mark_non_differentiable(states)
        return hidden, states

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor, _: Any) -> Any:
        """The gradients of gates, state, weight and bias."""
        keep, weight, before, opened, new, recalled = ctx.saved_tensors
        steps, games, width = before.shape
        of_inputs = gradient.new_empty(steps, games, 3 * width)
        of_state = gradient.new_empty(steps, games, 3 * width)
        carried = torch.zeros_like(before[0])
        for step in reversed(range(steps)):
            total = gradient[step] + carried
            reset, update = opened[step, :, :width], opened[step, :, width:]
            by_new = aten.tanh_backward(total - total * update, new[step])
            by_open = torch.cat([by_new * recalled[step], total * (before[step] - new[step])], -1)
            by_open = aten.sigmoid_backward(by_open, opened[step])
            of_inputs[step, :, : 2 * width] = by_open
            of_inputs[step, :, 2 * width :] = by_new
            of_state[step, :, : 2 * width] = by_open
            torch.mul(by_new, reset, out=of_state[step, :, 2 * width :])
            carried = torch.addmm(total * update, of_state[step], weight).mul_(keep[step])
        flat = of_state.flatten(0, 1)
        of_weight = flat.T @ before.flatten(0, 1)
        return of_inputs, carried, None, of_weight, flat.sum(dim=0)
