"""What the learners that replay share: the buffer with its checkpoint, and rounds."""

from __future__ import annotations

from typing import Any

import torch

from curricula import linear
from train.algorithms.collector import Collector, Columns
from train.algorithms.learner import NetworkLearner, VecEnv, has_masks, means
from train.algorithms.prioritized import Priorities
from train.algorithms.replay import Batch, Replay, n_step_rows
from train.networks.policy import Network
from train.settings.off_policy import ReplaySettings


class OffPolicyLearner(NetworkLearner):
    """Rounds of a rollout into the replay buffer and `gradient_steps` from it.

    A learner says how it explores (`explore`) and what a gradient step is (`learn`).

    Args:
        settings: the hyperparameters.
        env: the games.
        network: what acts.
        collector: plays the games.
        device: where the networks live.
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
        """Whether there is enough in the buffer to learn from."""
        enough = len(self.replay) >= self.replayed.batch_size
        return enough and self.frames >= self.replayed.learning_starts

    def explore(self, progress: float) -> dict[str, float]:
        """Settle how the next rollout explores; figures for the log."""
        raise NotImplementedError

    def learn(self, batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """A gradient step: the sizes of errors [batch], detached, and figures for the log."""
        raise NotImplementedError

    def iterate(self, progress: float) -> dict[str, float]:
        """Play one rollout into the buffer, and take `gradient_steps` from it."""
        settings = self.replayed
        self.set_schedules(progress)
        figures = self.explore(progress)
        if settings.prioritized:  # Schaul et al. (2016), section 3.4
            ends = settings.importance_exponent, settings.importance_exponent_end
            self.beta = linear(*ends, progress)
        self.remember(self.collector.rollout())
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
        """A minibatch from the buffer, where the networks live."""
        batch = self.replay.draw(self.replayed.batch_size, self.beta)
        if self.device == "cpu":
            return batch
        return {name: column.to(self.device) for name, column in batch.items()}

    def remember(self, rollout: Columns) -> None:
        """Put the transitions of a rollout [games, steps] into the buffer, n steps in one."""
        self.frames += rollout["reward"].numel()
        self.replay.extend(n_step_rows(rollout, self.replayed.gamma, self.replayed.n_steps))

    def state_dict(self) -> dict[str, Any]:
        """Everything, the replay buffer and its priorities included."""
        return super().state_dict() | {"updates": self.updates} | self.replay.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take it all back."""
        super().load_state_dict(state)
        self.updates = state["updates"]
        self.replay.load_state_dict(state)
