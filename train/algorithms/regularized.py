"""PPO regularised towards a reference policy, for the last iterate of self-play.

The policies of two gradient learners with opposed rewards can cycle around an equilibrium. Both
learners of this module add a penalty for leaving a reference policy, so that they converge to the
equilibrium of the penalised game. The reference policy follows, and the penalty vanishes at an
equilibrium of the game.
"""

from __future__ import annotations

from copy import deepcopy
from typing import ClassVar

import torch

from pursuit.observations.masks import ACTION_MASK
from train.algorithms.collector import Columns
from train.algorithms.fused_rollouts import FusedEngine
from train.algorithms.learner import HasState, VecEnv
from train.algorithms.ppo import PPO, ppo_loss
from train.algorithms.rollouts import Figures, Frames, TorchEngine
from train.networks.actor_critic import ActorCritic
from train.networks.continuous import polyak_update
from train.networks.distributions import DISTRIBUTION, Categorical
from train.networks.fused_actor_critic import LossCoefficients
from train.settings.algorithms import MMDSettings, ReferenceSettings, RNaDSettings

MAGNET = "magnet"
"""Column of the log-probabilities [frames, actions] of the magnet."""


class ReferencePPO(PPO):
    """PPO with a reference policy, whose weights move to those of the policy at intervals.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        network: policy and value.
        device: of the network.
        fused: has no effect, as there are no kernels for this.

    Attributes:
        reference: the network of the reference policy.
        iterations: so far.
    """

    COUNTERS: ClassVar[tuple[str, ...]] = (*PPO.COUNTERS, "iterations")
    COPIES: ClassVar[tuple[str, ...]] = ("reference",)
    settings: ReferenceSettings

    def __init__(
        self,
        settings: ReferenceSettings,
        env: VecEnv,
        network: ActorCritic,
        device: str = "cpu",
        fused: bool = False,
    ) -> None:
        super().__init__(settings, env, network, device, fused=False)
        self.reference, self.iterations = deepcopy(network).requires_grad_(False), 0

    def iterate(self, progress: float) -> dict[str, float]:
        """As PPO, then an update of the reference policy when it is due."""
        figures = super().iterate(progress)
        self.iterations += 1
        if self.iterations % self.settings.reference_interval == 0:
            polyak_update(self.reference, self.network, self.settings.reference_rate)
        return figures

    def parts(self) -> dict[str, HasState]:
        """As of PPO, with the reference policy."""
        return {**super().parts(), "reference": self.reference}


class MMD(ReferencePPO):
    """Magnetic mirror descent (Sokota et al., 2023, "A unified approach to reinforcement learning,
    quantal response equilibria, and two-player zero-sum games"), in the form of PPO.

    The loss is that of PPO, with alpha KL(policy, magnet) + 1 / eta KL(policy, collecting policy).
    The last iterate converges to the equilibrium of the game with the first penalty, and so of the
    game itself as the magnet moves to the policy. The weights of the magnet are an exponential
    moving average of the policy's; in the paper this is a geometric mean of policies, which is the
    same for a table of logits.
    """

    settings: MMDSettings

    def collect(self) -> Frames:
        """A rollout with advantages, and the log-probabilities of the magnet."""
        frames = super().collect()
        with torch.no_grad():
            logits = self.reference.policy_head(self.reference.policy_trunk(frames["prepared"]))
        magnet = Categorical(logits, frames.get(ACTION_MASK))
        return {**frames, MAGNET: magnet.parameters}

    def loss(
        self, minibatch: Frames, coefficients: LossCoefficients
    ) -> tuple[torch.Tensor, Figures]:
        """`ppo_loss` with both penalties."""
        weights = {MAGNET: self.settings.magnet_coef, DISTRIBUTION: self.settings.step_coef}

        def penalties(policy: Categorical) -> Figures:
            return {
                f"loss_{name}": weight * divergence(policy, minibatch[name]).mean()
                for name, weight in weights.items()
            }

        return ppo_loss(self.network, minibatch, coefficients, penalties)


def divergence(policy: Categorical, other: torch.Tensor) -> torch.Tensor:
    """[...]: KL(policy, other), `other` [..., actions] log-probabilities."""
    return (policy.parameters.exp() * (policy.parameters - other)).sum(dim=-1)


class RNaD(ReferencePPO):
    """Regularised Nash dynamics (Perolat et al., 2022, "Mastering the game of Stratego with
    model-free multiagent reinforcement learning").

    The rewards are r - eta log(policy(action) / reference(action)), and the reference policy is
    replaced by the policy at intervals. Different from the paper: V-trace is generalised advantage
    estimation, as rollouts are on-policy; NeuRD is PPO's clipped objective; the reference policy is
    replaced at once instead of by interpolation; and the opponent's log-ratio is not added, as a
    side does not see the probabilities of its opponent's policies. That term does not depend on
    own actions in the same step, and it vanishes at the fixed point.
    """

    settings: RNaDSettings

    def _choose_engine(self, fused: bool) -> FusedEngine | TorchEngine:
        engine = super()._choose_engine(fused)
        assert isinstance(engine, TorchEngine)  # as fused=False
        engine.edit = self.regularized
        return engine

    @torch.no_grad()
    def regularized(self, rollout: Columns) -> Columns:
        """A rollout with the changed rewards."""
        logits = self.reference.logits(rollout["observation"])
        reference = Categorical(logits, rollout.get(ACTION_MASK)).log_prob(rollout["action"])
        change = self.settings.reward_coef * (rollout["action_log_prob"] - reference)
        return {**rollout, "reward": rollout["reward"] - change}
