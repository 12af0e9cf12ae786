"""A game that nobody plays well without a memory: what is seen first is asked for last."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from train.environments.hooks import EpisodeHook
from train.networks.features import Features

LENGTH = 4
"""Steps of an episode; the action of the last is paid for where it is the cue."""


class Rememberer:
    """Who plays: it sees (1, 0) or (0, 1) at first, and (0, 0) from then on."""

    features = Features("flat", (2,), np.ones(2))
    num_actions, members, continuous = 2, 1, False
    critic_features = observed = None
    has_masks = False

    def policy(self, network: Any, greedy: bool = True) -> Any:
        return network


class Cues(EnvBase):
    """A batch of such games, which end after `LENGTH` steps."""

    def __init__(self, num_games: int, seed: int = 0, truncated: bool = False) -> None:
        super().__init__(device="cpu", batch_size=[num_games])
        self.player, self.hook = Rememberer(), EpisodeHook()
        self.num_games = self.rows = num_games
        self.resume, self.cut = False, truncated
        each = (num_games, 1)
        seen = Bounded(0.0, 1.0, shape=(num_games, 2))
        self.observation_spec = Composite(observation=seen, shape=(num_games,))
        self.action_spec = Categorical(2, shape=(num_games,), dtype=torch.int64)
        self.reward_spec = Unbounded(each)
        flag = Binary(n=1, shape=each, dtype=torch.bool)
        names = ("done", "terminated", "truncated")
        self.full_done_spec = Composite({name: flag.clone() for name in names}, shape=(num_games,))
        self.generator = torch.Generator().manual_seed(seed)
        self.cue = torch.zeros(num_games, dtype=torch.int64)
        self.steps = torch.zeros(num_games, dtype=torch.int64)

    def seen(self) -> torch.Tensor:
        shown = torch.nn.functional.one_hot(self.cue, 2).float()
        return shown * (self.steps == 0)[:, None]

    def _reset(self, tensordict: Any = None, **_: Any) -> TensorDict:
        begun = tensordict is not None and tensordict.get("_reset", None) is not None
        again = tensordict["_reset"][:, 0] if begun else torch.ones(self.num_games).bool()
        drawn = torch.randint(2, (self.num_games,), generator=self.generator)
        self.cue = torch.where(again, drawn, self.cue)
        # Games are at different steps, so that episodes begin in the middle of rollouts.
        first = torch.arange(self.num_games) % LENGTH if not begun else torch.zeros(1).long()
        self.steps = torch.where(again, first.expand(self.num_games), self.steps)
        return TensorDict({"observation": self.seen()}, batch_size=self.batch_size)

    def _step(self, tensordict: Any) -> TensorDict:
        self.steps = self.steps + 1
        over = (self.steps >= LENGTH)[:, None]
        right = (tensordict["action"] == self.cue)[:, None]
        flags = {"done": over, "terminated": over, "truncated": torch.zeros_like(over)}
        if self.cut:
            flags = {"done": over, "terminated": torch.zeros_like(over), "truncated": over}
        content = {"observation": self.seen(), "reward": (over & right).float()}
        return TensorDict({**content, **flags}, batch_size=self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        pass
