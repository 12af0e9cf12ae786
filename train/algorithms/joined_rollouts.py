"""Rollouts of a joined policy and value, in arrays that are made once; on the CPU."""

from __future__ import annotations

from typing import Any

import torch

from train.algorithms.advantages import advantages
from train.algorithms.learner import has_masks
from train.environments.lockstep import LockstepEnv
from train.networks.joined_actor_critic import JoinedActorCritic, Learned


def plays_joined(env: Any) -> bool:
    """Whether games are of the kind that is collected from here: on the CPU, without masks."""
    return isinstance(env, LockstepEnv) and not has_masks(env)


class JoinedRollouts:
    """Plays on from where the last rollout ended, for ever.

    Teams are rows of their own; what a member records that waits for the others is left out.

    Args:
        env: the games, such as `plays_joined`.
        network: chooses the actions.
        steps: of every game in a rollout.
        gamma: discount of a step, to begin with.
        gae_lambda: of the advantages.

    Attributes:
        played: frames of a rollout, those of who waits among them.
    """

    def __init__(
        self,
        env: Any,
        network: JoinedActorCritic,
        steps: int,
        gamma: float,
        gae_lambda: float,
    ) -> None:
        self.env, self.network, self.steps = env, network, steps
        self.gae_lambda, self.discounts = gae_lambda, torch.empty(2, dtype=torch.float64)
        self.set_discount(gamma)
        self._now: Any = None
        seen, (rows,) = env.observation_spec["observation"], env.batch_size
        shape, self.played = (steps, rows), steps * rows
        self._observation = torch.empty(steps, *seen.shape, dtype=seen.dtype)
        self._action = torch.empty(shape, dtype=torch.int64)
        self._log_prob, self._reward = torch.empty(2, *shape)
        self._value = torch.empty(steps + 1, rows)
        self._cut_value = torch.empty(shape)
        self._ended, self._cut = torch.empty(2, *shape, dtype=torch.bool)
        self._counts = torch.ones(shape, dtype=torch.bool)

    def set_discount(self, gamma: float) -> None:
        """That of the next rollouts."""
        self.discounts[0], self.discounts[1] = gamma, gamma * self.gae_lambda

    @torch.no_grad()
    def rollout(self) -> Learned:
        """The next one: its frames in a row, step by step. The next rollout overwrites them."""
        if self._now is None:
            self._now = self.env.reset()
        for step in range(self.steps):
            self._play(step)
        self._value[self.steps] = self.network.value(self._now["observation"])
        advantage = torch.empty_like(self._reward)
        known = (self._reward, self._value, self._cut_value, self._ended, self._cut)
        given = (*known, self.discounts, advantage)
        advantages(*(tensor.numpy() for tensor in given))
        if self.env.hook.wants_advantages:
            done = (self._ended | self._cut).T.numpy()
            self.env.hook.note_advantages(advantage.T.numpy(), done)
        target = advantage + self._value[:-1]
        columns = (self._action, self._log_prob, advantage, target)
        found = (self._observation.flatten(0, 1), *(column.flatten() for column in columns))
        if self._counts.all():
            return Learned(*found)
        return Learned(*found).at(self._counts.flatten().nonzero().squeeze(-1))

    def _play(self, step: int) -> None:
        observation = self._now["observation"]
        drawn = self.network.draw(observation)
        self._observation[step] = observation
        if self.env.members > 1:
            self._counts[step] = ~self._now["idle"].squeeze(-1)
        self._action[step], self._log_prob[step], self._value[step] = drawn
        after, self._now = self.env.step_tensors(drawn.action)
        self._reward[step] = after["reward"].squeeze(-1)
        self._ended[step] = after["terminated"].squeeze(-1)
        cut = after["truncated"].squeeze(-1) & ~self._ended[step]
        self._cut[step] = cut
        if cut.any():
            self._cut_value[step, cut] = self.network.value(after["observation"][cut])

    def shutdown(self) -> None:
        """Nothing is held open."""
