"""Exploring with continuous actions: noise that may drift and begins anew with every episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from train.networks.continuous import DeterministicActor, GaussianActor
from train.tensors import check_like


class ActionNoise:
    """What is added to the actions of every game, from a random generator of its own.

    Ornstein-Uhlenbeck noise (Uhlenbeck and Ornstein, 1930) in steps of length 1,
    x' = (1 - theta) x + std e, e standard normal: its stationary variance is
    std^2 / (theta (2 - theta)). Gaussian noise is that of theta 1.

    Args:
        kind: "gaussian", "ornstein-uhlenbeck" or "none".
        theta: of the second.
        num_games: each has noise of its own.
        num_actions: numbers of an action.
        seed: of the generator.

    Attributes:
        std: of the next draws.
        state: [num_games, num_actions], x; 0 where an episode begins.
    """

    def __init__(
        self, kind: str, theta: float, num_games: int, num_actions: int, seed: int
    ) -> None:
        self.kind, self.theta = kind, theta if kind == "ornstein-uhlenbeck" else 1.0
        self.std = 0.0
        self.state = torch.zeros(num_games, num_actions)
        own = int(np.random.SeedSequence([seed, 1]).generate_state(1, np.uint64)[0] >> 1)
        self.generator = torch.Generator().manual_seed(own)  # not that of weights or replay

    def normal(self) -> torch.Tensor:
        """[num_games, num_actions] standard normal."""
        return torch.randn(self.state.shape, generator=self.generator)

    def uniform(self) -> torch.Tensor:
        """[num_games, num_actions] in [-1, 1)."""
        return torch.rand(self.state.shape, generator=self.generator) * 2.0 - 1.0

    def step(self) -> torch.Tensor:
        """[num_games, num_actions]: the noise of the next step."""
        self.state = (1.0 - self.theta) * self.state + self.std * self.normal()
        return self.state

    def restart(self, games: torch.Tensor) -> None:
        """Begin at 0 again in the games of the mask [num_games]."""
        self.state = self.state.masked_fill(games[:, None], 0.0)

    def state_dict(self) -> dict[str, Any]:
        """Where it stands, and its generator."""
        return {"state": self.state, "generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there; Misfit for the state of other noise."""
        check_like(state, self.state_dict(), "learner.noise")
        self.state = state["state"].clone()
        self.generator.set_state(state["generator"])


class Explorer:
    """What an actor does, or draws, with noise; or anything at all.

    Args:
        actor: chooses.
        noise: is added.
        device: of the actor.

    Attributes:
        anything: whether actions are uniformly random.
    """

    def __init__(
        self, actor: DeterministicActor | GaussianActor, noise: ActionNoise, device: str
    ) -> None:
        self.actor, self.noise, self.device = actor, noise, device
        self.draws = isinstance(actor, GaussianActor)
        self.anything = True

    def act(self, seen: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """[num_games, actions] float32 in [-1, 1], on the CPU, from the "observation"."""
        noise = self.noise
        if self.anything:
            return noise.uniform()
        drawn = noise.normal().to(self.device) if self.draws else None
        with torch.no_grad():
            action = self.actor.act(seen["observation"].to(self.device), drawn).cpu()
        return action if noise.kind == "none" else (action + noise.step()).clamp_(-1.0, 1.0)
