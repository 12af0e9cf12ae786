"""Deep Q-learning with optional extensions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import torch

from curricula import linear
from pursuit.observations.masks import ACTION_MASK
from train.algorithms.collector import NEXT_MASK, Collector, Columns
from train.algorithms.learner import Build, HasState, VecEnv
from train.algorithms.off_policy import OffPolicyLearner
from train.algorithms.replay import Minibatch, returns_to_expect, weighted_mean
from train.networks.distributions import masked
from train.networks.q_network import QNetwork
from train.networks.seat import Seat
from train.settings.off_policy import DQNSettings


class DQN(OffPolicyLearner):
    """Mnih et al. (2015), with parallel games and several gradient steps for each rollout.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        options: of this machine.

    Attributes:
        network, target: action values; the target network.
        epsilon: probability of a random action.
    """

    NO_DISTRIBUTION: ClassVar[str] = "dqn learns no distribution over actions"
    COPIES: ClassVar[tuple[str, ...]] = ("target",)
    settings: DQNSettings
    network: QNetwork

    def __init__(self, settings: DQNSettings, env: VecEnv, options: Build) -> None:
        network, self.target = (self.network_of(settings, env.player, options) for _ in range(2))
        steps = settings.rollout_steps
        collector = Collector(env, self.act, steps, 0, options.device, keep_next=True)
        super().__init__(settings, env, network, collector, options.device, options.seed)
        self.epsilon = 1.0
        self.target.load_state_dict(network.state_dict())

    @staticmethod
    def network_of(settings: Any, seat: Seat, build: Build) -> QNetwork:
        """A new action value network for the seat."""
        sizes = (seat.features, seat.num_actions, build.hidden(settings))
        return QNetwork(*sizes, settings.dueling, build.fused).to(build.device)

    @property
    def update_form(self) -> str:
        """The form of the hidden layers: "fused" or "torch"."""
        return self.network.update_form

    def explore(self, progress: float) -> dict[str, float]:
        """Anneal epsilon."""
        settings = self.settings
        explored = progress / max(settings.exploration_share, 1e-9)
        if settings.exploration_frames is not None:
            explored = self.frames / settings.exploration_frames
        self.epsilon = linear(settings.epsilon_start, settings.epsilon_end, min(explored, 1.0))
        return {"epsilon": self.epsilon}

    def act(self, seen: Columns, state: torch.Tensor) -> tuple[Columns, torch.Tensor]:
        """Epsilon-greedy actions, of the allowed ones."""
        allowed = seen.get(ACTION_MASK, None)
        values = masked(self.network.forward_inference(seen["observation"]), allowed)
        greedy = values.argmax(dim=-1)
        explores = torch.rand(greedy.shape, device=greedy.device) < self.epsilon
        if allowed is None:
            drawn = torch.randint_like(greedy, values.shape[-1])
        else:
            drawn = masked(torch.rand_like(values), allowed).argmax(dim=-1)
        return {"action": torch.where(explores, drawn, greedy)}, state

    def learn(self, batch: Minibatch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """A gradient step, and every `target_update_interval` steps a copy to the target."""
        settings = self.settings
        if self.updates % settings.target_update_interval == 0:
            self.target.load_state_dict(self.network.state_dict())
        self.updates += 1
        loss, error = self.loss(batch)
        self.descend(loss)
        return error, {"loss": loss.detach(), "td_error": error.mean()}

    def loss(self, batch: Minibatch) -> tuple[torch.Tensor, torch.Tensor]:
        """`dqn_loss` of these networks."""
        gamma, double = self.settings.gamma, self.settings.double
        return dqn_loss(self.network, self.target, batch, gamma, double)

    def parts(self) -> dict[str, HasState]:
        """As of `NetworkLearner`, with the target network."""
        return {**super().parts(), "target": self.target}


JointValue = Callable[[QNetwork, torch.Tensor, Minibatch, str], torch.Tensor]
"""(network, values [batch, agents], batch, when) -> [batch], values of joint actions; see `VDN`."""


def dqn_loss(
    network: QNetwork,
    target: QNetwork,
    batch: Minibatch,
    gamma: float,
    double: bool,
    joint_value: JointValue | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The squared temporal-difference error, and |error| of every transition.

    Equal to TorchRL's `DQNLoss` (tested). Written explicitly, it avoids functional calls at every
    step.

    Args:
        network: the trained network.
        target: evaluates the next action.
        batch: "observation", "action", "reward", "next_observation", "terminated", "steps" (to the
            next observation); with prioritised replay "priority_weight"; with masks
            "next_action_mask", the allowed next actions. Of a team (`VDN`) observations, actions
            and masks are [batch, agents, ...].
        gamma: discount of a step.
        double: whether `network` chooses the next action.
        joint_value: of a team, the value of a joint action.

    Returns:
        The loss, and |error| [batch], detached.
    """
    shape = batch["action"].shape

    def rows(name: str) -> torch.Tensor:
        """A column by agent: [batch * agents, ...] of a team."""
        return batch[name].flatten(0, len(shape) - 1)

    def value(of: QNetwork, values: torch.Tensor, action: torch.Tensor, when: str) -> torch.Tensor:
        """[batch] the values of these actions."""
        chosen = values.gather(-1, action[:, None]).view(shape)
        return chosen if joint_value is None else joint_value(of, chosen, batch, when)

    seen, following = rows("observation"), rows("next_observation")
    with torch.no_grad():
        next_values = target.forward_inference(following)
        chooser = network.forward_inference(following) if double else next_values
        chooser = masked(chooser, rows(NEXT_MASK) if NEXT_MASK in batch else None)
    next_value = value(target, next_values, chooser.argmax(dim=-1), "next_")
    goal = returns_to_expect(batch, next_value, gamma)
    error = value(network, network.forward_inference(seen), rows("action"), "") - goal
    return weighted_mean(error.square(), batch), error.detach().abs()
