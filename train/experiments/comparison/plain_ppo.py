"""PPO in one file, as CleanRL's single-file implementation is described.

Written anew from the text of Huang et al. (2022), "The 37 Implementation Details of Proximal Policy
Optimization", and Huang et al. (2022), "CleanRL" (JMLR 23), whose thirteen core details it keeps:
games in lockstep, orthogonal weights and biases of 0, Adam with an epsilon of 1e-5, an annealed
learning rate, generalised advantages, shuffled minibatches, advantages standardised in each, the
clipped objective, a clipped value loss, an entropy bonus, clipped gradients, separate networks.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from pursuit.environments.single_agent import SingleAgentVectorEnv
from train.settings.algorithms import PPOSettings


def layer(inputs: int, outputs: int, gain: float) -> nn.Linear:
    """A linear layer with orthogonal weights of this gain and biases of 0."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


def perceptron(inputs: int, outputs: int, settings: PPOSettings, gain: float) -> nn.Sequential:
    """Two hidden layers and an output layer of this gain."""
    between = nn.Tanh if settings.activation == "tanh" else nn.ReLU
    return nn.Sequential(
        layer(inputs, settings.width, math.sqrt(2)),
        between(),
        layer(settings.width, settings.width, math.sqrt(2)),
        between(),
        layer(settings.width, outputs, gain),
    )


def advantages_of(
    rewards: torch.Tensor,
    values: torch.Tensor,
    ended: torch.Tensor,
    last: torch.Tensor,
    settings: PPOSettings,
) -> torch.Tensor:
    """Generalised advantages (Schulman et al., 2016), [steps, games].

    Args:
        rewards, values: [steps, games] float32, of each step and before it.
        ended: [steps, games] float32, 1 where that step ended the episode.
        last: [games] the values after the last step.
        settings: with `gamma` and `gae_lambda`.
    """
    found, following = torch.zeros_like(rewards), torch.zeros_like(last)
    for step in reversed(range(len(rewards))):
        goes_on = 1.0 - ended[step]
        error = rewards[step] + settings.gamma * last * goes_on - values[step]
        following = error + settings.gamma * settings.gae_lambda * goes_on * following
        found[step], last = following, values[step]
    return found


class ActorCritic(nn.Module):
    """A policy and a value, each a network of its own."""

    def __init__(self, inputs: int, actions: int, settings: PPOSettings) -> None:
        super().__init__()
        self.actor = perceptron(inputs, actions, settings, 0.01)
        self.critic = perceptron(inputs, 1, settings, 1.0)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] from [..., inputs]."""
        found: torch.Tensor = self.actor(observation)
        return found

    def value(self, observation: torch.Tensor) -> torch.Tensor:
        """[...] from [..., inputs]."""
        found: torch.Tensor = self.critic(observation)
        return found.squeeze(-1)


class PlainPPO:
    """The learner over a vector environment whose games begin anew in the step that ends them.

    An episode that is cut off counts as ended, as in the description: its last value is taken as 0.
    (Our own learners bootstrap there.)

    Args:
        settings: the hyperparameters; `shared` and those of a KL penalty are not used.
        envs: with flat float32 observations.
        seed: of the games, the weights and the draws.

    Attributes:
        frames: environment steps, all games counted.
        network: what is learned.
    """

    def __init__(self, settings: PPOSettings, envs: SingleAgentVectorEnv, seed: int) -> None:
        torch.manual_seed(seed)
        self.settings, self.envs, self.frames = settings, envs, 0
        shape = envs.single_observation_space.shape
        assert shape is not None
        self.network = ActorCritic(math.prod(shape), envs.task.num_actions, settings)
        self.optimizer = torch.optim.Adam(
            self.network.parameters(), lr=settings.learning_rate, eps=1e-5
        )
        steps, games = settings.rollout_steps, settings.num_games
        self.observations = torch.zeros(steps, games, math.prod(shape))
        self.actions = torch.zeros(steps, games, dtype=torch.int64)
        self.log_probs, self.rewards, self.values, self.ended = torch.zeros(4, steps, games)
        self.now = self._flat(envs.reset(seed=seed)[0])

    def _flat(self, observations: NDArray[np.float32]) -> torch.Tensor:
        return torch.from_numpy(observations.reshape(len(observations), -1))

    def iterate(self, progress: float) -> None:
        """A rollout, and what is learned from it; `progress` in [0, 1] through the budget."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.learning_rate * (1.0 - progress)
        self._play()
        with torch.no_grad():
            last = self.network.value(self.now)
        advantages = advantages_of(self.rewards, self.values, self.ended, last, self.settings)
        columns = (self.observations, self.actions, self.log_probs, self.values, advantages)
        self._learn(*(column.flatten(0, 1) for column in columns))

    @torch.no_grad()
    def _play(self) -> None:
        for step in range(self.settings.rollout_steps):
            chances: Any = torch.distributions.Categorical(logits=self.network.logits(self.now))
            actions = chances.sample()
            self.observations[step], self.actions[step] = self.now, actions
            self.log_probs[step] = chances.log_prob(actions)
            self.values[step] = self.network.value(self.now)
            seen, rewards, terminated, truncated, _ = self.envs.step(actions.numpy())
            self.rewards[step] = torch.from_numpy(rewards)
            self.ended[step] = torch.from_numpy(terminated | truncated)
            self.now = self._flat(seen)
            self.frames += len(actions)

    def _learn(
        self,
        observations: torch.Tensor,
        actions: torch.Tensor,
        log_probs: torch.Tensor,
        values: torch.Tensor,
        advantages: torch.Tensor,
    ) -> None:
        settings, returns = self.settings, advantages + values
        for _ in range(settings.epochs):
            for chosen in torch.split(torch.randperm(len(actions)), settings.minibatch_size):
                chances: Any = torch.distributions.Categorical(
                    logits=self.network.logits(observations[chosen])
                )
                ratio = (chances.log_prob(actions[chosen]) - log_probs[chosen]).exp()
                gain = advantages[chosen]
                gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
                clipped = ratio.clamp(1.0 - settings.clip, 1.0 + settings.clip)
                objective = torch.minimum(ratio * gain, clipped * gain).mean()
                value, before = self.network.value(observations[chosen]), values[chosen]
                near = before + (value - before).clamp(-settings.clip, settings.clip)
                target = returns[chosen]
                errors = torch.maximum((value - target).square(), (near - target).square())
                loss = (
                    settings.value_coef * 0.5 * errors.mean()
                    - objective
                    - settings.entropy_coef * chances.entropy().mean()
                )
                self.optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.network.parameters(), settings.max_grad_norm)
                self.optimizer.step()
