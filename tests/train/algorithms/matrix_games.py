"""Matrix games for the learners of self-play: an environment of one step, and exploitability."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from train.algorithms.registry import Build, entry
from train.environments.hooks import EpisodeHook
from train.networks.features import Features


class MatrixPlayer:
    """A player of a matrix game, which observes a constant."""

    features = Features("flat", (1,), np.ones(1))
    continuous, has_masks, members = False, False, 1
    critic_features = observed = None

    def __init__(self, num_actions: int) -> None:
        self.num_actions = num_actions

    def policy(self, network: Any, greedy: bool = True) -> NDArray[np.float64]:
        """[actions]: the action probabilities."""
        with torch.no_grad():
            logits = network.logits(torch.ones(1, 1))[0].double()
        assert not greedy
        return logits.softmax(-1).numpy()


class MatrixEnv:
    """Simultaneous games of one step against `opponent`, the probabilities of its actions."""

    hook, resume, opponent = EpisodeHook(), False, np.zeros(0)

    def __init__(self, payoff: NDArray[np.float64], num_games: int) -> None:
        self.payoff = torch.tensor(payoff, dtype=torch.float32)
        self.num_games = self.rows = num_games
        self.player = MatrixPlayer(len(payoff))

    def reset(self) -> TensorDict:
        return TensorDict({"observation": torch.ones(self.num_games, 1)}, [self.num_games])

    def step_and_maybe_reset(self, now: TensorDict) -> tuple[TensorDict, TensorDict]:
        chances = torch.tensor(self.opponent)
        other = torch.multinomial(chances, self.num_games, replacement=True)
        ended = torch.ones(self.num_games, 1, dtype=torch.bool)
        reward = self.payoff[now["action"], other][:, None]
        flags = {"terminated": ended, "truncated": ~ended, "done": ended}
        after = self.reset().update({"reward": reward, **flags})
        return TensorDict({"next": after}, [self.num_games]), self.reset()


def play(
    name: str,
    payoff: NDArray[np.float64],
    iterations: int,
    games: int = 256,
    seed: int = 0,
    **settings: Any,
) -> NDArray[np.float64]:
    """[iterations, 2, actions]: the policies of two learners of an algorithm in self-play.

    Args:
        payoff: [actions, actions] of the first player, who maximises; zero-sum.
    """
    torch.manual_seed(seed)
    algorithm = entry(name)
    envs = MatrixEnv(payoff, games), MatrixEnv(-payoff.T, games)
    hyper = algorithm.settings(**{"num_games": games, "width": 16, "rollout_steps": 1, **settings})
    learners: Any = [
        algorithm.build(hyper, env, Build(seed=seed + number))  # type: ignore[arg-type]
        for number, env in enumerate(envs)
    ]
    found = []
    for iteration in range(iterations):
        policies = [learner.policy(greedy=False) for learner in learners]
        found.append(policies)
        for number, learner in enumerate(learners):
            envs[number].opponent = policies[1 - number]
            learner.iterate(iteration / iterations)
    return np.array(found)


def exploitability(payoff: NDArray[np.float64], policies: NDArray[np.float64]) -> float:
    """The mean gain of both players from best responses: half of NashConv."""
    one, two = policies
    return float((payoff @ two).max() - (one @ payoff).min()) / 2
