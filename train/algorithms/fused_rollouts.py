"""The fused engine: rollouts and gradients of an `ActorCritic` by kernels on the CPU."""

from __future__ import annotations

from typing import cast

import torch

from train.algorithms.advantages import fused_advantages
from train.algorithms.collector import Seen
from train.algorithms.learner import HasState, VecEnv, has_masks, steps_tensors
from train.algorithms.rollouts import Figures, Frames, select
from train.environments.batch_env import BatchEnv
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import FusedActorCritic, LossCoefficients, fused_actor_critic


class FusedEngine:
    """Collects and computes gradients as `TorchEngine`; each rollout continues the last one.

    Each agent of a team has its own rows; frames of idle agents are dropped.

    Args:
        env: the training environment.
        network: chooses the actions.
        steps: of every game in a rollout.
    """

    name = "fused"

    def __init__(self, env: BatchEnv, network: FusedActorCritic, steps: int) -> None:
        self.env, self.network, self.steps = env, network, steps
        self._now: Seen | None = None

    def start(self) -> None:
        """Called before the first `act` of a rollout: the weights are fixed until its end."""
        self.network.cast_weights()

    def act(self, seen: Frames) -> Frames:
        """Drawn actions, their log-probabilities, and the values."""
        return self.network.draw(seen["observation"])._asdict()

    @torch.no_grad()
    def collect(self, gamma: float, gae_lambda: float) -> Frames:
        """The frames of a rollout with their advantages, step by step."""
        now = self.env.reset() if self._now is None else self._now
        self.start()
        steps: list[Frames] = []
        for _ in range(self.steps):
            step, now = self._play(now)
            steps.append(step)
        self._now = now
        columns = {name: torch.stack([step.pop(name) for step in steps]) for name in [*steps[0]]}
        value = torch.cat([columns["value"], self.network.value(now["observation"])[None]])
        ended, cut = columns.pop("terminated"), columns.pop("truncated")
        advantage = torch.empty_like(columns["value"])
        discounts = torch.tensor([gamma, gamma * gae_lambda], dtype=torch.float64)
        arrays = (columns.pop("reward"), value, columns.pop("cut_value"), ended, cut, discounts)
        fused_advantages(*(tensor.numpy() for tensor in (*arrays, advantage)))
        if self.env.hook.wants_advantages:
            self.env.hook.note_advantages(advantage.T.numpy(), (ended | cut).T.numpy())
        columns |= {"advantage": advantage, "value_target": advantage + columns.pop("value")}
        frames = {name: column.flatten(0, 1) for name, column in columns.items()}
        idle = frames.pop("idle", None)
        if idle is None or not idle.any():
            return frames
        return select(frames, (~idle).nonzero().squeeze(-1))

    def _play(self, seen: Seen) -> tuple[Frames, Frames]:
        """The columns of a step of all games, and the observations for the next step."""
        observation = seen["observation"]
        drawn = self.network.draw(observation)
        step = {"observation": observation, **drawn._asdict()}
        if self.env.members > 1:
            step["idle"] = seen["idle"].squeeze(-1)
        after, following = self.env.step_tensors(drawn.action)
        step |= {name: after[name].squeeze(-1) for name in ("reward", "terminated", "truncated")}
        cut = step["truncated"] = step["truncated"] & ~step["terminated"]
        step["cut_value"] = torch.zeros_like(drawn.value)
        if cut.any():
            step["cut_value"][cut] = self.network.value(after["observation"][cut])
        return step, following

    def set_gradients(self, minibatch: Frames, coefficients: LossCoefficients) -> Figures:
        """Writes the gradients of the loss to `grad` of all weights; returns values for the log."""
        return self.network.set_gradients(minibatch, coefficients)

    def parts(self) -> dict[str, HasState]:
        """As of `TorchEngine`: no recurrent states."""
        return {}


def fused_engine(env: VecEnv, network: ActorCritic, steps: int, device: str) -> FusedEngine | None:
    """The fused engine; None if its kernels do not support the network (`fused_actor_critic`) or
    the environment, which must be a `BatchEnv` without masks."""
    if not steps_tensors(env) or has_masks(env):
        return None
    fused = fused_actor_critic(network, device)
    return None if fused is None else FusedEngine(cast(BatchEnv, env), fused, steps)
