"""The base class of off-policy learners, with the replay buffer and the update loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import torch
from torch import nn

from curricula import linear
from train.algorithms.collector import Collector, Columns
from train.algorithms.learner import NetworkLearner, VecEnv, has_masks, means
from train.algorithms.prioritized import Priorities
from train.algorithms.replay import Minibatch, ReplayBuffer, n_step_rows
from train.settings.off_policy import ReplaySettings
from train.tensors import StateDict


class OffPolicyLearner(NetworkLearner, ABC):
    """Each iteration adds a rollout to the replay buffer and takes `gradient_steps`.

    Subclasses implement exploration (`explore`) and the gradient step (`learn`).

    Args:
        settings: the hyperparameters.
        env: the training environment.
        network: chooses the actions.
        collector: collects the rollouts.
        device: of the networks.
        seed: of the draws from the replay buffer.
    """

    COUNTERS: ClassVar[tuple[str, ...]] = ("frames", "updates")
    settings: ReplaySettings

    def __init__(
        self,
        settings: ReplaySettings,
        env: VecEnv,
        network: nn.Module,
        collector: Collector,
        device: str,
        seed: int,
    ) -> None:
        super().__init__(settings, env, network, device)
        self.updates, self.masks, self.collector = 0, has_masks(env), collector
        self.beta, exponent = settings.importance_exponent, settings.priority_exponent
        priorities = Priorities(settings.buffer_size, exponent) if settings.prioritized else None
        self.generator = torch.Generator().manual_seed(seed)
        self.replay = ReplayBuffer(settings.buffer_size, self.generator, priorities)

    @property
    def learning(self) -> bool:
        """Whether gradient steps are taken yet."""
        enough = len(self.replay) >= self.settings.batch_size
        return enough and self.frames >= self.settings.learning_starts

    @abstractmethod
    def explore(self, progress: float) -> dict[str, float]:
        """Set the exploration of the next rollout; values for the log."""

    @abstractmethod
    def learn(self, batch: Minibatch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """A gradient step: |errors| [batch], detached, and values for the log."""

    def iterate(self, progress: float) -> dict[str, float]:
        """Collect one rollout into the buffer, and take `gradient_steps` from it."""
        settings = self.settings
        self.set_schedules(progress)
        figures = self.explore(progress)
        if settings.prioritized:  # Schaul et al. (2016), section 3.4
            ends = settings.importance_exponent, settings.importance_exponent_end
            self.beta = linear(*ends, progress)
        self.store(self.collector.rollout())
        if not self.learning:
            return figures
        logged: list[dict[str, torch.Tensor]] = []
        for _ in range(settings.gradient_steps):
            batch = self.sample()
            error, values = self.learn(batch)
            if settings.prioritized:
                self.replay.update(batch["index"], error)
            logged.append(values)
        return {**figures, **means(logged)}

    def sample(self) -> Columns:
        """A minibatch from the buffer, on the device of the networks."""
        batch = self.replay.draw(self.settings.batch_size, self.beta)
        return {name: column.to(self.device) for name, column in batch.items()}

    def store(self, rollout: Columns) -> None:
        """Add the n-step transitions of a rollout [games, steps] to the buffer."""
        self.frames += rollout["reward"].numel()
        self.replay.extend(n_step_rows(rollout, self.settings.gamma, self.settings.n_steps))

    def state_dict(self) -> StateDict:
        """The state, with the replay buffer and its priorities."""
        return super().state_dict() | self.replay.state_dict()

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        self.replay.load_state_dict(state)
