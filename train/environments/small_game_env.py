"""A batch of copies of a small game as a native TorchRL environment."""

from __future__ import annotations

import numpy as np
import torch

from scripted_agents.games.simulator import GameSimulator
from train.environments.lockstep import StepOutcome
from train.environments.seat_env import SeatEnv
from train.networks.small_game_policy import SmallGameSeat


class SmallGameTrainingEnv(SeatEnv):
    """An environment in which the learner is one player of every game; as `SeatEnv`.

    Attributes:
        bounded: whether the time limit ends the game: without discount, returns are those within
            it, so nothing is bootstrapped after it.
    """

    simulator: GameSimulator
    player: SmallGameSeat
    bounded: bool = False

    def _bounds(self) -> tuple[torch.Tensor, torch.Tensor]:
        seen = torch.from_numpy(self.player.observed)
        return seen.amin(dim=0), seen.amax(dim=0)

    def _observe(self) -> dict[str, torch.Tensor]:
        state = self.simulator.state
        found = {"observation": torch.from_numpy(self.player.observed[state])}
        if self.player.has_masks:
            self._masked(found, self.player.legal[state])
        return found

    def _play(self, actions: torch.Tensor) -> StepOutcome:
        games, rewards = self.simulator, self._move(actions.numpy()[:, None])
        terminated, truncated = games.terminated.copy(), games.truncated.copy()
        if self.bounded:
            terminated, truncated = terminated | truncated, np.zeros_like(truncated)
        return StepOutcome(rewards * np.float32(self.scale), terminated, truncated, games.ended)
