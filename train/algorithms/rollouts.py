"""Rollouts of fixed length with advantages, for PPO and A2C."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.advantages import advantages
from train.algorithms.collector import Collector, Columns
from train.algorithms.fused_rollouts import Frames, FusedUpdate, fused_update
from train.algorithms.learner import Build, NetworkLearner, VecEnv, backward
from train.networks.actor_critic import ActorCritic
from train.networks.distributions import DISTRIBUTION
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.policy import Player
from train.settings.algorithms import ActorCriticSettings, RolloutSettings

Figures = dict[str, torch.Tensor]
Loss = Callable[[Frames, LossCoefficients], tuple[torch.Tensor, Figures]]


def actor_critic_of(settings: ActorCriticSettings, player: Player, build: Build) -> ActorCritic:
    """A new actor-critic network for the player."""
    network = ActorCritic(
        player.features,
        player.num_actions,
        build.hidden(settings),
        settings.shared,
        settings.action_std if player.continuous else None,
    )
    return network.to(build.device)


class TorchUpdate:
    """Collects rollouts, and computes gradients by autograd, for any network and environment.

    Args:
        env: the training environment.
        network: policy and value.
        steps: of every game in a rollout.
        loss: of a minibatch.
        device: of the network.
        critic: False sets all values to 0.
        keep_distribution: keep the parameters of the action distributions.

    Attributes:
        edit: changes the columns of a rollout before advantages are computed from them.
    """

    name = "torch"

    def __init__(
        self,
        env: VecEnv,
        network: ActorCritic,
        steps: int,
        loss: Loss,
        device: str,
        critic: bool = True,
        keep_distribution: bool = False,
    ) -> None:
        self.env, self.network, self.loss, self.critic = env, network, loss, critic
        self._weights = list(network.parameters())
        self.keep_distribution = keep_distribution
        self.edit: Callable[[Columns], Columns] = lambda rollout: rollout
        value = self._value if critic else None
        self.collector = Collector(env, self._act, steps, sum(network.sizes), device, value)

    def _act(self, seen: Columns, state: torch.Tensor) -> tuple[Columns, torch.Tensor]:
        """Drawn actions with the columns that learning needs, and the next states."""
        output, value, state = self.network.step(seen["observation"], state)
        distribution = self.network.distribution(output, seen.get(ACTION_MASK, None))
        drawn = distribution.draw()
        found = {
            distribution.DRAWN: drawn,
            "action": distribution.action(drawn),
            "action_log_prob": distribution.log_prob(drawn),
            "value": value.squeeze(-1) if self.critic else torch.zeros_like(value.squeeze(-1)),
        }
        if self.keep_distribution:
            found[DISTRIBUTION] = distribution.parameters
        return found, state

    def _value(self, observation: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        return self.network.step(observation, state)[1].squeeze(-1)

    def collect(self, gamma: float, gae_lambda: float) -> Frames:
        """A rollout with its advantages: frames, or for a recurrent network one sequence for every
        game, as the input of `ActorCritic.forward_sequence`."""
        rollout = self.edit(self.collector.rollout())
        if not self.critic:
            rollout["value_after"] = torch.zeros_like(rollout["value"])
        rollout["advantage"], rollout["value_target"] = advantages(rollout, gamma, gae_lambda)
        if self.env.hook.wants_advantages:
            noted = (rollout["advantage"], rollout["done"])
            self.env.hook.note_advantages(*(column.cpu().numpy() for column in noted))
        names = [self.network.form.DRAWN, "action_log_prob", "advantage", "value_target"]
        names += [name for name in (DISTRIBUTION, ACTION_MASK) if name in rollout]
        idle = rollout["idle"].squeeze(-1) if "idle" in rollout else None
        if self.network.policy_memory is not None:
            frames = {name: rollout[name] for name in (*names, "episode_start")}
            frames["prepared"] = self.network.policy_trunk.prepare(rollout["observation"])
            frames["state"] = self.collector.states[0]
            return frames if idle is None else frames | {"loss_mask": ~idle}
        frames = {name: rollout[name].flatten(0, 1) for name in names}
        observations = rollout["observation"].flatten(0, 1)
        frames["prepared"] = self.network.policy_trunk.prepare(observations)
        if idle is None:
            return frames
        return {name: column[~idle.flatten()] for name, column in frames.items()}

    def set_gradients(self, minibatch: Frames, coefficients: LossCoefficients) -> Figures:
        """Writes the gradients of the loss to `grad` of all weights; returns values for the log."""
        for weight in self._weights:
            weight.grad = None
        loss, figures = self.loss(minibatch, coefficients)
        backward(loss)
        return figures


class RolloutLearner(NetworkLearner, ABC):
    """Collects rollouts with advantages, and computes gradients of a loss on them.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        network: policy and value.
        device: of the network.
        gae_lambda: of the advantages; 1 makes them discounted returns minus the value.
        critic: False sets all values to 0.
        keep_distribution: keep the parameters of the action distributions.
        fused: whether the fused update may replace `collect` and `loss`.

    Attributes:
        update: collects and computes gradients: a `FusedUpdate` where possible, else a
            `TorchUpdate` of `loss`.
        frames_of_row: number of frames in a row of `collect`.
    """

    network: ActorCritic

    def __init__(
        self,
        settings: RolloutSettings,
        env: VecEnv,
        network: ActorCritic,
        device: str,
        gae_lambda: float,
        critic: bool = True,
        keep_distribution: bool = False,
        fused: bool = True,
    ) -> None:
        super().__init__(settings, env, network, device)
        self.gamma, self.gae_lambda, self.gamma_at = settings.gamma, gae_lambda, settings.gamma_at
        self.steps, self.critic, self.keep_distribution = (
            settings.rollout_steps, critic, keep_distribution,
        )  # fmt: skip
        self.frames_of_row = self.steps if network.policy_memory is not None else 1
        custom = type(self).collect is not RolloutLearner.collect
        self._fused = fused and critic and not keep_distribution and not custom
        self.update = self._choose_update()

    def _choose_update(self) -> FusedUpdate | TorchUpdate:
        """The fused update where its kernels support everything, else the torch update.

        They need fused="auto", the built-in `loss` and `collect`, a critic and no KL target, the
        CPU, a `LockstepEnv` without masks (`fused_update`), and a non-recurrent actor-critic on
        `index` with one shared trunk of two layers with ReLUs (`fused_actor_critic`).
        """
        sizes = (self.env, self.network, self.steps)
        found = fused_update(*sizes, self.device) if self._fused else None
        kept = (self.critic, self.keep_distribution)
        return found or TorchUpdate(*sizes, self.loss, self.device, *kept)

    @abstractmethod
    def loss(
        self, minibatch: Frames, coefficients: LossCoefficients
    ) -> tuple[torch.Tensor, Figures]:
        """The loss of some frames, to be minimised, and its terms for the log, detached."""

    @property
    def update_form(self) -> str:
        """The form of the update: "fused" or "torch"."""
        return self.update.name

    def set_schedules(self, progress: float) -> None:
        """Set also the discount."""
        super().set_schedules(progress)
        self.gamma = self.gamma_at(progress)

    def collect(self) -> Frames:
        """A rollout with advantages, as the input of `ActorCritic.forward_sequence`."""
        self.frames += self.steps * self.env.action_spec.shape[0]
        return self.update.collect(self.gamma, self.gae_lambda)

    @property
    def _recurrent_collector(self) -> Collector | None:
        """The collector with the states of a recurrent network; None without one."""
        if self.network.policy_memory is None or not isinstance(self.update, TorchUpdate):
            return None
        return self.update.collector

    def state_dict(self) -> dict[str, Any]:
        """The state, with the recurrent states of the games."""
        state, collector = super().state_dict(), self._recurrent_collector
        return state if collector is None else {**state, "memory": collector.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        collector = self._recurrent_collector
        if collector is not None:
            collector.load_state_dict(state["memory"])
