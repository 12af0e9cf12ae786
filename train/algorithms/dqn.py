"""Deep Q-learning with optional extensions."""

from __future__ import annotations

from typing import ClassVar, cast

import torch

from curricula import linear
from pursuit.observations.masks import ACTION_MASK
from train.algorithms.collector import NEXT_CRITIC, NEXT_MASK, Collector, Columns
from train.algorithms.learner import Build, HasState, VecEnv
from train.algorithms.off_policy import OffPolicyLearner
from train.algorithms.replay import NEXT_IDLE, Batch, returns_to_expect, weighted_mean
from train.networks.distributions import masked
from train.networks.policy import CRITIC
from train.networks.q_network import Mixer, QNetwork
from train.networks.seat import Seat
from train.networks.separate import network_with_sharing
from train.settings.algorithms import QMIXSettings
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
    settings: DQNSettings
    network: QNetwork

    def __init__(self, settings: DQNSettings, env: VecEnv, options: Build) -> None:
        network, self.target = (network_of(settings, env.player, options) for _ in range(2))
        steps = settings.rollout_steps
        collector = Collector(env, self.act, steps, 0, options.device, keep_next=True)
        super().__init__(settings, env, network, collector, options.device, options.seed)
        self.epsilon = 1.0
        self.target.load_state_dict(network.state_dict())

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

    def learn(self, batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """A gradient step, and every `target_update_interval` steps a copy to the target."""
        settings = self.settings
        if self.updates % settings.target_update_interval == 0:
            self.target.load_state_dict(self.network.state_dict())
        self.updates += 1
        networks = (self.network, self.target)
        loss, error = dqn_loss(*networks, batch, settings.gamma, settings.double)
        self.descend(loss)
        return error, {"loss": loss.detach(), "td_error": error.mean()}

    def parts(self) -> dict[str, HasState]:
        """As of `NetworkLearner`, with the target network."""
        return {**super().parts(), "target": self.target}


def dqn_loss(
    network: QNetwork, target: QNetwork, batch: Batch, gamma: float, double: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """The squared temporal-difference error, and |error| of every transition.

    Equal to TorchRL's `DQNLoss` (tested). Written explicitly, it avoids functional calls at every
    step.

    Args:
        network: the trained network.
        target: evaluates the next action.
        batch: "observation", "action", "reward", "next_observation", "terminated", "steps" (to the
            next observation); with prioritised replay "priority_weight"; with masks
            "next_action_mask", the allowed next actions. Of a team (`VDN`) observations and actions
            are [batch, agents, ...], with "idle" and "next_idle" [batch, agents], the agents that
            have left; values are the sums over the others, or mixed (`Mixer`) by the state in
            "critic_observation" and "next_critic_observation".
        gamma: discount of a step.
        double: whether `network` chooses the next action.

    Returns:
        The loss, and |error| [batch], detached.
    """
    team = NEXT_IDLE in batch

    def agents(name: str) -> torch.Tensor:
        """The rows of all agents."""
        return batch[name].flatten(0, 1) if team else batch[name]

    def joint(
        values: torch.Tensor, actions: torch.Tensor, idle: str, state: str, of: QNetwork
    ) -> torch.Tensor:
        """[batch] the values of these actions."""
        chosen = values.gather(-1, actions).squeeze(-1)
        if not team:
            return chosen
        each = chosen.view_as(batch[idle]) * ~batch[idle]
        return each.sum(dim=1) if of.mixer is None else of.mixer(each, batch[state])

    seen, following = agents("observation"), agents("next_observation")
    with torch.no_grad():
        next_values = target.forward_inference(following)
        chooser = network.forward_inference(following) if double else next_values
        chooser = masked(chooser, agents(NEXT_MASK) if NEXT_MASK in batch else None)
    next_action = chooser.argmax(dim=-1, keepdim=True)
    next_joint = joint(next_values, next_action, NEXT_IDLE, NEXT_CRITIC, target)
    goal = returns_to_expect(batch, next_joint, gamma)
    values = network.forward_inference(seen)
    error = joint(values, agents("action")[:, None], "idle", CRITIC, network) - goal
    return weighted_mean(error.square(), batch), error.detach().abs()


def network_of(settings: DQNSettings, player: Seat, build: Build) -> QNetwork:
    """A new action value network for the player; with separate networks of its agents all."""

    def new() -> QNetwork:
        sizes = (player.features, player.num_actions, build.hidden(settings))
        return QNetwork(*sizes, settings.dueling, build.fused)

    network = network_with_sharing(new, settings, player)
    features = player.critic_features
    if isinstance(settings, QMIXSettings) and features is not None and player.members > 1:
        network.mixer = Mixer(features, player.members, settings.mixing_width)
    return cast(QNetwork, network.to(build.device))
