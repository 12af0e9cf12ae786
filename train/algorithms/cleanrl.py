"""PPO in the form of CleanRL's single file, with a loop of its own.

CleanRL is a set of scripts and no package, so its loop is written here from its description: Huang
et al. (2022), "The 37 Implementation Details of Proximal Policy Optimization", the thirteen core
details. These are games in lockstep, orthogonal weights, Adam with an epsilon of 1e-5, an annealed
learning rate, generalised advantages, shuffled minibatches, advantages that are standardised in
each, the clipped objective, a clipped value loss, an entropy bonus, clipped gradients, and separate
networks for policy and value.
"""

from __future__ import annotations

import math
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.distributions import Categorical

from train.algorithms.learner import Build, LearnedNetwork, means
from train.environments.vector_env import LearnerVectorEnv
from train.networks.flat import FlatInputs, FlatNetwork
from train.networks.seat import Seat
from train.settings.algorithms import LibraryPPOSettings


def perceptron(
    inputs: int, outputs: int, settings: LibraryPPOSettings, gain: float
) -> nn.Sequential:
    """Two hidden layers and an output layer with orthogonal weights, and biases of 0."""
    between = nn.Tanh if settings.activation == "tanh" else nn.ReLU
    sizes = [inputs, settings.width, settings.width, outputs]
    layers: list[nn.Module] = []
    for place, scale in enumerate((math.sqrt(2.0), math.sqrt(2.0), gain)):
        linear = nn.Linear(sizes[place], sizes[place + 1])
        nn.init.orthogonal_(linear.weight, scale)
        nn.init.zeros_(linear.bias)
        layers += [linear, between()]
    return nn.Sequential(*layers[:-1])


class ActorCritic(nn.Module):
    """A policy and a value with separate networks of flat observations [..., inputs]."""

    def __init__(self, inputs: int, actions: int, settings: LibraryPPOSettings) -> None:
        super().__init__()
        self.actor = perceptron(inputs, actions, settings, 0.01)
        self.critic = perceptron(inputs, 1, settings, 1.0)

    def logits(self, observation: Tensor) -> Tensor:
        """[..., actions]."""
        return torch.as_tensor(self.actor(observation))

    def value(self, observation: Tensor) -> Tensor:
        """[...]."""
        return torch.as_tensor(self.critic(observation)).squeeze(-1)


def network_of(settings: LibraryPPOSettings, seat: Seat, build: Build) -> FlatNetwork:
    """A new network for the seat."""
    inputs = FlatInputs(seat.features)
    return FlatNetwork(inputs, ActorCritic(inputs.size, seat.num_actions, settings))


class CleanRLPPO(LearnedNetwork):
    """The learner.

    As in the description, a truncated episode counts as terminated: the value of its last state is
    0. Our own learners use its value there.

    Args:
        settings: the hyperparameters.
        env: the games.
        build: the seed of the games; weights and sampled actions are drawn from torch's generator.

    Attributes:
        model: what is learned.
        now: [games, inputs] the current observations.
    """

    def __init__(self, settings: LibraryPPOSettings, env: LearnerVectorEnv, build: Build) -> None:
        super().__init__(env, network_of(settings, env.player, build))
        self.settings, self.model = settings, cast(ActorCritic, self.network.network)
        self.optimizer = torch.optim.Adam(
            self.model.parameters(), lr=settings.learning_rate, eps=1e-5
        )
        self.now = torch.from_numpy(env.reset(seed=build.seed)[0])

    def iterate(self, progress: float) -> dict[str, float]:
        """A rollout and an update."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.learning_rate * (1.0 - progress)
        rows: list[tuple[Tensor, ...]] = []
        with torch.no_grad():
            for _ in range(self.settings.rollout_steps):
                policy = distribution(self.model.logits(self.now))
                drawn, value = policy.sample(), self.model.value(self.now)
                seen, reward, terminated, truncated, _ = self.env.step(drawn.numpy())
                given = torch.from_numpy(reward), torch.from_numpy(terminated | truncated).float()
                rows.append((self.now, drawn, policy.log_prob(drawn), value, *given))
                self.now = torch.from_numpy(seen)
                self.frames += len(drawn)
            last = self.model.value(self.now)
        columns = [torch.stack(column) for column in zip(*rows, strict=True)]
        observations, actions, log_probs, values, rewards, ended = columns
        settings, following = self.settings, torch.zeros_like(last)
        advantages = torch.zeros_like(values)
        for step in reversed(range(len(rewards))):  # Schulman et al. (2016)
            goes_on = 1.0 - ended[step]
            error = rewards[step] + settings.gamma * last * goes_on - values[step]
            following = error + settings.gamma * settings.gae_lambda * goes_on * following
            advantages[step], last = following, values[step]
        batch = (observations, actions, log_probs, values, advantages)
        return means(self._update([column.flatten(0, 1) for column in batch]))

    def _update(self, batch: list[Tensor]) -> list[dict[str, Tensor]]:
        settings, logged = self.settings, list[dict[str, Tensor]]()
        for _ in range(settings.epochs):
            for chosen in torch.split(torch.randperm(len(batch[0])), settings.minibatch_size):
                observation, actions, log_probs, values, advantages = (c[chosen] for c in batch)
                policy = distribution(self.model.logits(observation))
                ratio = (policy.log_prob(actions) - log_probs).exp()
                gain = (advantages - advantages.mean()) / (advantages.std(correction=0) + 1e-8)
                clipped = ratio.clamp(1.0 - settings.clip, 1.0 + settings.clip)
                objective = torch.minimum(ratio * gain, clipped * gain).mean()
                value, target = self.model.value(observation), advantages + values
                near = values + (value - values).clamp(-settings.clip, settings.clip)
                errors = torch.maximum((value - target).square(), (near - target).square())
                entropy = policy.entropy().mean()
                critic = 0.5 * settings.value_coef * errors.mean()
                loss = critic - objective - settings.entropy_coef * entropy
                self.optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.model.parameters(), settings.max_grad_norm)
                self.optimizer.step()
                terms = {"loss_objective": -objective, "loss_critic": critic, "entropy": entropy}
                logged.append({name: term.detach() for name, term in terms.items()})
        return logged


def distribution(logits: Tensor) -> Any:
    """The distribution of actions; torch's methods of it have no types."""
    return Categorical(logits=logits)
