"""An algorithm with a loop and a network of its own, as those of other libraries."""

import torch
from torch import nn

from train.algorithms.learner import LearnedNetwork, network_loader
from train.algorithms.registry import Algorithm
from train.networks.flat import FlatInputs, FlatNetwork
from train.settings.algorithms import LibraryPPOSettings


class Linear(nn.Linear):
    def logits(self, observation):
        return self(observation)


def linear_of(settings, player, how):
    inputs = FlatInputs(player.features)
    return FlatNetwork(inputs, Linear(inputs.size, player.num_actions))


class Gradient(LearnedNetwork):
    """Policy gradient with the rewards of single steps."""

    def __init__(self, settings, env, how):
        super().__init__(env, linear_of(settings, env.player, how))
        self.settings = settings
        self.optimizer = torch.optim.SGD(self.network.parameters(), settings.learning_rate)
        self.now = torch.from_numpy(env.reset(seed=how.seed)[0])

    def iterate(self, progress):
        loss = torch.zeros(())
        for _ in range(self.settings.rollout_steps):
            policy = torch.distributions.Categorical(logits=self.network.network(self.now))
            actions = policy.sample()
            seen, rewards, *_ = self.env.step(actions.numpy())
            loss = loss - (policy.log_prob(actions) * torch.from_numpy(rewards)).mean()
            self.now, self.frames = torch.from_numpy(seen), self.frames + len(actions)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return {"loss": float(loss)}


GRADIENT = Algorithm(
    "gradient", LibraryPPOSettings, Gradient, network_loader(linear_of), own_loop=True
)
