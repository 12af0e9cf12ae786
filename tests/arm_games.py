"""Arms as a learner's games, and no more than that: what tests of learners need."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from train.environments.hooks import EpisodeHook
from train.networks.features import Features

FLAGS = ("terminated", "truncated", "done")


class ArmPlayer:
    """Who moves the arms."""

    continuous, members = True, 1

    def __init__(self, task: ReacherTask) -> None:
        self.num_actions = task.joints
        shape = (3 + 2 * task.joints,)
        self.features = Features("flat", shape, np.ones(shape))

    def policy(self, network: Any, greedy: bool = True) -> Any:
        def act(observation: torch.Tensor) -> torch.Tensor:
            noise = None if greedy else torch.randn(len(observation), self.num_actions)
            with torch.no_grad():
                return network.act(observation, noise)

        return act


class ArmGames(EnvBase):
    """A batch of arms; each begins anew as its episode ends."""

    def __init__(self, num_games: int, seed: int = 0, **task: Any) -> None:
        super().__init__(device="cpu", batch_size=[num_games])
        self.task = ReacherTask(**task)
        self.simulator = ReacherSimulator(self.task, num_games, seed, auto_restart=False)
        self.player, self.hook = ArmPlayer(self.task), EpisodeHook()
        self.num_games, self.resume = num_games, False
        size = (num_games, *self.player.features.shape)
        self.observation_spec = Composite(observation=Unbounded(size), shape=(num_games,))
        self.action_spec = Bounded(-1.0, 1.0, shape=(num_games, self.task.joints))
        self.reward_spec = Unbounded((num_games, 1))
        flag = Binary(n=1, shape=(num_games, 1), dtype=torch.bool)
        self.full_done_spec = Composite({name: flag.clone() for name in FLAGS}, shape=(num_games,))
        self.lengths: list[Any] = []

    def _content(self, **content: Any) -> TensorDict:
        seen = torch.from_numpy(self.simulator.observe("positions"))
        return TensorDict({"observation": seen, **content}, batch_size=self.batch_size)

    def _reset(self, tensordict: Any = None, **_: Any) -> TensorDict:
        if not self.resume:
            self.simulator.reset()
        self.resume = False
        return self._content()

    def _step(self, tensordict: Any) -> TensorDict:
        simulator = self.simulator
        simulator.step(tensordict["action"].numpy())
        flags = (simulator.terminated, simulator.truncated, simulator.ended)
        return self._content(
            reward=torch.from_numpy(simulator.rewards[:, None].copy()),
            **{
                name: torch.from_numpy(flag[:, None].copy())
                for name, flag in zip(FLAGS, flags, strict=True)
            },
        )

    def step_and_maybe_reset(self, tensordict: Any) -> tuple[Any, Any]:
        """What `EnvBase` does, with the games that are over begun anew."""
        tensordict["next"] = self._step(tensordict)
        over = tensordict["next", "done"].squeeze(-1).numpy()
        if over.any():
            self.lengths.append(self.simulator.steps[over].copy())
            self.simulator.reset(games=over)
        return tensordict, self._content()

    def _set_seed(self, seed: int | None) -> None:
        pass


def steps_of(policy: Any, num_games: int = 500, seed: int = 2**62, **task: Any) -> float:
    """Mean steps of an episode, one for each of `num_games` arms."""
    simulator = ReacherSimulator(ReacherTask(**task), num_games, seed, auto_restart=False)
    steps = np.zeros(num_games)
    running = np.ones(num_games, dtype=bool)
    while running.any():
        seen = torch.from_numpy(simulator.observe("positions"))
        simulator.step(policy(seen).double().numpy())
        steps[running] += 1
        running &= ~simulator.ended
    return float(steps.mean())
