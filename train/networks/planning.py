"""A first layer that plans: shortest paths in what is seen, with costs and ends that are learned.

A value iteration network (Tamar et al., 2016) in its smallest form: every place has a value of its
own, leaving it costs something, both are linear in the planes there, and values spread by
v(s) = max(source(s), max_a v(s + a) - cost(s, a)) until nothing changes. With high costs of walls
and one source at the goal, -v is the length of the shortest path. Nothing of that is given: which
planes are walls and which are goals is learned from rewards, by gradients along the best paths.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn

from train.networks.features import Features
from train.networks.planning_kernels import CHANNELS, NOWHERE, plan, trace


class Paths(torch.autograd.Function):
    """What each way from where the agent is, is worth."""

    @staticmethod
    def forward(
        ctx: Any, planes: torch.Tensor, sources: torch.Tensor, costs: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """[games, 5, channels] of the four ways and of staying, and [games, 9, planes] around.

        Args:
            ctx: torch's.
            planes: [games, planes, rows, columns] float32; the first has 1 where the agent is.
            sources: [planes + 1, channels], what each plane adds to the value of a place by
                itself; the last row is always added.
            costs: [planes + 1, 4 * channels], the same for leaving it northwards and so on; >= 0.
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
        """Those of sources and costs."""
        of_weights = [torch.zeros_like(weights) for weights in ctx.saved_tensors]
        given = gradient.contiguous().numpy()
        planes, columns, ways, at, worth = ctx.seen
        trace(planes, columns, ways, at, worth, given, *(zero.numpy() for zero in of_weights))
        return None, *of_weights


def paths(
    planes: torch.Tensor, sources: torch.Tensor, costs: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """`Paths.forward`, with gradients of sources and costs."""
    found: tuple[torch.Tensor, torch.Tensor] = Paths.apply(planes, sources, costs)  # type: ignore[no-untyped-call]
    return found


class Planning(nn.Module):
    """What each way is worth on learned shortest paths, and what lies right around, to `width`.

    Args:
        features: of the kind "grid": planes of which the first is where the agent itself is.
        width: outputs.

    Attributes:
        sources: [planes + 1, channels], a tenth of those of `paths`.
        costs: [planes + 1, 4 * channels], those of `paths` before softplus, a fifth of them.
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
        """The observation itself, where it is float32 up to 1."""
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
