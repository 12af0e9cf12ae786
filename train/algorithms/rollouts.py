"""Rollouts of fixed length with advantages, and gradients by torch, for PPO and A2C."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.advantages import advantages
from train.algorithms.collector import EXPERT, Collector, Columns
from train.algorithms.learner import Build, HasState, VecEnv, backward
from train.algorithms.table_rollouts import TableCollector, plays_by_tables
from train.networks.actor_critic import ActorCritic
from train.networks.distributions import DISTRIBUTION
from train.networks.features import Features
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.policy import CRITIC
from train.networks.seat import Seat
from train.settings.algorithms import ActorCriticSettings

Frames = dict[str, torch.Tensor]
"""Columns of training data. A row is a frame, or for a recurrent network a sequence;
`ActorCritic.forward_sequence` lists the columns."""
Figures = dict[str, torch.Tensor]
"""Values for the log."""
Loss = Callable[[Frames, LossCoefficients], tuple[torch.Tensor, Figures]]


def select(frames: Frames, chosen: torch.Tensor) -> Frames:
    """The rows `chosen` [n] int64 of all columns."""
    return {name: column.index_select(0, chosen) for name, column in frames.items()}


def actor_critic_of(
    settings: ActorCriticSettings, seat: Seat, build: Build, critic: Features | None = None
) -> ActorCritic:
    """A new actor-critic network for the seat; `critic` are the features of a central critic."""
    sizes = (seat.features, seat.num_actions, build.hidden(settings))
    action_std = settings.action_std if seat.continuous else None
    return ActorCritic(*sizes, settings.shared, action_std, critic).to(build.device)


class TorchEngine:
    """Collects rollouts, and computes gradients by autograd, for any network and environment.

    Args:
        env: the training environment.
        network: policy and value.
        steps: of every game in a rollout.
        device: of the network.
        loss: of a minibatch.
        critic: False sets all values to 0.
        keep_distribution: keep the parameters of the action distributions.

    Attributes:
        edit: changes the columns of a rollout before advantages are computed from them.
    """

    name = "torch"

    def __init__(
        self,
        env: VecEnv,
        network: ActorCritic,
        steps: int,
        device: str,
        loss: Loss,
        critic: bool = True,
        keep_distribution: bool = False,
    ) -> None:
        self.env, self.network, self.loss, self.critic = env, network, loss, critic
        self._weights = list(network.parameters())
        self.keep_distribution = keep_distribution
        self.edit: Callable[[Columns], Columns] = lambda rollout: rollout
        value = self._value if critic else None
        how = (env, self._step, steps, sum(network.sizes), device, value)
        keep = DISTRIBUTION if keep_distribution else None
        tables = plays_by_tables(env, network, steps, device)
        self.collector = TableCollector(self._evaluate, keep, *how) if tables else Collector(*how)

    def start(self) -> None:
        """Called before the first `act` of a rollout."""

    def act(self, seen: Columns) -> Columns:
        """As `_step`, for a network without recurrence."""
        return self._step(seen, torch.empty(0))[0]

    def _step(self, seen: Columns, state: torch.Tensor) -> tuple[Columns, torch.Tensor]:
        """Drawn actions with the columns that learning needs, and the next states."""
        output, value, state = self.network.step(seen["observation"], state, seen.get(CRITIC))
        distribution = self.network.distribution(output, seen.get(ACTION_MASK, None))
        drawn = distribution.draw()
        columns = {
            distribution.DRAWN: drawn,
            "action": distribution.action(drawn),
            "action_log_prob": distribution.log_prob(drawn),
            "value": value.squeeze(-1) if self.critic else torch.zeros_like(value.squeeze(-1)),
        }
        if self.keep_distribution:
            columns[DISTRIBUTION] = distribution.parameters
        return columns, state

    def _evaluate(
        self, observation: torch.Tensor, allowed: torch.Tensor | None
    ) -> tuple[Any, torch.Tensor]:
        """The action distribution and the value of every observation."""
        output, value = self.network(observation)
        return self.network.distribution(output, allowed), value.squeeze(-1)

    def _value(self, seen: Columns, state: torch.Tensor) -> torch.Tensor:
        return self.network.step(seen["observation"], state, seen.get(CRITIC))[1].squeeze(-1)

    def collect(self, gamma: float, gae_lambda: float) -> Frames:
        """A rollout with its advantages: frames, or for a recurrent network one sequence for every
        game, as the input of `ActorCritic.forward_sequence`."""
        rollout = self.edit(self.collector.rollout())
        if not self.critic:
            rollout["value_after"] = torch.zeros_like(rollout["value"])
        rollout["advantage"], rollout["value_target"] = advantages(rollout, gamma, gae_lambda)
        if self.env.hook.wants_advantages:
            noted = (rollout["advantage"], rollout["done"])
            self.env.hook.note_advantages(*(column.cpu().numpy() for column in noted))
        names = [self.network.form.DRAWN, "action_log_prob", "advantage", "value_target"]
        names += [name for name in (DISTRIBUTION, ACTION_MASK, EXPERT) if name in rollout]
        inputs = {"prepared": (self.network.policy_trunk, rollout["observation"])}
        if CRITIC in rollout:
            inputs["critic_prepared"] = (self.network.value_trunk, rollout[CRITIC])
        idle = rollout["idle"].squeeze(-1) if "idle" in rollout else None
        if self.network.policy_memory is not None:
            frames = {name: rollout[name] for name in (*names, "episode_start")}
            frames |= {name: trunk.prepare(seen) for name, (trunk, seen) in inputs.items()}
            frames["state"] = self.collector.states[0]
            return frames if idle is None else frames | {"loss_mask": ~idle}
        frames = {name: rollout[name].flatten(0, 1) for name in names}
        for name, (trunk, seen) in inputs.items():
            frames[name] = trunk.prepare(seen.flatten(0, 1))
        if idle is None:
            return frames
        return {name: column[~idle.flatten()] for name, column in frames.items()}

    def set_gradients(self, minibatch: Frames, coefficients: LossCoefficients) -> Figures:
        """Writes the gradients of the loss to `grad` of all weights; returns values for the log."""
        for weight in self._weights:
            weight.grad = None
        loss, figures = self.loss(minibatch, coefficients)
        backward(loss)
        return figures

    def parts(self) -> dict[str, HasState]:
        """The recurrent states of the games, if there are any."""
        return {} if self.network.policy_memory is None else {"memory": self.collector}
