"""Rollouts of fixed length with their advantages: what PPO and A2C learn from."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.objectives.value import GAE

from pursuit.masks import ACTION_MASK
from train.algorithms.joined_rollouts import JoinedRollouts, plays_joined
from train.algorithms.learner import Build, Games, NetworkLearner, has_masks
from train.algorithms.sequences import Act, Sequences
from train.networks.actor_critic import ActorCritic
from train.networks.distributions import DISTRIBUTION
from train.networks.joined_actor_critic import Learned, joined_actor_critic
from train.networks.policy import Player
from train.settings.algorithms import ActorCriticSettings, RolloutSettings


def actor_critic_of(settings: ActorCriticSettings, player: Player, build: Build) -> ActorCritic:
    """A policy and a value of what the player observes, with fresh weights."""
    network = ActorCritic(
        player.features,
        player.num_actions,
        build.hidden(settings),
        settings.shared,
        settings.action_std if player.continuous else None,
    )
    return network.to(build.device)


class SamplingPolicy(TensorDictModuleBase):
    """Draws actions and keeps what learning needs: the draws, their log-probabilities, the values.

    The same as a `ProbabilisticActor` over `network`, without its fixed cost of a millisecond.

    Args:
        network: policy and value.
        keep_all: keep the parameters of the distributions as well.
        masks: whether there is an "action_mask" to keep to.
    """

    def __init__(self, network: ActorCritic, keep_all: bool = False, masks: bool = False) -> None:
        super().__init__()
        self.in_keys = ["observation", ACTION_MASK][: 1 + masks]
        self.network, self.keep_all = network, keep_all
        self.out_keys = [*{"action", network.form.DRAWN}, "action_log_prob", "state_value"]
        if keep_all:
            self.out_keys.append(DISTRIBUTION)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the out_keys."""
        output, value = self.network(tensordict.get("observation"))
        distribution = self.network.distribution(output, tensordict.get(ACTION_MASK, None))
        drawn = distribution.draw()
        tensordict.set(distribution.DRAWN, drawn)
        tensordict.set("action", distribution.action(drawn))
        tensordict.set("action_log_prob", distribution.log_prob(drawn))
        tensordict.set("state_value", value)
        if self.keep_all:
            tensordict.set(DISTRIBUTION, distribution.parameters)
        return tensordict


