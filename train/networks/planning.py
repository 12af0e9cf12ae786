"""A planning layer: shortest paths in the observed maze, with learned costs and sources.

A small value iteration network (Tamar et al., 2016): every cell has a source value, and leaving it
has a cost. Both are linear in the planes at the cell. Values propagate by
v(s) = max(source(s), max_a v(s + a) - cost(s, a)) until convergence. With high costs at walls and
one source at the goal, -v is the length of the shortest path. Which planes are walls and which are
goals is learned from rewards, by gradients along the best paths.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn

from train.networks.features import Features
from train.networks.planning_kernels import CHANNELS, NOWHERE, plan, trace


class Paths(torch.autograd.Function):
    """The value of each direction from the agent's cell."""

    @staticmethod
    def forward(
        ctx: Any, planes: torch.Tensor, sources: torch.Tensor, costs: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """[games, 5, channels] of the four directions and the source of the cell; and the planes
        around the agent [games, 9, planes].

        Args:
            ctx: stores tensors for the backward pass.
            planes: [games, planes, rows, columns] float32; the first has 1 at the agent's cell.
            sources: [planes + 1, channels], what each plane adds to the source of a cell; the last
                row is a bias.
            costs: [planes + 1, 4 * channels], likewise for the cost of leaving a cell to the north
                and so on; >= 0.
        """
        columns = planes.shape[-1]
        arrays = planes.flatten(2).numpy(), sources.detach().numpy(), costs.detach().numpy()
        games, num_planes, places = arrays[0].shape
        ways = np.empty((games, CHANNELS, places), dtype=np.int8)
        at = np.empty(games, dtype=np.int64)
        worth, around = planes.new_empty(games, 5, CHANNELS), planes.new_empty(games, 9, num_planes)
        plan(*arrays, columns, ctx.needs_input_grad[1], ways, at, worth.numpy(), around.numpy())
        ctx.seen = (arrays[0], columns, ways, at, worth.numpy())
        ctx.save_for_backward(sources, costs)
        ctx.mark_non_differentiable(around)
        return worth, around

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor, _: Any) -> Any:
        """The gradients of sources and costs."""
        of_weights = [torch.zeros_like(weights) for weights in ctx.saved_tensors]
        given = gradient.contiguous().numpy()
        planes, columns, ways, at, worth = ctx.seen
        trace(planes, columns, ways, at, worth, given, *(zero.numpy() for zero in of_weights))
        return None, *of_weights


def paths(
    planes: torch.Tensor, sources: torch.Tensor, costs: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """`Paths.forward` with autograd for sources and costs."""
    return Paths.apply(planes, sources, costs)  # type: ignore[no-untyped-call]


class Planning(nn.Module):
    """Values of the directions on learned shortest paths, and the nearby planes, to `width`.

    Args:
        features: of kind "grid": planes, the first of which marks the agent.
        width: outputs.

    Attributes:
        sources: [planes + 1, channels], a tenth of the sources of `paths`.
        costs: [planes + 1, 4 * channels], a fifth of the costs of `paths` before softplus.
    """

    def __init__(self, features: Features, width: int) -> None:
        super().__init__()
        planes = features.shape[0]
        self.scale = 1.0 / max(float(np.max(features.high)), 1.0)
        self.sources = nn.Parameter(torch.randn(planes + 1, CHANNELS) * 0.5)
        self.costs = nn.Parameter(torch.randn(planes + 1, 4 * CHANNELS) * 0.1 - 0.4)
        with torch.no_grad():
            self.sources[-1] = -1.0
        self.linear = nn.Linear(5 * CHANNELS + 9 * planes, width)

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """The observation as float32, scaled to at most 1."""
        return observation.float() * self.scale if self.scale < 1.0 else observation.float()

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width] from [..., planes, rows, columns]."""
        planes = prepared.reshape(-1, *prepared.shape[-3:]).contiguous()
        costs = nn.functional.softplus(5.0 * self.costs.float())
        worth, around = paths(planes, 10.0 * self.sources.float(), costs)
        best = worth.amax(1)
        ways = (worth[:, :4] - best[:, None]).exp()
        seen = [ways.flatten(1), 0.1 * best.clamp(min=float(NOWHERE)), around.flatten(1)]
        hidden: torch.Tensor = self.linear(torch.cat(seen, -1))
        return hidden.reshape(*prepared.shape[:-3], -1)
