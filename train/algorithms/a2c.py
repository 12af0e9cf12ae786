"""Advantage actor-critic, and REINFORCE on whole episodes; both on TorchRL's losses."""

from __future__ import annotations

import math
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.objectives import A2CLoss, ReinforceLoss

from pursuit.masks import ACTION_MASK
from train.algorithms.learner import Build, Games, NetworkLearner, has_masks
from train.algorithms.rollouts import RolloutLearner, actor_critic_of
from train.networks.actor_critic import ActorCritic
from train.networks.joined_actor_critic import JoinedActorCritic, Weighing
from train.networks.losses import actor_of, critic_of
from train.settings.algorithms import A2CSettings, ReinforceSettings


class A2C(RolloutLearner):
    """Mnih et al. (2016), all games in step: one gradient step for each rollout.

    Args:
        settings: the hyperparameters; without `gae` the advantages are discounted returns less the
            value (lambda is 1), without `critic` every value is 0 and lambda is 1 too: with nothing
            to bootstrap from, lambda would only discount once more.
        env: the games.
        network: policy and value.
        device: where the network lives.
    """

    def __init__(
        self, settings: A2CSettings, env: Games, network: ActorCritic, device: str = "cpu"
    ) -> None:
        gae_lambda = settings.gae_lambda if settings.gae and settings.critic else 1.0
        super().__init__(settings, env, network, device, gae_lambda, settings.critic)
        self.settings = settings
        self.loss = A2CLoss(
            actor_of(network, has_masks(env)),
            critic_of(network),
            entropy_coeff=settings.entropy_coef,
            critic_coeff=settings.value_coef,
            loss_critic_type="l2",
        )

    def iterate(self, progress: float) -> dict[str, float]:
        """Collect one rollout and take one gradient step."""
        self.set_schedules(progress)
        entropy_coef = self.annealed(self.settings.entropy_coef, progress)
        if self.joined is not None and type(self) is A2C:  # another may have another loss
            return self._learn_joined(self.joined, entropy_coef)
        frames = self.collect()
        hidden, value_hidden, frames = self.network.through(frames)
        frames["policy_hidden"], frames["value_hidden"] = hidden, value_hidden
        if self.settings.standardize_advantages:
            advantage = frames["advantage"]
            frames["advantage"] = (advantage - advantage.mean()) / advantage.std().clamp(min=1e-6)
        self.loss.entropy_coeff.fill_(entropy_coef)
        losses = self.loss(frames)
        total = losses["loss_objective"]
        if self.settings.entropy_coef:  # without a bonus TorchRL leaves it out
            total = total + losses["loss_entropy"]
        if self.settings.critic:
            total = total + losses["loss_critic"]
        self.descend(total)
        return {
            name: float(losses[name].detach())
            for name in ("loss_objective", "loss_critic", "entropy")
            if name in losses.keys()  # noqa: SIM118 (a TensorDict's `in` wants .keys())
        }

    def _learn_joined(self, network: JoinedActorCritic, entropy_coef: float) -> dict[str, float]:
        """The same: where a policy is the one that played, ratios are 1, and PPO's gradient is
        that of A2C."""
        settings = self.settings
        weighing = Weighing(
            math.inf, settings.value_coef, entropy_coef, settings.standardize_advantages
        )
        found = network.set_gradients(self.collect_joined(), weighing)
        self.descend_by_gradients()
        return {
            "loss_objective": -float(found["log_prob_gain"]),
            "loss_critic": float(found["loss_critic"]),
            "entropy": float(found["entropy"]),
        }


