"""Proximal policy optimisation (PPO)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.advantages import standardized
from train.algorithms.fused_rollouts import Frames, select
from train.algorithms.learner import Build, VecEnv, means
from train.algorithms.rollouts import Figures, RolloutLearner, actor_critic_of
from train.networks.actor_critic import ActorCritic
from train.networks.distributions import DISTRIBUTION
from train.networks.fused_actor_critic import LossCoefficients
from train.settings.algorithms import PPOSettings


class PPO(RolloutLearner):
    """Schulman et al. (2017) with generalised advantages (Schulman et al., 2016).

    Args:
        settings: the hyperparameters. Without `critic` values are 0 and lambda is 1, so that
            advantages are discounted returns.
        env: the training environment.
        network: policy and value.
        device: of the network.
        fused: whether the fused update is used where possible.

    Attributes:
        kl_coef: weight of the KL penalty; adapted after each rollout if there is a target.
    """

    def __init__(
        self,
        settings: PPOSettings,
        env: VecEnv,
        network: ActorCritic,
        device: str = "cpu",
        fused: bool = True,
    ) -> None:
        penalised, custom = settings.kl_target > 0, type(self).loss is not PPO.loss
        super().__init__(
            settings,
            env,
            network,
            device,
            gae_lambda=settings.gae_lambda if settings.critic else 1.0,
            critic=settings.critic,
            keep_distribution=penalised or custom,
            fused=fused and not custom,
        )
        self.settings = settings
        self.kl_coef = settings.kl_coef if penalised else 0.0

    def iterate(self, progress: float) -> dict[str, float]:
        """Collect one rollout and learn from it; `progress` in [0, 1] of the budget.

        `self.update` collects and computes gradients: `TorchUpdate` with the loss `ppo_loss` below,
        or for small networks on the CPU `FusedUpdate`, which computes the same with kernels
        (`RolloutLearner._choose_update` selects it).

        Returns:
            Means over the gradient steps: the losses, the entropy, the clipped share and so on.
        """
        settings = self.settings
        self.set_schedules(progress)
        coefficients = LossCoefficients(
            settings.clip,
            settings.value_coef if settings.critic else None,
            self.annealed(settings.entropy_coef, progress, settings.entropy_end),
            settings.standardize_advantages,
            kl_coef=self.kl_coef,
        )
        frames = self.collect()  # with advantages
        rows = len(frames["advantage"])
        # A team with idle agents gives fewer frames than were collected.
        size = min(max(settings.minibatch_size // self.frames_of_row, 1), rows)
        logged: list[Figures] = []
        for _ in range(settings.epochs):
            for chosen in torch.split(torch.randperm(rows, device=self.device), size):
                if len(chosen) < size:
                    continue
                minibatch = select(frames, chosen)
                active = minibatch.get("loss_mask")
                if active is None or active.any():  # sequences of captured agents have no frames
                    logged.append(self.update.set_gradients(minibatch, coefficients))
                    self.descend_by_gradients()
        if self.kl_coef and logged:
            self._adapt_kl_coef(logged[-1]["kl"])
        return means(logged)

    def loss(
        self, minibatch: Frames, coefficients: LossCoefficients
    ) -> tuple[torch.Tensor, Figures]:
        """`ppo_loss`, which the torch update minimises; the fused one has kernels for it."""
        return ppo_loss(self.network, minibatch, coefficients)

    def _adapt_kl_coef(self, found: torch.Tensor) -> None:
        """Schulman et al. (2017), section 4, with the thresholds of RLlib."""
        if self.average is not None:
            self.average([found])
        divergence = float(found)
        if divergence > 2.0 * self.settings.kl_target:
            self.kl_coef *= 1.5
        elif divergence < 0.5 * self.settings.kl_target:
            self.kl_coef *= 0.5

    def state_dict(self) -> dict[str, Any]:
        """The state, with the weight of the KL penalty."""
        return {**super().state_dict(), "kl_coef": self.kl_coef}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        self.kl_coef = state["kl_coef"]


def ppo_loss(
    network: ActorCritic,
    minibatch: Mapping[str, torch.Tensor],
    coefficients: LossCoefficients,
    penalties: Callable[[Any], Figures] | None = None,
) -> tuple[torch.Tensor, Figures]:
    """The clipped surrogate objective with value loss and entropy bonus, to be minimised.

    Equal to TorchRL's `ClipPPOLoss` with squared value errors, and advantages standardised as the
    coefficients say (tested); that has a fixed cost which slowed training of 128x128 networks to
    0.7. With `kl_coef` the penalty of `KLPENPPOLoss` is added, as in RLlib's PPO.

    Args:
        network: policy and value.
        minibatch: the columns that `ActorCritic.forward_sequence` takes, with "action" (continuous
            actions: "drawn", before tanh), "action_log_prob", "advantage" and "value_target"; with
            `kl_coef` the "distribution" of the collecting policy; with masks "action_mask".
        coefficients: of the terms of the loss.
        penalties: of the action distribution, further terms of the loss by name.

    Returns:
        The loss, and its terms for the log, detached.
    """
    hidden, value_hidden, minibatch = network.forward_sequence(minibatch)
    output = network.policy_head(hidden)
    distribution = network.distribution(output, minibatch.get(ACTION_MASK, None))
    advantage = minibatch["advantage"]
    if coefficients.standardize:
        advantage = standardized(advantage)
    change = distribution.log_prob(minibatch[distribution.DRAWN]) - minibatch["action_log_prob"]
    ratio = change.exp()
    clipped = ratio.clamp(1.0 - coefficients.clip, 1.0 + coefficients.clip)
    objective = -torch.minimum(ratio * advantage, clipped * advantage).mean()
    entropy = distribution.entropy().mean()
    total, parts = objective, {"loss_objective": objective}
    if coefficients.value_coef is not None:
        error = network.value_head(value_hidden).squeeze(-1) - minibatch["value_target"]
        parts["loss_critic"] = coefficients.value_coef * error.square().mean()
        total = total + parts["loss_critic"]
    total = total - coefficients.entropy_coef * entropy
    parts |= {
        "entropy": entropy,
        "clip_fraction": (ratio != clipped).float().mean(),
        "kl_approx": -change.mean(),
    }
    if coefficients.kl_coef:
        parts["kl"] = distribution.divergence(minibatch[DISTRIBUTION]).mean()
        total = total + coefficients.kl_coef * parts["kl"]
    if penalties is not None:
        more = penalties(distribution)
        parts, total = parts | more, total + sum(more.values())
    return total, {name: value.detach() for name, value in parts.items()}


def build(settings: PPOSettings, env: VecEnv, how: Build) -> PPO:
    """A PPO learner for an environment."""
    network = actor_critic_of(settings, env.player, how)
    return PPO(settings, env, network, how.device, how.fused)
