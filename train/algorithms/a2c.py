"""Advantage actor-critic (A2C), and REINFORCE on whole episodes: PPO's update without clipping."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, ClassVar, cast

import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.collector import EXPERT
from train.algorithms.fused_rollouts import FusedEngine, fused_engine
from train.algorithms.learner import expert_in, no_actions
from train.algorithms.ppo import PPO
from train.algorithms.rollouts import Frames, TorchEngine
from train.networks.fused_actor_critic import LossCoefficients
from train.tensors import StateDict


class A2C(PPO):
    """Mnih et al. (2016), synchronous: PPO with one gradient step on every rollout, not clipped.

    Args:
        settings: the hyperparameters. Without `gae` the advantages are discounted returns minus the
            value (lambda is 1). Without `critic` values are 0 and lambda is 1 as well.
        env, network, device, fused: as of `PPO`.
    """

    COUNTERS: ClassVar[tuple[str, ...]] = ("frames",)

    def coefficients(self, progress: float) -> LossCoefficients:
        """Those of PPO, without clipping."""
        return super().coefficients(progress)._replace(clip=math.inf)

    def minibatches(self, frames: Frames) -> Iterator[Frames]:
        """All frames, in their order."""
        yield frames


class Reinforce(A2C):
    """Williams (1992): every iteration plays one whole episode in every game.

    The gradient is that of Monte Carlo returns minus a learned baseline, in one step on all frames
    of the episodes. A truncated episode is bootstrapped by the value. Without `baseline` its return
    is the sum over the steps played.

    Args:
        settings: the hyperparameters.
        env, network, device: as of `PPO`.
        fused: whether the fused engine is used: with a baseline, and where `PPO` uses it.
    """

    def _choose_engine(self, fused: bool) -> FusedEngine | TorchEngine:
        engine = None
        if fused and self.ppo.critic and expert_in(self.env) is None:
            engine = fused_engine(self.env, self.network, 1, self.device)
        return engine or super()._choose_engine(fused=False)

    @torch.no_grad()
    def collect(self) -> Frames:
        """One episode in every game, as a sequence of frames.

        Returns:
            "observation", the drawn value ("action", or "drawn" before tanh), "value" [frames],
            "value_target" [frames], the discounted return from that frame on, and "advantage"
            [frames]; "action_mask" [frames, actions] where actions are masked.
        """
        env, baseline = self.env, self.ppo.critic
        now = env.reset()
        running = torch.arange(env.num_games)
        steps: list[Frames] = []
        played: list[tuple[torch.Tensor, torch.Tensor]] = []
        returns = torch.zeros(env.num_games)
        actions = no_actions(env)
        self.engine.start()
        while len(running):
            names = [name for name in ("observation", ACTION_MASK) if name in now.keys()]  # noqa: SIM118 (of a TensorDict)
            seen = {name: now[name][running].to(self.device) for name in names}
            steps.append({**seen, **self.engine.act(seen)})
            if expert_in(env) is not None:
                steps[-1][EXPERT] = cast(Any, env).expert_probabilities()[running].to(self.device)
            actions[running] = steps[-1]["action"].cpu()
            now = env.step_episodes(actions, running)
            played.append((running, now["reward"][running, 0]))
            done = now["done"][running, 0]
            if not done.any():
                continue
            cut = running[now["truncated"][running, 0] & ~now["terminated"][running, 0]]
            if len(cut) and baseline:
                observation = now["observation"][cut].to(self.device)
                returns[cut] = self.network(observation)[1].squeeze(-1).cpu()
            running = running[~done]
        targets: list[torch.Tensor] = []
        for games, reward in reversed(played):
            returns[games] = reward + self.gamma * returns[games]
            targets.append(returns[games].to(self.device))
        frames = {name: torch.cat([step[name] for step in steps]) for name in steps[0]}
        target = frames["value_target"] = torch.cat(targets[::-1])
        frames["advantage"] = target - frames["value"] if baseline else target
        self.frames += len(target)
        return frames

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state; the next episodes are new ones."""
        super().load_state_dict(state)
        self.env.resume = False
