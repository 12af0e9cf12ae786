"""Deep Q-learning on TorchRL's collector and replay buffer, each extension a switch."""

from __future__ import annotations

import logging
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.postprocs import MultiStep

from curricula import linear
from pursuit.masks import ACTION_MASK
from train.algorithms.learner import Build, Games, NetworkLearner, has_masks, means
from train.algorithms.prioritized import prioritized_sampler
from train.networks.masks import masked
from train.networks.policy import Player
from train.networks.q_network import QNetwork
from train.settings.algorithms import DQNSettings
from train.tensors import Misfit, check_like, check_tensor

logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every storage it makes

NEXT_MASK = "next_action_mask"


class EpsilonGreedy(TensorDictModuleBase):
    """The action of the largest value, or with probability `epsilon` any; of those allowed."""

    out_keys: ClassVar = ["action"]

    def __init__(self, network: QNetwork, masks: bool = False) -> None:
        super().__init__()
        self.in_keys = ["observation", ACTION_MASK][: 1 + masks]
        self.network, self.epsilon = network, 1.0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action."""
        allowed = tensordict.get(ACTION_MASK, None)
        values = masked(self.network(tensordict.get("observation")), allowed)
        action = values.argmax(dim=-1)
        anyhow = torch.rand(action.shape, device=action.device) < self.epsilon
        if allowed is None:
            drawn = torch.randint_like(action, values.shape[-1])
        else:
            drawn = masked(torch.rand_like(values), allowed).argmax(dim=-1)
        return tensordict.set("action", torch.where(anyhow, drawn, action))


def dqn_loss(
    network: QNetwork, target: QNetwork, batch: TensorDictBase, gamma: float, double: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """The squared error of temporal differences, and its size for every transition.

    Equal to TorchRL's `DQNLoss`, and tested against it; written out because nothing is made
    functional at every step then, and the next observations are prepared once for both networks.

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
    trunk = network.policy_trunk
    with torch.no_grad():
        following = trunk.prepare(batch["next_observation"])
        next_values = target.policy_head(target.policy_trunk(following))
        chooser = network.policy_head(trunk(following)) if double else next_values
        chooser = masked(chooser, batch.get(NEXT_MASK, None))
    values = network(batch["observation"])
    next_action = chooser.argmax(dim=-1, keepdim=True)
    next_value = next_values.gather(-1, next_action).squeeze(-1)
    discount = gamma ** batch["steps"] * ~batch["terminated"]
    goal = batch["reward"] + discount * next_value
    error = values.gather(-1, batch["action"][:, None]).squeeze(-1) - goal
    squares = error.square()
    if "priority_weight" in batch.keys():  # noqa: SIM118 (a TensorDict's `in` wants .keys())
        # The mean over the batch by weight, as TorchRL reduces it.
        weight = batch["priority_weight"]
        return (weight * squares).sum() / weight.sum(), error.detach().abs()
    return squares.mean(), error.detach().abs()