def remembering(network: ActorCritic, keep_all: bool = False) -> Act:
    """What `SamplingPolicy` does, of a network that remembers."""

    def act(
        seen: dict[str, torch.Tensor], state: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        output, value, state = network.step(seen["observation"], state)
        distribution = network.distribution(output, seen.get(ACTION_MASK))
        drawn = distribution.draw()
        found = {
            distribution.DRAWN: drawn,
            "action": distribution.action(drawn),
            "action_log_prob": distribution.log_prob(drawn),
            "state_value": value,
        }
        if keep_all:
            found[DISTRIBUTION] = distribution.parameters
        return found, state

    return act


class RolloutLearner(NetworkLearner):
    """Collects rollouts with their advantages: by kernels of ours, where the network and the games
    are of the form that is written out, and by TorchRL's collector and its GAE elsewhere.

    Args:
        settings: the hyperparameters.
        env: the games.
        network: policy and value.
        device: where the network lives.
        gae_lambda: of the advantages; 1 makes them discounted returns less the value.
        critic: False takes every value as 0.
        keep_all: keep the parameters of the distributions that actions are drawn from.

    Attributes:
        joined: the network with draws and gradients written out, where it has that form; it is
            collected from by `collect_joined` then. None elsewhere.
    """

    network: ActorCritic

    def __init__(
        self,
        settings: RolloutSettings,
        env: Games,
        network: ActorCritic,
        device: str,
        gae_lambda: float,
        critic: bool = True,
        keep_all: bool = False,
    ) -> None:
        super().__init__(settings, env, network, device)
        self.critic, self.steps, self.gamma_at = critic, settings.rollout_steps, settings.gamma_at
        self.keys = [network.form.DRAWN, "action_log_prob", "advantage", "value_target"]
        if keep_all:
            self.keys.append(DISTRIBUTION)
        if has_masks(env):
            self.keys.append(ACTION_MASK)
        whole = type(self).collect is RolloutLearner.collect  # not a user's, which is to be called
        plain = critic and not keep_all and whole and plays_joined(env)
        self.joined = joined_actor_critic(network, device) if plain else None
        self.collector: Any
        if self.joined is not None:
            discounts = (settings.gamma, gae_lambda)
            self.collector = JoinedRollouts(env, self.joined, settings.rollout_steps, *discounts)
        elif network.policy_memory is not None:
            steps = settings.rollout_steps
            sizes = (sum(network.sizes), steps, device)
            act, value = remembering(network, keep_all), lambda *now: network.step(*now)[1]
            self.collector = Sequences(env, act, *sizes, value if critic else None)
        else:
            self.collector = Collector(
                env,
                SamplingPolicy(network, keep_all, has_masks(env)),
                frames_per_batch=settings.num_games * settings.rollout_steps,
                total_frames=-1,
                policy_device=device,
                env_device="cpu",
                storing_device=device,
                track_traj_ids=False,
                auto_register_policy_transforms=False,
            )
        self.frames_of_row = settings.rollout_steps if self.remembers else 1
        self._batches: Any = iter(self.collector) if self.joined is None else None
        self.gae = GAE(gamma=settings.gamma, lmbda=gae_lambda, value_network=None)

    def set_schedules(self, progress: float) -> None:
        """Also the discount."""
        super().set_schedules(progress)
        gamma = self.gamma_at(progress)
        self.gae.gamma.fill_(gamma)
        if self.joined is not None:
            self.collector.set_discount(gamma)

    @property
    def remembers(self) -> bool:
        """Whether the network does, so that it learns from sequences."""
        return isinstance(self.collector, Sequences)

    def collect_joined(self) -> Learned:
        """One rollout of a `joined` network: its frames in a row, less those of who was idle."""
        frames: Learned = self.collector.rollout()
        self.frames += self.collector.played
        return frames

    def collect(self) -> TensorDict:
        """One rollout of any network: what `ActorCritic.through` takes, and `keys`.

        It is its frames in a row; of a network that remembers a sequence a row, [games].
        """
        if self.joined is not None:
            return self._described(self.collect_joined())
        rollout = next(self._batches)
        self.frames += rollout.numel()
        if not self.critic:
            rollout["state_value"] = torch.zeros_like(rollout["state_value"])
        if self.remembers:
            self._take_next_values(rollout)
        else:
            self._add_next_values(rollout)
        self.gae(rollout)
        if self.env.hook.wants_advantages:
            noted = (rollout["advantage"], rollout["next", "done"])
            self.env.hook.note_advantages(*(column.squeeze(-1).cpu().numpy() for column in noted))
        if self.remembers:
            return self._sequences(rollout)
        frames = TensorDict(
            {key: rollout[key].flatten(0, 1) for key in self.keys}, batch_size=[rollout.numel()]
        )
        observations = rollout["observation"].flatten(0, 1)
        frames["prepared"] = self.network.policy_trunk.prepare(observations)
        if rollout.get("idle", None) is not None:
            return frames[~rollout["idle"].flatten()]
        return frames

    def _described(self, frames: Learned) -> TensorDict:
        """The frames of a `joined` network as those of others are."""
        columns = {
            "action": frames.action,
            "action_log_prob": frames.log_prob,
            "advantage": frames.advantage[:, None],
            "value_target": frames.target[:, None],
            "prepared": self.network.policy_trunk.prepare(frames.observation),
        }
        return TensorDict(columns, batch_size=[len(frames)])

    def _sequences(self, rollout: TensorDictBase) -> TensorDict:
        """A row for every game, with the state that it began with."""
        columns = {key: rollout[key] for key in (*self.keys, "fresh")}
        columns["prepared"] = self.network.policy_trunk.prepare(rollout["observation"])
        columns["state"] = self.collector.states[0]
        if rollout.get("idle", None) is not None:
            columns["counts"] = ~rollout["idle"].squeeze(-1)
        return TensorDict(columns, batch_size=[len(rollout)])

    def _take_next_values(self, rollout: TensorDictBase) -> None:
        """As `_add_next_values`, of those that were found with what was remembered then."""
        values = rollout["state_value"]
        after = torch.zeros_like(values)
        after[:, :-1] = values[:, 1:]
        apart = rollout["next", "truncated"].clone()
        apart[:, -1] = True
        found = rollout["value_after"] if self.critic else torch.zeros_like(values)
        rollout["next", "state_value"] = torch.where(apart, found, after)

    @torch.no_grad()
    def _add_next_values(self, rollout: TensorDictBase) -> None:
        """The values of the next observations: those of the following step, where it follows.

        Only the last step of the rollout and those that end an episode are not followed by their
        next observation; a terminated one is never bootstrapped, so its value is not needed.
        """
        values = rollout["state_value"]
        after = torch.zeros_like(values)
        after[:, :-1] = values[:, 1:]
        apart = rollout["next", "truncated"].clone()
        apart[:, -1] = ~rollout["next", "terminated"][:, -1]
        games, steps, _ = apart.nonzero(as_tuple=True)
        if len(games):
            next_observations = rollout["next", "observation"][games, steps]
            after[games, steps] = self.network(next_observations)[1] if self.critic else 0.0
        rollout["next", "state_value"] = after

    def state_dict(self) -> dict[str, Any]:
        """As any learner's, and what is remembered of the games."""
        state = super().state_dict()
        return {**state, "memory": self.collector.state_dict()} if self.remembers else state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take them back."""
        super().load_state_dict(state)
        if self.remembers:
            self.collector.load_state_dict(state["memory"])

    def close(self) -> None:
        """Stop collecting."""
        self.collector.shutdown()
