"""Exploration noise for continuous actions, reset with every episode."""

from __future__ import annotations

import numpy as np
import torch

from train.tensors import StateDict


class ActionNoise:
    """Noise on the actions of every game, from its own random generator.

    Ornstein-Uhlenbeck noise (Uhlenbeck and Ornstein, 1930) in steps of length 1,
    x' = (1 - theta) x + std e, e standard normal: its stationary variance is
    std^2 / (theta (2 - theta)). Gaussian noise is that of theta 1.

    Args:
        kind: "gaussian", "ornstein-uhlenbeck" or "none".
        theta: mean reversion rate of Ornstein-Uhlenbeck noise.
        num_games: games with independent noise.
        num_actions: dimensions of an action.
        seed: of the generator.

    Attributes:
        std: standard deviation of the next draws.
        state: [num_games, num_actions], x; 0 at the start of an episode.
    """

    def __init__(
        self, kind: str, theta: float, num_games: int, num_actions: int, seed: int
    ) -> None:
        self.kind, self.theta = kind, theta if kind == "ornstein-uhlenbeck" else 1.0
        self.std = 0.0
        self.state = torch.zeros(num_games, num_actions)
        own = int(np.random.SeedSequence([seed, 1]).generate_state(1, np.uint64)[0] >> 1)
        self.generator = torch.Generator().manual_seed(own)  # independent of weights and replay

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
        """Reset the noise to 0 in the games of the mask [num_games]."""
        self.state = self.state.masked_fill(games.cpu()[:, None], 0.0)

    def state_dict(self) -> StateDict:
        """The noise, and the state of the generator."""
        return {"state": self.state, "generator": self.generator.get_state()}

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state."""
        self.state = state["state"].clone()
        self.generator.set_state(state["generator"])
