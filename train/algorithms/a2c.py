"""Advantage actor-critic (A2C), and REINFORCE on whole episodes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.advantages import standardized
from train.algorithms.fused_rollouts import Frames
from train.algorithms.learner import Build, NetworkLearner, VecEnv, has_masks
from train.algorithms.rollouts import Figures, RolloutLearner, actor_critic_of
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import LossCoefficients, fused_actor_critic
from train.settings.algorithms import A2CSettings, ReinforceSettings


class A2C(RolloutLearner):
    """Mnih et al. (2016), synchronous: one gradient step for each rollout.

    Args:
        settings: the hyperparameters. Without `gae` the advantages are discounted returns minus the
            value (lambda is 1). Without `critic` values are 0 and lambda is 1 as well.
        env: the training environment.
        network: policy and value.
        device: of the network.
        fused: whether the fused update is used where possible.
    """

    def __init__(
        self,
        settings: A2CSettings,
        env: VecEnv,
        network: ActorCritic,
        device: str = "cpu",
        fused: bool = True,
    ) -> None:
        super().__init__(
            settings,
            env,
            network,
            device,
            gae_lambda=settings.gae_lambda if settings.gae and settings.critic else 1.0,
            critic=settings.critic,
            fused=fused and type(self).loss is A2C.loss,
        )
        self.settings = settings

    def iterate(self, progress: float) -> dict[str, float]:
        """Collect one rollout and take one gradient step."""
        settings = self.settings
        self.set_schedules(progress)
        coefficients = LossCoefficients(
            math.inf,
            settings.value_coef if settings.critic else None,
            self.annealed(settings.entropy_coef, progress, settings.entropy_end),
            settings.standardize_advantages,
        )
        figures = self.update.set_gradients(self.collect(), coefficients)
        self.descend_by_gradients()
        logged = ("loss_objective", "loss_critic", "entropy")
        return {name: float(figures[name]) for name in logged if name in figures}

    def loss(
        self, minibatch: Frames, coefficients: LossCoefficients
    ) -> tuple[torch.Tensor, Figures]:
        """`a2c_loss`, which the torch update minimises; the fused one has kernels for it."""
        return a2c_loss(self.network, minibatch, coefficients)


def a2c_loss(
    network: ActorCritic, frames: Mapping[str, torch.Tensor], coefficients: LossCoefficients
) -> tuple[torch.Tensor, Figures]:
    """The policy gradient with value loss and entropy bonus, to be minimised.

    Equal to TorchRL's `A2CLoss` with squared value errors (tested). On standardised returns of
    whole episodes and their errors it is the loss of REINFORCE.

    Args:
        network: policy and value.
        frames: as in `ppo_loss`.
        coefficients: of the terms of the loss; `clip` is ignored.

    Returns:
        The loss, and its terms for the log, detached.
    """
    hidden, value_hidden, frames = network.forward_sequence(frames)
    output = network.policy_head(hidden)
    distribution = network.distribution(output, frames.get(ACTION_MASK, None))
    advantage = frames["advantage"]
    if coefficients.standardize:
        advantage = standardized(advantage)
    log_prob = distribution.log_prob(frames[distribution.DRAWN])
    entropy = distribution.entropy().mean()
    parts = {"loss_objective": -(log_prob * advantage).mean(), "entropy": entropy}
    total = parts["loss_objective"] - coefficients.entropy_coef * entropy
    if coefficients.value_coef is not None:
        error = network.value_head(value_hidden).squeeze(-1) - frames["value_target"]
        parts["loss_critic"] = coefficients.value_coef * error.square().mean()
        total = total + parts["loss_critic"]
    return total, {name: value.detach() for name, value in parts.items()}


class Reinforce(NetworkLearner):
    """Williams (1992): every iteration plays one whole episode in every game.

    The gradient is that of Monte Carlo returns minus a learned baseline, in one step on all frames
    of the episodes. A truncated episode is bootstrapped by the value. Without `baseline` its return
    is the sum over the steps played.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        network: policy and value.
        device: of the network.
        fused: whether fused kernels are used where possible: with a baseline, and where
            `RolloutLearner` uses them.
    """

    network: ActorCritic

    def __init__(
        self,
        settings: ReinforceSettings,
        env: VecEnv,
        network: ActorCritic,
        device: str = "cpu",
        fused: bool = True,
    ) -> None:
        super().__init__(settings, env, network, device)
        self.settings = settings
        fused = fused and settings.baseline and not has_masks(env)
        self._fused = fused_actor_critic(network, device) if fused else None

    @property
    def update_form(self) -> str:
        """The form of the update: "fused" or "torch"."""
        return "torch" if self._fused is None else "fused"

    def iterate(self, progress: float) -> dict[str, float]:
        """Play the episodes and take one gradient step on all their frames."""
        settings = self.settings
        self.set_schedules(progress)
        frames = self.play(settings.gamma_at(progress))
        self.frames += len(frames["value"])
        frames["advantage"] = frames["value_target"]
        if settings.baseline:
            frames["advantage"] = frames["value_target"] - frames["value"]
        coefficients = LossCoefficients(
            math.inf,
            settings.value_coef if settings.baseline else None,
            self.annealed(settings.entropy_coef, progress, settings.entropy_end),
        )
        if self._fused is None:
            loss, figures = a2c_loss(self.network, frames, coefficients)
            self.descend(loss)
        else:
            figures = self._fused.set_gradients(frames, coefficients)
            self.descend_by_gradients()
        logged = ("loss_objective", "loss_critic", "entropy")
        return {name: float(figures[name]) for name in logged if name in figures}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state; the next episodes are new ones."""
        super().load_state_dict(state)
        self.env.resume = False

    @torch.no_grad()
    def play(self, gamma: float) -> Frames:
        """One episode in every game, as a sequence of frames.

        Args:
            gamma: discount of a step.

        Returns:
            "observation", the drawn value ("action", or "drawn" before tanh), "value" [frames] and
            "value_target" [frames], the discounted return from that frame on; "action_mask"
            [frames, actions] where actions are masked.
        """
        env, network = self.env, self.network
        now, masks = env.reset(), has_masks(env)
        running = torch.arange(env.num_games)
        steps: list[Frames] = []
        played: list[tuple[torch.Tensor, torch.Tensor]] = []
        returns = torch.zeros(env.num_games)
        actions = env.action_spec.zero()
        while len(running):
            seen = {"observation": now["observation"][running].to(self.device)}
            if masks:
                seen[ACTION_MASK] = now[ACTION_MASK][running].to(self.device)
            if self._fused is not None:
                found = self._fused.draw(seen["observation"])
                names = ("action", "action_log_prob", "value")
                steps.append({**seen, **dict(zip(names, found, strict=True))})
                actions[running] = found.action
            else:
                output, value = network(seen["observation"])
                distribution = network.distribution(output, seen.get(ACTION_MASK))
                drawn = distribution.draw()
                steps.append({**seen, network.form.DRAWN: drawn, "value": value.squeeze(-1)})
                actions[running] = distribution.action(drawn).cpu()
            now = env.step_episodes(actions, running)
            played.append((running, now["reward"][running, 0]))
            done = now["done"][running, 0]
            if not done.any():
                continue
            cut = running[now["truncated"][running, 0] & ~now["terminated"][running, 0]]
            if len(cut) and self.settings.baseline:
                observation = now["observation"][cut].to(self.device)
                returns[cut] = network(observation)[1].squeeze(-1).cpu()
            running = running[~done]
        targets: list[torch.Tensor] = []
        for games, reward in reversed(played):
            returns[games] = reward + gamma * returns[games]
            targets.append(returns[games].to(self.device))
        frames = {name: torch.cat([step[name] for step in steps]) for name in steps[0]}
        frames["value_target"] = torch.cat(targets[::-1])
        return frames


def build_a2c(settings: A2CSettings, env: VecEnv, how: Build) -> A2C:
    """An A2C learner for an environment."""
    network = actor_critic_of(settings, env.player, how)
    return A2C(settings, env, network, how.device, how.fused)


def build_reinforce(settings: ReinforceSettings, env: VecEnv, how: Build) -> Reinforce:
    """A REINFORCE learner for an environment."""
    network = actor_critic_of(settings, env.player, how)
    return Reinforce(settings, env, network, how.device, how.fused)
