"""Proximal policy optimisation: one iteration, top to bottom."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDictBase

from pursuit.masks import ACTION_MASK
from train.algorithms.learner import Build, Games, means
from train.algorithms.rollouts import RolloutLearner, actor_critic_of
from train.networks.actor_critic import ActorCritic, CentralActorCritic
from train.networks.distributions import DISTRIBUTION
from train.networks.joined_actor_critic import Learned, Weighing
from train.networks.policy import Player
from train.settings.algorithms import PPOSettings
from train.settings.checks import check


def ppo_loss(
    network: ActorCritic,
    minibatch: TensorDictBase,
    settings: PPOSettings,
    entropy_coef: float,
    kl_coef: float = 0.0,
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """The clipped surrogate objective with value loss and entropy bonus, to be minimised.

    Equal to TorchRL's `ClipPPOLoss` with `normalize_advantage=True` and squared value errors, and
    tested against it; its fixed cost held training of 128x128 networks to 0.7 of the speed. With
    `kl_coef` the penalty of `KLPENPPOLoss` is added, as RLlib's PPO does.

    Args:
        network: policy and value.
        minibatch: frames, or sequences of a network that remembers, as `ActorCritic.through` takes
            them: "prepared" (see `Trunk.prepare`), what was drawn ("action", or "drawn" before
            tanh), "action_log_prob", "advantage" and "value_target"; with `kl_coef` the
            "distribution" that it was drawn from; with masks "action_mask".
        settings: the hyperparameters.
        entropy_coef: weight of the entropy bonus.
        kl_coef: weight of the divergence KL(collecting policy, policy).

    Returns:
        The loss, and its parts for the log, detached.
    """
    hidden, value_hidden, minibatch = network.through(minibatch)
    output = network.policy_head(hidden)
    distribution = network.distribution(output, minibatch.get(ACTION_MASK, None))
    advantage = minibatch["advantage"].squeeze(-1)
    advantage = (advantage - advantage.mean()) / advantage.std().clamp(min=1e-6)
    drawn = minibatch[distribution.DRAWN]
    change = distribution.log_prob(drawn) - minibatch["action_log_prob"]
    ratio = change.exp()
    clipped = ratio.clamp(1.0 - settings.clip, 1.0 + settings.clip)
    objective = -torch.minimum(ratio * advantage, clipped * advantage).mean()
    entropy = distribution.entropy().mean()
    total, parts = objective, {"loss_objective": objective}
    if settings.critic:
        error = (network.value_head(value_hidden) - minibatch["value_target"]).square().mean()
        parts["loss_critic"] = settings.value_coef * error
        total = total + parts["loss_critic"]
    total = total - entropy_coef * entropy
    parts |= {
        "entropy": entropy,
        "clip_fraction": (ratio != clipped).float().mean(),
        "kl_approx": -change.mean(),
    }
    if kl_coef:
        parts["kl"] = distribution.divergence(minibatch[DISTRIBUTION]).mean()
        total = total + kl_coef * parts["kl"]
    return total, {name: value.detach() for name, value in parts.items()}


class PPO(RolloutLearner):
    """Schulman et al. (2017) with generalised advantages (Schulman et al., 2016).

    Args:
        settings: the hyperparameters; without `critic` every value is 0 and lambda is 1, so that
            advantages are discounted returns.
        env: the games.
        network: policy and value.
        device: where the network lives.

    Attributes:
        kl_coef: of the divergence penalty; adapted after each rollout where there is a target.
    """

    def __init__(
        self,
        settings: PPOSettings,
        env: Games,
        network: ActorCritic,
        device: str = "cpu",
    ) -> None:
        penalised = settings.kl_target > 0
        how = (settings.gae_lambda if settings.critic else 1.0, settings.critic, penalised)
        super().__init__(settings, env, network, device, *how)
        self.settings = settings
        self.kl_coef = settings.kl_coef if penalised else 0.0

    def iterate(self, progress: float) -> dict[str, float]:
        """Collect one rollout and learn from it; `progress` in [0, 1] through the budget.

        Returns:
            Means over the gradient steps: the losses, the entropy, the clipped share and so on.
        """
        settings = self.settings
        self.set_schedules(progress)
        entropy_coef = self.annealed(settings.entropy_coef, progress)
        frames = self.collect() if self.joined is None else self.collect_joined()
        orders = (torch.randperm(len(frames), device=self.device) for _ in range(settings.epochs))
        logged = self._descents(frames, orders, entropy_coef, self.kl_coef)
        if self.kl_coef:
            self._adapt_kl_weight(logged[-1]["kl"])
        return means(logged)

    def _descents(
        self,
        frames: TensorDictBase | Learned,
        orders: Iterable[torch.Tensor],
        entropy_coef: float,
        kl_coef: float,
    ) -> list[dict[str, torch.Tensor]]:
        """All gradient steps on a rollout: an epoch in each of the orders [frames]."""
        # Idle agents of a team leave fewer frames than were collected.
        size = min(max(self.settings.minibatch_size // self.frames_of_row, 1), len(frames))
        logged: list[dict[str, torch.Tensor]] = []
        for order in orders:
            for chosen in torch.split(order, size):
                if len(chosen) == size:
                    logged.append(self._learn(frames, chosen, entropy_coef, kl_coef))
        return logged

    def _learn(
        self,
        frames: TensorDictBase | Learned,
        chosen: torch.Tensor,
        entropy_coef: float,
        kl_coef: float,
    ) -> dict[str, torch.Tensor]:
        """A gradient step on the frames of these numbers; its figures for the log."""
        settings = self.settings
        if isinstance(frames, Learned):
            assert self.joined is not None
            weighing = Weighing(settings.clip, settings.value_coef, entropy_coef)
            parts = self.joined.set_gradients(frames.at(chosen), weighing)
            self.descend_by_gradients()
            return parts
        # Half the time of frames[chosen].
        minibatch = frames.apply(
            lambda column: column.index_select(0, chosen), batch_size=[len(chosen)]
        )
        total, parts = ppo_loss(self.network, minibatch, settings, entropy_coef, kl_coef)
        self.descend(total)
        return parts

    def _adapt_kl_weight(self, found: torch.Tensor) -> None:
        """Schulman et al. (2017), section 4, with the thresholds of RLlib."""
        self.average([found])
        divergence = float(found)
        if divergence > 2.0 * self.settings.kl_target:
            self.kl_coef *= 1.5
        elif divergence < 0.5 * self.settings.kl_target:
            self.kl_coef *= 0.5

    def state_dict(self) -> dict[str, Any]:
        """Weights, Adam's moments, the frames and the weight of the divergence."""
        return {**super().state_dict(), "kl_coef": self.kl_coef}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take them back."""
        super().load_state_dict(state)
        self.kl_coef = state["kl_coef"]


def network_of(settings: PPOSettings, player: Player, build: Build) -> ActorCritic:
    """Fresh, with a critic of its own kind where the settings want a central one.

    Raises:
        ValueError: a central critic of continuous actions.
    """
    if not settings.central_critic:
        return actor_critic_of(settings, player, build)
    check(
        not player.continuous,
        "central_critic=True with continuous actions; it sees agents in a maze: leave it out",
    )
    sizes = (player.features, player.num_actions, player.members)
    return CentralActorCritic(*sizes, build.hidden(settings)).to(build.device)


def build(settings: PPOSettings, env: Games, how: Build) -> PPO:
    """The learner over its games."""
    network = network_of(settings, env.player, how)
    return PPO(settings, env, network, how.device)
