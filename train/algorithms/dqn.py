"""Deep Q-learning, each extension a switch."""

from __future__ import annotations

from typing import Any

import torch

from curricula import linear
from pursuit.observations.masks import ACTION_MASK
from train.algorithms.collector import NEXT_MASK, Collector, Columns
from train.algorithms.learner import Build, VecEnv
from train.algorithms.off_policy import OffPolicyLearner
from train.algorithms.replay import Batch, mean
from train.networks.distributions import masked
from train.networks.policy import Player
from train.networks.q_network import QNetwork
from train.settings.off_policy import DQNSettings


class DQN(OffPolicyLearner):
    """Mnih et al. (2015), with many games in step and several gradient steps for each rollout.

    Args:
        settings: the hyperparameters.
        env: the games.
        network: action values.
        target: a second network of the same form.
        device: where both live.
        seed: of the draws from the replay buffer.

    Attributes:
        epsilon: the share of random actions.
    """

    network: QNetwork

    def __init__(
        self,
        settings: DQNSettings,
        env: VecEnv,
        network: QNetwork,
        target: QNetwork,
        device: str,
        seed: int,
    ) -> None:
        collector = Collector(env, self.act, settings.rollout_steps, 0, device, keep_next=True)
        super().__init__(settings, env, network, collector, device, seed)
        self.settings, self.target, self.epsilon = settings, target, 1.0
        self.target.load_state_dict(network.state_dict())

    @property
    def update_form(self) -> str:
        """That of the network."""
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
        """Actions of the largest values, or with probability `epsilon` any; of those allowed."""
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
        """A gradient step, and now and then a copy to the target network before it."""
        settings = self.settings
        if self.updates % settings.target_update_interval == 0:
            self.target.load_state_dict(self.network.state_dict())
        self.updates += 1
        networks = (self.network, self.target)
        loss, error = dqn_loss(*networks, batch, settings.gamma, settings.double)
        self.descend(loss)
        return error, {"loss": loss.detach(), "td_error": error.mean()}

    def policy(self, greedy: bool = True) -> Any:
        """The greedy policy; ValueError for another, as action values are no distribution."""
        if not greedy:
            raise ValueError("dqn learns no distribution over actions; take the greedy policy")
        return super().policy()

    def state_dict(self) -> dict[str, Any]:
        """Everything, the replay buffer and its priorities included."""
        return super().state_dict() | {"target": self.target.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take it all back."""
        super().load_state_dict(state)
        self.target.load_state_dict(state["target"])


def dqn_loss(
    network: QNetwork,
    target: QNetwork,
    batch: Batch,
    gamma: float,
    double: bool,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The squared error of temporal differences, and its size for every transition.

    Equal to TorchRL's `DQNLoss`, and tested against it; written out because nothing is made
    functional at every step then.

    Args:
        network: learns.
        target: values the next action.
        batch: "observation", "action", "reward", "next_observation", "terminated", "steps" (to the
            next observation); with prioritised replay "priority_weight", with masks
            "next_action_mask": the next action is one of those.
        gamma: discount of a step.
        double: whether `network` chooses the next action.

    Returns:
        The loss, and |error| [batch], detached.
    """
    with torch.no_grad():
        next_values = target.forward_inference(batch["next_observation"])
        chooser = network.forward_inference(batch["next_observation"]) if double else next_values
        chooser = masked(chooser, batch.get(NEXT_MASK, None))
    values = network.forward_inference(batch["observation"])
    next_action = chooser.argmax(dim=-1, keepdim=True)
    next_value = next_values.gather(-1, next_action).squeeze(-1)
    discount = gamma ** batch["steps"] * ~batch["terminated"]
    goal = batch["reward"] + discount * next_value
    error = values.gather(-1, batch["action"][:, None]).squeeze(-1) - goal
    return mean(error.square(), batch), error.detach().abs()


def network_of(settings: DQNSettings, player: Player, build: Build) -> QNetwork:
    """Action values of what the player observes, with fresh weights."""
    sizes = (player.features, player.num_actions, build.hidden(settings))
    return QNetwork(*sizes, settings.dueling, build.fused).to(build.device)


def build(settings: DQNSettings, env: VecEnv, how: Build) -> DQN:
    """The learner over its games."""
    network, target = (network_of(settings, env.player, how) for _ in range(2))
    return DQN(settings, env, network, target, how.device, how.seed)
