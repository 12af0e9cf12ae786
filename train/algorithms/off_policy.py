"""The base class of off-policy learners, with the replay buffer and the update loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch

from curricula import linear
from train.algorithms.collector import Collector, Columns
from train.algorithms.learner import NetworkLearner, VecEnv, has_masks, means
from train.algorithms.prioritized import Priorities
from train.algorithms.replay import Batch, Replay, n_step_rows
from train.networks.policy import Network
from train.settings.off_policy import ReplaySettings


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

    def __init__(
        self,
        settings: ReplaySettings,
        env: VecEnv,
        network: Network,
        collector: Collector,
        device: str,
        seed: int,
    ) -> None:
        super().__init__(settings, env, network, device)
        self.replayed, self.updates = settings, 0
        self.masks, self.collector = has_masks(env), collector
        self.beta, exponent = settings.importance_exponent, settings.priority_exponent
        priorities = Priorities(settings.buffer_size, exponent) if settings.prioritized else None
        self.generator = torch.Generator().manual_seed(seed)
        self.replay = Replay(settings.buffer_size, self.generator, priorities)

    @property
    def learning(self) -> bool:
        """Whether gradient steps are taken yet."""
        enough = len(self.replay) >= self.replayed.batch_size
        return enough and self.frames >= self.replayed.learning_starts

    @abstractmethod
    def explore(self, progress: float) -> dict[str, float]:
        """Set the exploration of the next rollout; values for the log."""

    @abstractmethod
    def learn(self, batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """A gradient step: |errors| [batch], detached, and values for the log."""

    def iterate(self, progress: float) -> dict[str, float]:
        """Collect one rollout into the buffer, and take `gradient_steps` from it."""
        settings = self.replayed
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
            error, found = self.learn(batch)
            if settings.prioritized:
                self.replay.update(batch["index"], error)
            logged.append(found)
        return {**figures, **means(logged)}

    def sample(self) -> Columns:
        """A minibatch from the buffer, on the device of the networks."""
        batch = self.replay.draw(self.replayed.batch_size, self.beta)
        if self.device == "cpu":
            return batch
        return {name: column.to(self.device) for name, column in batch.items()}

    def store(self, rollout: Columns) -> None:
        """Add the n-step transitions of a rollout [games, steps] to the buffer."""
        self.frames += rollout["reward"].numel()
        self.replay.extend(n_step_rows(rollout, self.replayed.gamma, self.replayed.n_steps))

    def state_dict(self) -> dict[str, Any]:
        """The state, with the replay buffer and its priorities."""
        return super().state_dict() | {"updates": self.updates} | self.replay.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        self.updates = state["updates"]
        self.replay.load_state_dict(state)
