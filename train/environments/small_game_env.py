"""A batch of copies of a small game as a native TorchRL environment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec

from pursuit.observations.masks import ACTION_MASK
from scripted_agents.games.simulator import GameSimulator, StatePolicy
from train.environments.hooks import EpisodeHook
from train.environments.lockstep import LockstepEnv, StepOutcome
from train.networks.small_game_policy import SmallGameSeat


class SmallGameTrainingEnv(LockstepEnv):
    """An environment in which the learner is one player of every game; keys are those of
    `LockstepEnv`.

    "action" is [batch] int64, the number of an action. Where not all actions are always legal,
    "action_mask" ([batch, actions] bool) marks the legal ones.

    Args:
        simulator: made with `auto_restart=False`.
        player: the learning player, with the encoding of its observations.
        policies: the policy of each player; None for the learner.
        hook: configures the next episodes.
        scale: factor of the rewards.
        bounded: whether the time limit ends the game: without discount, returns are those within
            it, so nothing is bootstrapped after it.
    """

    simulator: GameSimulator
    player: SmallGameSeat

    def __init__(
        self,
        simulator: GameSimulator,
        player: SmallGameSeat,
        policies: Sequence[StatePolicy | None],
        hook: EpisodeHook | None = None,
        scale: float = 1.0,
        bounded: bool = False,
    ) -> None:
        super().__init__(simulator, hook)
        self.player, self.policies, self.scale = player, list(policies), scale
        self.bounded = bounded
        self.encoding, self.seat = player.encoding, player.number
        batch, actions = simulator.num_games, player.num_actions
        self._actions = np.zeros((batch, simulator.task.num_agents), dtype=np.int32)
        self.idle = np.zeros((batch, 1), dtype=bool)
        self.action_spec = Categorical(actions, shape=(batch,), dtype=torch.int64)
        seen = torch.from_numpy(player.observed)
        shape = (batch, *seen.shape[1:])
        low, high = (end.expand(shape) for end in (seen.amin(dim=0), seen.amax(dim=0)))
        spec: dict[str, TensorSpec] = {
            "observation": Bounded(low, high, shape=shape, dtype=seen.dtype)
        }
        if player.has_masks:
            spec[ACTION_MASK] = Binary(n=actions, shape=(batch, actions), dtype=torch.bool)
        self.observation_spec = Composite(spec, shape=(batch,))

    def _returns(self, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        return self.simulator.returns[games, self.seat]

    def _observe(self) -> dict[str, torch.Tensor]:
        state = self.simulator.state
        found = {"observation": torch.from_numpy(self.player.observed[state])}
        if self.player.has_masks:
            found[ACTION_MASK] = torch.from_numpy(self.player.legal[state])
            self.action_spec.update_mask(found[ACTION_MASK])
        return found

    def _play(self, actions: torch.Tensor) -> StepOutcome:
        simulator = self.simulator
        simulator.act(self.policies, self._actions)
        self._actions[:, self.seat] = actions.numpy()
        simulator.step(self._actions)
        rewards = simulator.rewards[:, self.seat] * np.float32(self.scale)
        terminated, truncated = simulator.terminated.copy(), simulator.truncated.copy()
        if self.bounded:
            terminated, truncated = terminated | truncated, np.zeros_like(truncated)
        return StepOutcome(rewards, terminated, truncated, simulator.ended)
