"""Neural fictitious self-play."""

from __future__ import annotations

from typing import ClassVar

import torch

from pursuit.observations.masks import ACTION_MASK
from pursuit.simulator.policy import Policy
from train.algorithms.collector import Columns
from train.algorithms.dqn import DQN
from train.algorithms.learner import Build, HasState, VecEnv
from train.algorithms.replay import Minibatch, ReplayBuffer
from train.networks.distributions import Categorical
from train.settings.off_policy import NFSPSettings
from train.tensors import StateDict


class NFSP(DQN):
    """Heinrich and Silver (2016), "Deep reinforcement learning from self-play in
    imperfect-information games".

    DQN learns a best response to the opponent. A second network is fitted to the actions of all
    best responses so far, by supervised learning from a reservoir: the average policy, which is the
    policy of this learner. Each episode is played by the best response with the probability
    `anticipatory`, otherwise by the average policy. Different from the paper: the opponent plays
    its average policy alone, as in fictitious play, instead of the same mixture.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        options: of this machine.

    Attributes:
        average_network: the average policy; its outputs are logits.
        reservoir: observations and actions of best responses.
        responding: [games] bool, which games are played by the best response.
    """

    COPIES: ClassVar[tuple[str, ...]] = ()
    NO_DISTRIBUTION: ClassVar[str] = ""
    settings: NFSPSettings

    def __init__(self, settings: NFSPSettings, env: VecEnv, options: Build) -> None:
        super().__init__(settings, env, options)
        self.average_network = self.network_of(settings, env.player, options)
        weights, rate = self.average_network.parameters(), settings.average_learning_rate
        self.average_optimizer = self.new_optimizer(weights, rate)
        self.reservoir = Reservoir(settings.reservoir_size, self.generator)
        games = env.rows
        self.responding = torch.zeros(games, dtype=torch.bool, device=options.device)

    def act(self, seen: Columns, state: torch.Tensor) -> tuple[Columns, torch.Tensor]:
        """Actions of the best response or of the average policy, chosen for whole episodes."""
        chosen, state = super().act(seen, state)
        drawn = torch.rand(self.responding.shape, device=self.device) < self.settings.anticipatory
        self.responding = torch.where(seen["episode_start"], drawn, self.responding)
        logits = self.average_network.forward_inference(seen["observation"])
        average = Categorical(logits, seen.get(ACTION_MASK)).draw()
        action = torch.where(self.responding, chosen["action"], average)
        return {"action": action, "responding": self.responding}, state

    def store(self, rollout: Columns) -> None:
        """Add the transitions to the replay buffer, and best responses to the reservoir."""
        super().store(rollout)
        responding = rollout["responding"]
        names = ["observation", "action", *([ACTION_MASK] if self.masks else [])]
        self.reservoir.extend({name: rollout[name][responding].cpu() for name in names})

    def learn(self, batch: Minibatch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """A gradient step of the best response, and one of the average policy."""
        error, figures = super().learn(batch)
        if len(self.reservoir) >= self.settings.batch_size:
            figures["loss_average"] = self.fit_average()
        return error, figures

    def fit_average(self) -> torch.Tensor:
        """A gradient step of the average policy; the mean of -log policy(action), detached."""
        drawn = self.reservoir.draw(self.settings.batch_size)
        batch = {name: column.to(self.device) for name, column in drawn.items()}
        logits = self.average_network.forward_inference(batch["observation"])
        loss = -Categorical(logits, batch.get(ACTION_MASK)).log_prob(batch["action"]).mean()
        self.descend(loss, self.average_optimizer)
        return loss.detach()

    def policy(self, greedy: bool = True) -> Policy:
        """The average policy."""
        return self.env.player.policy(self.average_network, greedy)

    def parts(self) -> dict[str, HasState]:
        """As of DQN; "network" is the average policy, which snapshots keep."""
        return {
            **super().parts(),
            "network": self.average_network,
            "response": self.network,
            "average_optimizer": self.average_optimizer,
            "reservoir": self.reservoir,
            "memory": self.collector,
        }

    def state_dict(self) -> StateDict:
        """The state, with the games of the best response."""
        return super().state_dict() | {"responding": self.responding.cpu()}

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        self.responding = state["responding"].to(self.device)


class Reservoir(ReplayBuffer):
    """A buffer with a uniform sample of all rows so far (Vitter, 1985, algorithm R).

    Attributes:
        cursor: the number of rows so far.
    """

    def extend(self, rows: Minibatch) -> None:
        """Offer rows [n, ...]: row number t, counted from 0, replaces a random one of the kept rows
        with the probability capacity / (t + 1)."""
        count = len(next(iter(rows.values())))
        if not self._places:
            self._lay_out(rows)
        number = self.cursor + torch.arange(count)
        late = number >= self.capacity
        chosen = torch.rand(int(late.sum()), dtype=torch.float64, generator=self.generator)
        number[late] = (chosen * (number[late] + 1)).long()
        kept = number < self.capacity
        place = number[kept].numpy()
        for name, column in self._split(self._memory).items():
            column.numpy()[place] = rows[name][kept].numpy()  # of equal places the last one is kept
        self.cursor += count
        self._filled = min(self.cursor, self.capacity)
