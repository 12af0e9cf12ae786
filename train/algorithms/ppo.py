"""Proximal policy optimisation (PPO): the loss, and the learner that A2C and others are made of."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, Self, cast

import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.advantages import standardized
from train.algorithms.collector import EXPERT
from train.algorithms.fused_rollouts import FusedEngine, fused_engine
from train.algorithms.learner import Build, HasState, NetworkLearner, VecEnv, expert_in, means
from train.algorithms.rollouts import Figures, Frames, TorchEngine, actor_critic_of, select
from train.networks.actor_critic import ActorCritic
from train.networks.distributions import DISTRIBUTION
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.seat import Seat
from train.settings.algorithms import A2CSettings, PPOSettings, ReinforceSettings


class PPO(NetworkLearner):
    """Schulman et al. (2017) with generalised advantages (Schulman et al., 2016).

    Args:
        settings: the hyperparameters. Without `critic` values are 0 and lambda is 1, so that
            advantages are discounted returns.
        env: the training environment.
        network: policy and value.
        device: of the network.
        fused: whether the fused engine is used where possible.

    Attributes:
        ppo: the settings of rollouts and loss, in the terms of PPO; `settings` of PPO itself.
        engine: collects rollouts and computes gradients: a `FusedEngine` where possible, else a
            `TorchEngine` of `loss`.
        kl_coef: weight of the KL penalty; adapted after each rollout if there is a target.
        gamma: the current discount.
        frames_of_row: number of frames in a row of `collect`.
    """

    COUNTERS: ClassVar[tuple[str, ...]] = ("frames", "kl_coef")
    settings: PPOSettings | A2CSettings | ReinforceSettings
    network: ActorCritic

    def __init__(
        self,
        settings: PPOSettings | A2CSettings | ReinforceSettings,
        env: VecEnv,
        network: ActorCritic,
        device: str = "cpu",
        fused: bool = True,
    ) -> None:
        super().__init__(settings, env, network, device)
        self.ppo = ppo = settings.as_ppo()
        self.kl_coef = ppo.kl_coef if ppo.kl_target > 0 else 0.0
        self.gamma = ppo.gamma
        self.frames_of_row = ppo.rollout_steps if network.policy_memory is not None else 1
        self.engine = self._choose_engine(fused)

    @staticmethod
    def network_of(settings: Any, seat: Seat, build: Build) -> ActorCritic:
        """A new network for the seat."""
        return actor_critic_of(settings, seat, build)

    @classmethod
    def build(cls, settings: Any, env: VecEnv, options: Build) -> Self:
        """A learner with a new network for an environment."""
        network = cls.network_of(settings, env.player, options)
        return cls(settings, env, network, options.device, options.fused)

    def iterate(self, progress: float) -> dict[str, float]:
        """Collect one rollout and learn from it; `progress` in [0, 1] of the budget.

        `self.engine` collects and computes gradients. By default, with a small network on the CPU,
        it is a `FusedEngine`, with kernels; it computes the same as a `TorchEngine` with the loss
        `ppo_loss` below, which supports everything.

        Returns:
            Means over the gradient steps: the losses, the entropy, the clipped share and so on.
        """
        self.set_schedules(progress)
        coefficients = self.coefficients(progress)._replace(imitation=self.imitation())
        frames = self.collect()  # with advantages
        logged: list[Figures] = []
        for minibatch in self.minibatches(frames):
            active = minibatch.get("loss_mask")
            if active is None or active.any():  # sequences of captured agents have no frames
                logged.append(self.engine.set_gradients(minibatch, coefficients))
                self.descend_by_gradients()
        if self.kl_coef and logged:
            self._adapt_kl_coef(logged[-1]["kl"])
        return means(logged)

    def collect(self) -> Frames:
        """A rollout with advantages, as the input of `ActorCritic.forward_sequence`."""
        settings = self.ppo
        self.frames += settings.rollout_steps * self.env.rows
        return self.engine.collect(self.gamma, settings.gae_lambda if settings.critic else 1.0)

    def minibatches(self, frames: Frames) -> Iterator[Frames]:
        """In each epoch the frames of a rollout, in a new random order, in parts of equal size."""
        rows = len(frames["advantage"])
        # A team with idle agents gives fewer frames than were collected.
        size = min(max(self.ppo.minibatch_size // self.frames_of_row, 1), rows)
        for _ in range(self.ppo.epochs):
            for chosen in torch.split(torch.randperm(rows, device=self.device), size):
                if len(chosen) == size:
                    yield select(frames, chosen)

    def loss(
        self, minibatch: Frames, coefficients: LossCoefficients
    ) -> tuple[torch.Tensor, Figures]:
        """`ppo_loss`, which the torch engine minimises; the fused one has kernels for it."""
        return ppo_loss(self.network, minibatch, coefficients)

    def coefficients(self, progress: float) -> LossCoefficients:
        """The coefficients of the loss."""
        settings = self.ppo
        return LossCoefficients(
            settings.clip,
            settings.value_coef if settings.critic else None,
            self.annealed(settings.entropy_coef, progress, settings.entropy_end),
            settings.standardize_advantages,
            self.kl_coef,
        )

    def imitation(self) -> float:
        """The weight of imitation in the next iteration; where it is 0 nothing is imitated any
        more."""
        expert = expert_in(self.env)
        if expert is None:
            return 0.0
        weight = 1.0 - self.frames / expert.frames
        if weight <= 0.0:
            cast(Any, self.env).expert = None
        return max(weight, 0.0)

    def set_schedules(self, progress: float) -> None:
        """Set also the discount."""
        super().set_schedules(progress)
        self.gamma = self.settings.gamma_at(progress)

    def _adapt_kl_coef(self, divergence: torch.Tensor) -> None:
        """Schulman et al. (2017), section 4, with the thresholds of RLlib."""
        if self.average is not None:
            self.average([divergence])
        if float(divergence) > 2.0 * self.ppo.kl_target:
            self.kl_coef *= 1.5
        elif float(divergence) < 0.5 * self.ppo.kl_target:
            self.kl_coef *= 0.5

    def _choose_engine(self, fused: bool) -> FusedEngine | TorchEngine:
        """The fused engine where its kernels support everything, else the torch engine.

        They need fused="auto", the built-in `loss` and `collect`, a critic, no KL target and no
        imitation, the CPU, a `BatchEnv` without masks (`fused_engine`), and a non-recurrent
        actor-critic on `index` with one shared trunk of two layers with ReLUs
        (`fused_actor_critic`).
        """
        settings, own = self.ppo, type(self)
        custom_loss, penalised = own.loss is not PPO.loss, settings.kl_target > 0
        custom = custom_loss or own.collect is not PPO.collect or expert_in(self.env) is not None
        sizes = (self.env, self.network, settings.rollout_steps, self.device)
        if fused and settings.critic and not penalised and not custom:
            engine = fused_engine(*sizes)
            if engine is not None:
                return engine
        return TorchEngine(*sizes, self.loss, settings.critic, penalised or custom_loss)

    @property
    def update_form(self) -> str:
        """The form of the engine: "fused" or "torch"."""
        return self.engine.name

    def parts(self) -> dict[str, HasState]:
        """As of `NetworkLearner`, with the recurrent states of the games."""
        return {**super().parts(), **self.engine.parts()}


def ppo_loss(
    network: ActorCritic,
    minibatch: Mapping[str, torch.Tensor],
    coefficients: LossCoefficients,
    penalties: Callable[[Any], Figures] | None = None,
) -> tuple[torch.Tensor, Figures]:
    """The loss of PPO where the default, the fused kernel `clipped_loss`, does not support the run.

    The clipped surrogate objective with value loss and entropy bonus, to be minimised. The kernel,
    in `train/networks/fused_kernels.py`, computes the same; `PPO._choose_engine` chooses.

    Equal to TorchRL's `ClipPPOLoss` with squared value errors, and advantages standardised as the
    coefficients say (tested); that has a fixed cost which slowed training of 128x128 networks to
    0.7. With `kl_coef` the penalty of `KLPENPPOLoss` is added, as in RLlib's PPO.

    Without clipping it is the loss of A2C, the policy gradient, equal to TorchRL's `A2CLoss`
    (tested): on the frames of the current policy all probability ratios are 1. On standardised
    returns of whole episodes and their errors it is the loss of REINFORCE.

    Args:
        network: policy and value.
        minibatch: the columns that `ActorCritic.forward_sequence` takes, with "action" (continuous
            actions: "drawn", before tanh), "action_log_prob", "advantage" and "value_target"; with
            `kl_coef` the "distribution" of the collecting policy; with masks "action_mask".
        coefficients: of the terms of the loss. With a column "expert" the cross-entropy to these
            probabilities replaces the share `imitation` of the objective (Ross et al., 2011,
            DAgger: the states are those of the learner).
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
    log_prob, measured = distribution.log_prob(minibatch[distribution.DRAWN]), Figures()
    if math.isinf(coefficients.clip):
        objective = -(log_prob * advantage).mean()
    else:
        change = log_prob - minibatch["action_log_prob"]
        ratio = change.exp()
        clipped = ratio.clamp(1.0 - coefficients.clip, 1.0 + coefficients.clip)
        objective = -torch.minimum(ratio * advantage, clipped * advantage).mean()
        measured["clip_fraction"] = (ratio != clipped).float().mean()
        measured["kl_approx"] = -change.mean()
    entropy = distribution.entropy().mean()
    total, terms = objective, {"loss_objective": objective}
    if EXPERT in minibatch:
        imitated = -(minibatch[EXPERT] * distribution.parameters).sum(dim=-1).mean()
        total = torch.lerp(objective, imitated, coefficients.imitation)
        terms["loss_imitation"] = imitated
    if coefficients.value_coef is not None:
        error = network.value_head(value_hidden).squeeze(-1) - minibatch["value_target"]
        terms["loss_critic"] = coefficients.value_coef * error.square().mean()
        total = total + terms["loss_critic"]
    total = total - coefficients.entropy_coef * entropy
    terms |= {"entropy": entropy, **measured}
    if coefficients.kl_coef:
        terms["kl"] = distribution.divergence(minibatch[DISTRIBUTION]).mean()
        total = total + coefficients.kl_coef * terms["kl"]
    if penalties is not None:
        more = penalties(distribution)
        terms, total = terms | more, total + sum(more.values())
    return total, {name: value.detach() for name, value in terms.items()}
