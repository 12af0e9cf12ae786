"""A batch of arms of the ReacherSimulator as a native TorchRL environment."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.data import Bounded, Categorical, Composite

from pursuit.reacher.observations import space_of
from pursuit.reacher.simulator import ReacherSimulator
from train.environments.hooks import EpisodeHook
from train.environments.lockstep import LockstepEnv, StepOutcome
from train.networks.arm_policy import ArmSeat


class ArmEnv(LockstepEnv):
    """An environment in which the learner moves every arm; keys are those of `LockstepEnv`.

    "action" is [batch, joints] float32 in [-1, 1]; with discrete actions [batch] int64, the index
    of a joint action (see `ReacherTask.actions_of`).

    Args:
        simulator: made with `auto_restart=False`.
        player: the learning agent, with the encoding of its observations.
        hook: configures the next episodes.
    """

    simulator: ReacherSimulator
    player: ArmSeat

    def __init__(
        self, simulator: ReacherSimulator, player: ArmSeat, hook: EpisodeHook | None = None
    ) -> None:
        super().__init__(simulator, hook)
        self.player, self.encoding, batch = player, player.encoding, simulator.num_games
        if player.continuous:
            shape = (batch, player.num_actions)
            self.action_spec = Bounded(-1.0, 1.0, shape=shape, dtype=torch.float32)
        else:
            self.action_spec = Categorical(player.num_actions, shape=(batch,), dtype=torch.int64)
        space = space_of(simulator.task, self.encoding)
        low, high = (torch.as_tensor(end).expand(batch, -1) for end in (space.low, space.high))
        seen = Bounded(low, high, shape=(batch, *space.shape), dtype=torch.float32)
        self.observation_spec = Composite({"observation": seen}, shape=(batch,))

    def _returns(self, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        return self.simulator.returns[games]

    def _observe(self) -> dict[str, torch.Tensor]:
        return {"observation": torch.from_numpy(self.simulator.observe(self.encoding))}

    def _play(self, actions: torch.Tensor) -> StepOutcome:
        simulator, moves = self.simulator, actions.numpy()
        simulator.step(moves if self.player.continuous else simulator.task.actions_of(moves))
        terminated, truncated = simulator.terminated.copy(), simulator.truncated.copy()
        return StepOutcome(simulator.rewards.copy(), terminated, truncated, simulator.ended)
