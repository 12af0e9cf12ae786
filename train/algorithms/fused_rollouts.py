"""The fused update: rollouts and gradients of an `ActorCritic` by kernels on the CPU, in
preallocated arrays."""

from __future__ import annotations

from typing import Any

import torch

from train.algorithms.advantages import fused_advantages
from train.algorithms.learner import has_masks
from train.environments.lockstep import LockstepEnv
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import (
    FusedActorCritic,
    LossCoefficients,
    fused_actor_critic,
)

Frames = dict[str, torch.Tensor]
"""Columns of training data. A row is a frame, or for a recurrent network a sequence;
`ActorCritic.forward_sequence` lists the columns."""


class FusedUpdate:
    """Collects and computes gradients as `TorchUpdate`; each rollout continues the last one.

    Each agent of a team has its own rows; frames of idle agents are dropped.

    Args:
        env: the training environment.
        network: chooses the actions.
        steps: of every game in a rollout.
    """

    name = "fused"

    def __init__(self, env: Any, network: FusedActorCritic, steps: int) -> None:
        self.env, self.network, self.steps = env, network, steps
        self._now: Any = None
        seen, (rows,) = env.observation_spec["observation"], env.batch_size
        shape = (steps, rows)
        self._observation = torch.empty(steps, *seen.shape, dtype=seen.dtype)
        self._action = torch.empty(shape, dtype=torch.int64)
        self._log_prob, self._reward = torch.empty(2, *shape)
        self._value = torch.empty(steps + 1, rows)
        self._cut_value = torch.empty(shape)
        self._ended, self._cut = torch.empty(2, *shape, dtype=torch.bool)
        self._counted = torch.ones(shape, dtype=torch.bool)

    @torch.no_grad()
    def collect(self, gamma: float, gae_lambda: float) -> Frames:
        """The frames of a rollout, step by step. The next rollout overwrites them."""
        if self._now is None:
            self._now = self.env.reset()
        for step in range(self.steps):
            self._play(step)
        self._value[self.steps] = self.network.value(self._now["observation"])
        advantage = torch.empty_like(self._reward)
        discounts = torch.tensor([gamma, gamma * gae_lambda], dtype=torch.float64)
        known = (self._reward, self._value, self._cut_value, self._ended, self._cut)
        fused_advantages(*(tensor.numpy() for tensor in (*known, discounts, advantage)))
        if self.env.hook.wants_advantages:
            done = (self._ended | self._cut).T.numpy()
            self.env.hook.note_advantages(advantage.T.numpy(), done)
        columns = {
            "observation": self._observation,
            "action": self._action,
            "action_log_prob": self._log_prob,
            "advantage": advantage,
            "value_target": advantage + self._value[:-1],
        }
        frames = {name: column.flatten(0, 1) for name, column in columns.items()}
        if self._counted.all():
            return frames
        return select(frames, self._counted.flatten().nonzero().squeeze(-1))

    def _play(self, step: int) -> None:
        observation = self._now["observation"]
        drawn = self.network.draw(observation)
        self._observation[step] = observation
        if self.env.members > 1:
            self._counted[step] = ~self._now["idle"].squeeze(-1)
        self._action[step], self._log_prob[step], self._value[step] = drawn
        after, self._now = self.env.step_tensors(drawn.action)
        self._reward[step] = after["reward"].squeeze(-1)
        self._ended[step] = after["terminated"].squeeze(-1)
        cut = after["truncated"].squeeze(-1) & ~self._ended[step]
        self._cut[step] = cut
        if cut.any():
            self._cut_value[step, cut] = self.network.value(after["observation"][cut])

    def set_gradients(
        self, minibatch: Frames, coefficients: LossCoefficients
    ) -> dict[str, torch.Tensor]:
        """Writes the gradients of the loss to `grad` of all weights; returns values for the log."""
        return self.network.set_gradients(minibatch, coefficients)


def fused_update(env: Any, network: ActorCritic, steps: int, device: str) -> FusedUpdate | None:
    """The fused update; None if its kernels do not support the network (`fused_actor_critic`) or
    the environment, which must be a `LockstepEnv` without masks."""
    if not isinstance(env, LockstepEnv) or has_masks(env):
        return None
    fused = fused_actor_critic(network, device)
    return None if fused is None else FusedUpdate(env, fused, steps)


def select(frames: Frames, chosen: torch.Tensor) -> Frames:
    """The rows `chosen` [n] int64 of all columns."""
    return {name: column.index_select(0, chosen) for name, column in frames.items()}