class Reinforce(NetworkLearner):
    """Williams (1992): every iteration plays one whole episode in every game.

    An episode that runs out of time is bootstrapped by the value, where there is one; without,
    its return is that of the steps played.

    Args:
        settings: the hyperparameters.
        env: the games.
        network: policy and value.
        device: where the network lives.
    """

    network: ActorCritic

    def __init__(
        self, settings: ReinforceSettings, env: Games, network: ActorCritic, device: str = "cpu"
    ) -> None:
        super().__init__(settings, env, network, device)
        self.settings = settings
        actor = actor_of(network, has_masks(env))
        self.loss = ReinforceLoss(actor, critic_of(network), loss_critic_type="l2")
        self.loss.set_keys(action=network.form.DRAWN)

    def iterate(self, progress: float) -> dict[str, float]:
        """Play the episodes and take one gradient step on all their frames."""
        settings = self.settings
        self.set_schedules(progress)
        frames = self.play(settings.gamma_at(progress))
        frames["prepared"] = self.network.policy_trunk.prepare(frames["observation"])
        hidden, value_hidden, frames = self.network.through(frames)
        frames["policy_hidden"], frames["value_hidden"] = hidden, value_hidden
        self.frames += len(frames)
        advantage = frames["value_target"]
        if settings.baseline:
            advantage = advantage - frames["value"]
        frames["advantage"] = (advantage - advantage.mean()) / advantage.std().clamp(min=1e-6)
        losses = self.loss(frames)
        output = self.network.policy_head(frames["policy_hidden"])
        distribution = self.network.distribution(output, frames.get(ACTION_MASK, None))
        entropy = distribution.entropy().mean()
        total = losses["loss_actor"] - self.annealed(settings.entropy_coef, progress) * entropy
        if settings.baseline:
            total = total + settings.value_coef * losses["loss_value"]
        self.descend(total)
        return {
            "loss_objective": float(losses["loss_actor"].detach()),
            "loss_critic": float(losses["loss_value"].detach()),
            "entropy": float(entropy.detach()),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take them back; the next episodes begin anew."""
        super().load_state_dict(state)
        self.env.resume = False

    @torch.no_grad()
    def play(self, gamma: float) -> TensorDict:
        """One episode in every game; the frames of all of them in a row, or of a network that
        remembers a sequence for each.

        Args:
            gamma: discount of a step.

        Returns:
            "observation", what was drawn ("action", or "drawn" before tanh), "value" [frames, 1]
            and "value_target" [frames, 1], the discounted return from that frame on; "action_mask"
            [frames, actions] where masked.
        """
        env = self.env
        now, masks = env.reset(), has_masks(env)
        running = torch.arange(env.num_games)
        steps: list[tuple[torch.Tensor, ...]] = []
        kept: list[torch.Tensor] = []
        returns = torch.zeros(env.num_games, 1)
        state = torch.zeros(env.num_games, sum(self.network.sizes), device=self.device)
        actions = env.action_spec.zero()
        while len(running):
            observation = now["observation"][running].to(self.device)
            output, value, state[running] = self.network.step(observation, state[running])
            allowed = now[ACTION_MASK][running].to(self.device) if masks else None
            if allowed is not None:
                kept.append(allowed)
            distribution = self.network.distribution(output, allowed)
            drawn = distribution.draw()
            actions[running] = distribution.action(drawn).cpu()
            now = env.step_episodes(actions, running)
            reward = now["reward"][running]
            steps.append((running, observation, drawn, value, reward))
            cut = running[now["truncated"][running, 0] & ~now["terminated"][running, 0]]
            if len(cut) and self.settings.baseline:
                observation = now["observation"][cut].to(self.device)
                returns[cut] = self.network.step(observation, state[cut])[1].cpu()
            running = running[~now["done"][running, 0]]
        targets: list[torch.Tensor] = []
        for games, _, _, _, reward in reversed(steps):
            returns[games] = reward + gamma * returns[games]
            targets.append(returns[games].to(self.device))
        columns = ("observation", self.network.form.DRAWN, "value")
        stacked = {
            name: torch.cat([step[number] for step in steps])
            for number, name in enumerate(columns, start=1)
        }
        stacked["value_target"] = torch.cat(targets[::-1])
        if masks:
            stacked[ACTION_MASK] = torch.cat(kept)
        if self.network.policy_memory is None:
            return TensorDict(stacked, batch_size=[len(stacked["value"])])
        sequences = one_for_each(stacked, [step[0] for step in steps], env.num_games)
        sequences["state"] = torch.zeros_like(state)
        return sequences


def one_for_each(
    columns: dict[str, torch.Tensor], running: list[torch.Tensor], num_games: int
) -> TensorDict:
    """Frames of whole episodes as a sequence for each game, for `ActorCritic.through`.

    Args:
        columns: [frames, ...], step by step, of the games that were running in each.
        running: of every step, their numbers.
        num_games: rows.
    """
    steps = torch.cat([torch.full_like(games, step) for step, games in enumerate(running)])
    place = (torch.cat(running), steps)
    found = {}
    for name, column in columns.items():
        found[name] = column.new_zeros(num_games, len(running), *column.shape[1:])
        found[name][place] = column
    found["counts"] = torch.zeros_like(found["value"].squeeze(-1), dtype=torch.bool)
    found["counts"][place] = True
    found["fresh"] = torch.zeros_like(found["counts"])
    found["fresh"][:, 0] = True
    return TensorDict(found, batch_size=[num_games])


def build_a2c(settings: A2CSettings, env: Games, how: Build) -> A2C:
    """The learner over its games."""
    return A2C(settings, env, actor_critic_of(settings, env.player, how), how.device)


def build_reinforce(settings: ReinforceSettings, env: Games, how: Build) -> Reinforce:
    """The learner over its games."""
    return Reinforce(settings, env, actor_critic_of(settings, env.player, how), how.device)
