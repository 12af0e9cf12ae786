"""What a network remembers from step to step: a GRU or an LSTM between its trunk and its heads.

Learning runs through whole sequences at once, with the gradient written out: torch's cells take an
array for every gate, step and product by themselves, and a layer of torch's (`nn.GRU`) cannot begin
anew in the middle of a sequence.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn

from train.networks.layers import Hidden

GATES = {"gru": 3, "lstm": 4}
"""The kinds of cells, and the gates of each."""

aten: Any = torch.ops.aten


class Cell(nn.Module):
    """A GRU (Cho et al., 2014) or an LSTM (Hochreiter and Schmidhuber, 1997) in torch's form.

    What comes in is added to what comes out: without a memory the heads would see that alone, and
    what can be done without one is learned as fast so.

    Its state is one row of numbers for every game: of a GRU its output, of an LSTM that and its
    cell. Nothing is remembered where it is 0.

    Args:
        kind: "gru" or "lstm".
        width: numbers that come in, and that come out.
    """

    def __init__(self, kind: str, width: int) -> None:
        super().__init__()
        self.kind, self.width = kind, width
        gates = GATES[kind]
        self.weight_ih = nn.Parameter(torch.empty(gates * width, width))
        self.weight_hh = nn.Parameter(torch.empty(gates * width, width))
        self.bias_ih = nn.Parameter(torch.zeros(gates * width))
        self.bias_hh = nn.Parameter(torch.zeros(gates * width))
        for weight in (self.weight_ih, self.weight_hh):
            for gate in weight.detach().chunk(gates):
                nn.init.orthogonal_(gate)

    @property
    def size(self) -> int:
        """Numbers of a state."""
        return self.width * (2 if self.kind == "lstm" else 1)

    def step(self, inputs: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What comes out [games, width], and the state [games, size] after it.

        Args:
            inputs: [games, width].
            state: [games, size].
        """
        weights = (self.weight_ih, self.weight_hh, self.bias_ih, self.bias_hh)
        if self.kind == "gru":
            hidden = torch.gru_cell(inputs, state, *weights)
            return inputs + hidden, hidden
        hidden, cell = torch.lstm_cell(inputs, state.chunk(2, dim=-1), *weights)
        return inputs + hidden, torch.cat([hidden, cell], dim=-1)

    def forward(
        self, inputs: torch.Tensor, state: torch.Tensor, episode_start: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """A step after the other, with gradients through all of them.

        Args:
            inputs: [games, steps, width].
            state: [games, size] before the first step.
            episode_start: [games, steps] bool: an episode begins here, so nothing is remembered.

        Returns:
            What comes out [games, steps, width], and the states [games, steps, size] after every
            step, which have no gradient.
        """
        gates = nn.functional.linear(inputs.transpose(0, 1), self.weight_ih, self.bias_ih)
        keep = (~episode_start.T).to(gates.dtype)[:, :, None]
        run: Any = GRUSteps if self.kind == "gru" else LSTMSteps
        hidden, states = run.apply(gates, state, keep, self.weight_hh, self.bias_hh)
        return inputs + hidden.transpose(0, 1), states.transpose(0, 1)


def cell_of(hidden: Hidden) -> Cell | None:
    """What follows the hidden layers, where something is to be remembered."""
    return Cell(hidden.recurrent, hidden.width) if hidden.recurrent else None


def flattened(frames: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Sequences as frames in a row.

    Args:
        frames: columns [games, steps, ...]; "loss_mask" [games, steps] bool leaves out those that
            are not to be learned from. What only a sequence has is left out.
    """
    spent = {"observation", "prepared", "state", "episode_start", "loss_mask"}
    flat = {name: column.flatten(0, 1) for name, column in frames.items() if name not in spent}
    if "loss_mask" in frames:
        chosen = frames["loss_mask"].flatten().nonzero().squeeze(-1)
        flat = {name: column.index_select(0, chosen) for name, column in flat.items()}
    return flat


class GRUSteps(torch.autograd.Function):
    """All steps of a GRU: equal to `torch.gru_cell` in a loop, and tested against it."""

    @staticmethod
    def forward(
        ctx: Any,
        gates: torch.Tensor,
        state: torch.Tensor,
        keep: torch.Tensor,
        weight: torch.Tensor,
        bias: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Outputs [steps, games, width], twice: as they are, and as states.

        Args:
            ctx: torch's.
            gates: [steps, games, 3 * width], what the inputs add to the gates: reset, update, new.
            state: [games, width].
            keep: [steps, games, 1], 0 where an episode begins.
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
        """Those of gates, state, weight and bias."""
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


class LSTMSteps(torch.autograd.Function):
    """All steps of an LSTM: equal to `torch.lstm_cell` in a loop, and tested against it."""

    @staticmethod
    def forward(
        ctx: Any,
        gates: torch.Tensor,
        state: torch.Tensor,
        keep: torch.Tensor,
        weight: torch.Tensor,
        bias: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Outputs [steps, games, width] and states [steps, games, 2 * width].

        Args:
            ctx: torch's.
            gates: [steps, games, 4 * width], what the inputs add to the gates: input, forget, cell,
                output.
            state: [games, 2 * width].
            keep: [steps, games, 1], 0 where an episode begins.
            weight: [4 * width, width] of the output.
            bias: [4 * width].
        """
        steps, games, width = len(gates), gates.shape[1], weight.shape[1]
        before, states = (gates.new_empty(steps, games, 2 * width) for _ in range(2))
        opened = gates.new_empty(steps, games, 4 * width)
        squashed = gates.new_empty(steps, games, width)
        for step in range(steps):
            torch.mul(state, keep[step], out=before[step])
            here, now = opened[step], states[step]
            torch.addmm(bias, before[step, :, :width], weight.T, out=here)
            here += gates[step]
            here[:, : 2 * width].sigmoid_()
            here[:, 2 * width : 3 * width].tanh_()
            here[:, 3 * width :].sigmoid_()
            enter, forget, new, leave = here.chunk(4, dim=-1)
            cell = now[:, width:]
            torch.mul(forget, before[step, :, width:], out=cell)
            cell.addcmul_(enter, new)
            torch.tanh(cell, out=squashed[step])
            torch.mul(leave, squashed[step], out=now[:, :width])
            state = now
        ctx.save_for_backward(keep, weight, before, opened, squashed)
        ctx.mark_non_differentiable(states)
        return states[..., :width].clone(), states

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor, _: Any) -> Any:
        """Those of gates, state, weight and bias."""
        keep, weight, before, opened, squashed = ctx.saved_tensors
        steps, games, width = squashed.shape
        of_gates = gradient.new_empty(steps, games, 4 * width)
        carried = torch.zeros_like(squashed[0])
        of_cell = torch.zeros_like(carried)
        for step in reversed(range(steps)):
            total = gradient[step] + carried
            enter, forget, new, leave = opened[step].chunk(4, dim=-1)
            of_cell = of_cell + aten.tanh_backward(total * leave, squashed[step])
            here = of_gates[step]
            torch.mul(of_cell, new, out=here[:, :width])
            torch.mul(of_cell, before[step, :, width:], out=here[:, width : 2 * width])
            torch.mul(total, squashed[step], out=here[:, 3 * width :])
            here[:, : 2 * width] = aten.sigmoid_backward(
                here[:, : 2 * width], opened[step, :, : 2 * width]
            )
            here[:, 2 * width : 3 * width] = aten.tanh_backward(of_cell * enter, new)
            here[:, 3 * width :] = aten.sigmoid_backward(here[:, 3 * width :], leave)
            carried = (here @ weight).mul_(keep[step])
            of_cell = of_cell * forget * keep[step]
        flat = of_gates.flatten(0, 1)
        of_weight = flat.T @ before[..., :width].flatten(0, 1)
        return of_gates, torch.cat([carried, of_cell], -1), None, of_weight, flat.sum(dim=0)
