"""Generalised advantage estimation (Schulman et al., 2016), in torch and as a compiled kernel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from pursuit.compilation.compiled import compiled


def advantages(
    rollout: Mapping[str, torch.Tensor], gamma: float, gae_lambda: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """[games, steps] advantages, and value targets: advantages plus values.

    Args:
        rollout: [games, steps]: "reward", "value" of the observations, "value_after" of final
            observations, which the next step does not contain, and the flags.
        gamma: discount of a step.
        gae_lambda: 1 makes advantages discounted returns minus the value.
    """
    value, cut, not_done = rollout["value"], rollout["truncated"].clone(), ~rollout["done"]
    cut[:, -1] = True
    following = torch.cat([value[:, 1:], torch.zeros_like(value[:, :1])], dim=1)
    following = torch.where(cut, rollout["value_after"], following)
    discount = torch.tensor(gamma, device=value.device)
    going_on = discount * following * ~rollout["terminated"]
    errors = rollout["reward"] + going_on - value
    fade = discount * torch.tensor(gae_lambda, device=value.device) * not_done
    advantage = torch.empty_like(value)
    ahead = torch.zeros_like(value[:, 0])
    for step in reversed(range(value.shape[1])):
        ahead = errors[:, step] + fade[:, step] * ahead
        advantage[:, step] = ahead
    return advantage, advantage + value


def standardized(advantage: torch.Tensor) -> torch.Tensor:
    """[frames] with mean 0 and standard deviation 1; a single frame stays as it is."""
    if len(advantage) < 2:
        return advantage
    return (advantage - advantage.mean()) / advantage.std().clamp(min=1e-6)


@compiled
def fused_advantages(
    reward: Any, value: Any, cut_value: Any, ended: Any, cut: Any, discounts: Any, out: Any
) -> None:
    """`advantages` as a kernel.

    Args:
        reward: [steps, games] float32.
        value: [steps + 1, games] float32, of the observation before every step and after the last.
        cut_value: [steps, games] float32, of the final observations of truncated episodes.
        ended: [steps, games] bool, whether the episode terminated: the next value is 0.
        cut: [steps, games] bool, whether it was truncated.
        discounts: [2] float64, gamma and gamma times lambda.
        out: [steps, games] float32.
    """
    steps, games = out.shape
    for game in range(games):
        ahead = 0.0
        for back in range(steps):
            step = steps - 1 - back
            follows = value[step + 1, game]
            if ended[step, game]:
                follows, ahead = 0.0, 0.0
            elif cut[step, game]:
                follows, ahead = cut_value[step, game], 0.0
            error = reward[step, game] + discounts[0] * follows - value[step, game]
            ahead = error + discounts[1] * ahead
            out[step, game] = ahead