class DQN(NetworkLearner):
    """Mnih et al. (2015), with many games in step and several gradient steps for each rollout.

    Args:
        settings: the hyperparameters.
        env: the games.
        network: action values.
        target: a second network of the same form.
        device: where both live.
        seed: of the draws from the replay buffer.
    """

    network: QNetwork

    def __init__(
        self,
        settings: DQNSettings,
        env: Games,
        network: QNetwork,
        target: QNetwork,
        device: str,
        seed: int,
    ) -> None:
        super().__init__(settings, env, network, device)
        self.settings, self.target, self.updates = settings, target, 0
        self.target.load_state_dict(network.state_dict())
        self.masks = has_masks(env)
        self.explorer = EpsilonGreedy(network, self.masks)
        self.multi_step = MultiStep(settings.gamma, settings.n_steps)
        self.generator = torch.Generator().manual_seed(seed)
        self.replay = TensorDictReplayBuffer(
            storage=LazyTensorStorage(settings.buffer_size),
            batch_size=settings.batch_size,
            priority_key="td_error",
            generator=self.generator,
            **({"sampler": _sampler(settings)} if settings.prioritized else {}),
        )
        self.collector = Collector(
            env,
            self.explorer,
            frames_per_batch=settings.num_games * settings.rollout_steps,
            total_frames=-1,
            policy_device=device,
            env_device="cpu",
            storing_device="cpu",
            track_traj_ids=False,
            auto_register_policy_transforms=False,
        )
        self._batches = iter(self.collector)

    def iterate(self, progress: float) -> dict[str, float]:
        """Play one rollout into the buffer, and take `gradient_steps` from it."""
        settings = self.settings
        self.set_learning_rate(progress)
        explored = min(progress / max(settings.exploration_share, 1e-9), 1.0)
        self.explorer.epsilon = linear(settings.epsilon_start, settings.epsilon_end, explored)
        if settings.prioritized:  # Schaul et al. (2016), section 3.4
            ends = settings.importance_exponent, settings.importance_exponent_end
            self.replay.sampler.beta = linear(*ends, progress)
        self.remember(next(self._batches))
        if self.frames < settings.learning_starts or len(self.replay) < settings.batch_size:
            return {"epsilon": self.explorer.epsilon}
        logged: list[dict[str, torch.Tensor]] = []
        for _ in range(settings.gradient_steps):
            if self.updates % settings.target_update_interval == 0:
                self.target.load_state_dict(self.network.state_dict())
            self.updates += 1
            batch = self.replay.sample()
            loss, error = dqn_loss(
                self.network,
                self.target,
                batch.to(self.device),
                settings.gamma,
                settings.double,
            )
            self.descend(loss)
            if settings.prioritized:
                self.replay.update_priority(batch["index"], error.cpu())
            logged.append({"loss": loss.detach(), "td_error": error.mean()})
        return {"epsilon": self.explorer.epsilon, **means(logged)}

    def remember(self, rollout: TensorDictBase) -> None:
        """Put the transitions of a rollout [games, steps] into the buffer, n steps in one."""
        self.frames += rollout.numel()
        terminated = rollout["next", "terminated"].squeeze(-1)
        steps = torch.ones(rollout.shape, dtype=torch.int64)
        if self.settings.n_steps > 1:
            rollout = self.multi_step(rollout)
            steps = rollout["steps_to_next_obs"]
            # MultiStep moves rewards and observations, but leaves the flags of the first step: an
            # episode that ended at the second or third would be bootstrapped beyond its end.
            terminated = terminated.gather(1, torch.arange(rollout.shape[1]) + steps - 1)
        transitions = {
            "observation": rollout["observation"].flatten(0, 1),
            "action": rollout["action"].flatten(),
            "reward": rollout["next", "reward"].flatten(),
            "next_observation": rollout["next", "observation"].flatten(0, 1),
            "terminated": terminated.flatten(),
            "steps": steps.flatten(),
        }
        if self.masks:
            transitions[NEXT_MASK] = rollout["next", ACTION_MASK].flatten(0, 1)
        self.replay.extend(TensorDict(transitions, batch_size=[rollout.numel()]))

    def policy(self, greedy: bool = True) -> Any:
        """The greedy policy; ValueError for another, as action values are no distribution."""
        if not greedy:
            raise ValueError("dqn learns no distribution over actions; take the greedy policy")
        return super().policy()

    def state_dict(self) -> dict[str, Any]:
        """Everything, the replay buffer and its priorities included."""
        replay, state = self.replay, super().state_dict()
        state |= {
            "target": self.target.state_dict(),
            "updates": self.updates,
            "replay": dict(replay[:].exclude("index").items()) if len(replay) else {},
            "cursor": int(replay.writer._cursor),
            "generator": self.generator.get_state(),
        }
        if self.settings.prioritized:
            sampler = replay.sampler
            indices = torch.arange(len(replay))
            priority = sampler._max_priority[0]
            state["priorities"] = {
                "sum": sampler._sum_tree[indices],
                "min": sampler._min_tree[indices],
                "largest": None if priority is None else float(priority),
            }
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take it all back."""
        super().load_state_dict(state)
        self._check_replay(state)
        self.target.load_state_dict(state["target"])
        self.updates = state["updates"]
        count = len(state["replay"].get("action", ()))
        if count:
            self.replay.extend(TensorDict(state["replay"], batch_size=[count]))
            self.replay.writer._cursor = state["cursor"]
        self.generator.set_state(state["generator"])
        if self.settings.prioritized and count:
            sampler, saved = self.replay.sampler, state["priorities"]
            indices = torch.arange(count)
            sampler._sum_tree[indices] = saved["sum"]
            sampler._min_tree[indices] = saved["min"]
            if saved["largest"] is not None:
                sampler._max_priority = (torch.tensor(saved["largest"]), None)

    def _check_replay(self, state: dict[str, Any]) -> None:
        """Raise Misfit unless what was saved of the buffer fits it; an empty one is not there."""
        saved, where = state["replay"], "learner.replay"
        if not saved:
            return
        seen = self.env.observation_spec["observation"]
        observation = torch.zeros((0, *seen.shape[1:]), dtype=seen.dtype)
        whole = torch.zeros(0, dtype=torch.int64)
        form = {
            "observation": observation,
            "action": whole,
            "reward": torch.zeros(0),
            "next_observation": observation,
            "terminated": torch.zeros(0, dtype=torch.bool),
            "steps": whole,
        }
        check_like(saved, form, where)
        seen_as = self.env.player.features
        if seen_as.kind == "index":  # rows of a table: another number would be none
            for name in ("observation", "next_observation"):
                high = torch.from_numpy(seen_as.high)
                if not ((saved[name] >= 0) & (saved[name] <= high)).all():
                    raise Misfit(f"{where}.{name}: rows of the first layer needed")
        counts = {len(column) for column in saved.values()}
        actions, most = saved["action"], self.settings.buffer_size
        if (
            len(counts) > 1
            or not 0 < counts.pop() <= most
            or not 0 <= state["cursor"] < most
            or not ((actions >= 0) & (actions < self.env.player.num_actions)).all()
        ):
            raise Misfit(f"{where}: as many rows in every column needed, of actions that there are")
        if self.settings.prioritized:
            for name in ("sum", "min"):
                shape = (len(actions),)
                check_tensor(state["priorities"][name], torch.float32, shape, f"{where}.{name}")

    def close(self) -> None:
        """Stop collecting."""
        self.collector.shutdown()


def _sampler(settings: DQNSettings) -> Any:
    exponents = (settings.priority_exponent, settings.importance_exponent)
    return prioritized_sampler(settings.buffer_size, *exponents)


def network_of(settings: DQNSettings, player: Player, build: Build) -> QNetwork:
    """Action values of what the player observes, with fresh weights."""
    sizes = (player.features, player.num_actions, build.hidden(settings))
    return QNetwork(*sizes, settings.dueling).to(build.device)


def build(settings: DQNSettings, env: Games, how: Build) -> DQN:
    """The learner over its games."""
    network, target = (network_of(settings, env.player, how) for _ in range(2))
    return DQN(settings, env, network, target, how.device, how.seed)
