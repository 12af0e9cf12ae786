"""What the learners that replay share: collecting, the buffer with its checkpoint, and rounds."""

from __future__ import annotations

import logging
from typing import Any, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.postprocs import MultiStep

from curricula import linear
from pursuit.masks import ACTION_MASK
from train.algorithms.learner import Games, NetworkLearner, has_masks, means
from train.algorithms.prioritized import prioritized_sampler
from train.networks.policy import Network
from train.settings.off_policy import ReplaySettings
from train.tensors import Misfit, check_like, check_tensor

logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every storage it makes

NEXT_MASK = "next_action_mask"


class Rollouts(Protocol):
    """Plays on from where the last rollout ended, for ever."""

    def __iter__(self) -> Any:
        """Rollouts, TensorDicts [games, steps]."""

    def shutdown(self) -> None:
        """Stop."""


def collector_of(
    settings: ReplaySettings, env: Games, explorer: TensorDictModuleBase, device: str
) -> Collector:
    """TorchRL's collector of rollouts [games, rollout_steps]."""
    return Collector(
        env,
        explorer,
        frames_per_batch=settings.num_games * settings.rollout_steps,
        total_frames=-1,
        policy_device=device,
        env_device="cpu",
        storing_device="cpu",
        track_traj_ids=False,
        auto_register_policy_transforms=False,
    )


class OffPolicyLearner(NetworkLearner):
    """Rounds of a rollout into the replay buffer and `gradient_steps` from it.

    A learner says how it explores (`explore`) and what a gradient step is (`learn`).

    Args:
        settings: the hyperparameters.
        env: the games.
        network: what acts.
        collector: plays the games.
        device: where the networks live.
        seed: of the draws from the replay buffer.
        per_row: transitions in a row of the buffer, where it holds sequences.
    """

    def __init__(
        self,
        settings: ReplaySettings,
        env: Games,
        network: Network,
        collector: Rollouts,
        device: str,
        seed: int,
        per_row: int = 1,
    ) -> None:
        super().__init__(settings, env, network, device)
        self.rows, self.batch = (
            size // per_row for size in (settings.buffer_size, settings.batch_size)
        )
        self.replayed, self.updates = settings, 0
        self.masks, self.collector = has_masks(env), collector
        self.multi_step = MultiStep(settings.gamma, settings.n_steps)
        self.generator = torch.Generator().manual_seed(seed)
        self.replay = TensorDictReplayBuffer(
            storage=LazyTensorStorage(self.rows),
            batch_size=self.batch,
            priority_key="td_error",
            generator=self.generator,
            **({"sampler": self._sampler()} if settings.prioritized else {}),
        )
        self._batches = iter(self.collector)

    @property
    def learning(self) -> bool:
        """Whether there is enough in the buffer to learn from."""
        enough = len(self.replay) >= self.batch
        return enough and self.frames >= self.replayed.learning_starts

    def explore(self, progress: float) -> dict[str, float]:
        """Settle how the next rollout explores; figures for the log."""
        raise NotImplementedError

    def learn(self, batch: TensorDictBase) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """A gradient step: the sizes of errors [batch], detached, and figures for the log."""
        raise NotImplementedError

    def iterate(self, progress: float) -> dict[str, float]:
        """Play one rollout into the buffer, and take `gradient_steps` from it."""
        settings = self.replayed
        self.set_learning_rate(progress)
        figures = self.explore(progress)
        if settings.prioritized:  # Schaul et al. (2016), section 3.4
            ends = settings.importance_exponent, settings.importance_exponent_end
            self.replay.sampler.beta = linear(*ends, progress)
        self.remember(next(self._batches))
        if not self.learning:
            return figures
        logged: list[dict[str, torch.Tensor]] = []
        for _ in range(settings.gradient_steps):
            batch = self.sample()
            error, found = self.learn(batch)
            if settings.prioritized:
                self.replay.update_priority(batch["index"].cpu(), error.cpu())
            logged.append(found)
        return {**figures, **means(logged)}

    def sample(self) -> Any:
        """A minibatch from the buffer where the networks live: a TensorDict, or a plain one."""
        settings = self.replayed
        if settings.prioritized:
            return self.replay.sample().to(self.device)
        # What TorchRL's uniform sampler draws, without its fixed cost of a third of a millisecond.
        storage = self.replay.storage
        index = torch.randint(0, len(storage), (self.batch,), generator=self.generator)
        columns = {name: rows.index_select(0, index) for name, rows in storage._storage.items()}
        # On the CPU a TensorDict would be made for nothing, eight times a rollout.
        cpu = self.device == "cpu"
        return columns if cpu else TensorDict(columns, [self.batch]).to(self.device)

    def remember(self, rollout: TensorDictBase) -> None:
        """Put the transitions of a rollout [games, steps] into the buffer, n steps in one."""
        self.frames += rollout.numel()
        terminated = rollout["next", "terminated"].squeeze(-1)
        steps = torch.ones(rollout.shape, dtype=torch.int64)
        if self.replayed.n_steps > 1:
            rollout = self.multi_step(rollout)
            steps = rollout["steps_to_next_obs"]
            # MultiStep moves rewards and observations, but leaves the flags of the first step: an
            # episode that ended at the second or third would be bootstrapped beyond its end.
            terminated = terminated.gather(1, torch.arange(rollout.shape[1]) + steps - 1)
        transitions = {
            "observation": rollout["observation"].flatten(0, 1),
            "action": rollout["action"].flatten(0, 1),
            "reward": rollout["next", "reward"].flatten(),
            "next_observation": rollout["next", "observation"].flatten(0, 1),
            "terminated": terminated.flatten(),
            "steps": steps.flatten(),
        }
        if self.masks:
            transitions[NEXT_MASK] = rollout["next", ACTION_MASK].flatten(0, 1)
        self.replay.extend(TensorDict(transitions, batch_size=[rollout.numel()]))

    def state_dict(self) -> dict[str, Any]:
        """Everything, the replay buffer and its priorities included."""
        replay, state = self.replay, super().state_dict()
        state |= {
            "updates": self.updates,
            "replay": dict(replay[:].exclude("index").items()) if len(replay) else {},
            "cursor": int(replay.writer._cursor),
            "generator": self.generator.get_state(),
        }
        if self.replayed.prioritized:
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
        self.updates = state["updates"]
        count = len(state["replay"].get("action", ()))
        if count:
            self.replay.extend(TensorDict(state["replay"], batch_size=[count]))
            self.replay.writer._cursor = state["cursor"]
        self.generator.set_state(state["generator"])
        if self.replayed.prioritized and count:
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
        player, form = self.env.player, self._row()
        check_like(saved, {name: one[None][:0] for name, one in form.items()}, where)
        if player.features.kind == "index":  # rows of a table: another number would be none
            for name in (name for name in form if name.endswith("observation")):
                high = torch.from_numpy(player.features.high)
                if not ((saved[name] >= 0) & (saved[name] <= high)).all():
                    raise Misfit(f"{where}.{name}: rows of the first layer needed")
        counts = {len(column) for column in saved.values()}
        actions, most = saved["action"], self.rows
        bounds = (-1, 1) if player.continuous else (0, player.num_actions - 1)
        if (
            len(counts) > 1
            or not 0 < counts.pop() <= most
            or not 0 <= state["cursor"] < most
            or not ((actions >= bounds[0]) & (actions <= bounds[1])).all()
        ):
            raise Misfit(f"{where}: as many rows in every column needed, of actions that there are")
        if self.replayed.prioritized:
            for name in ("sum", "min"):
                shape = (len(actions),)
                check_tensor(state["priorities"][name], torch.float32, shape, f"{where}.{name}")

    def _row(self) -> dict[str, torch.Tensor]:
        """A row of the buffer, empty."""
        player = self.env.player
        seen = self.env.observation_spec["observation"]
        observation = torch.zeros(seen.shape[1:], dtype=seen.dtype)
        whole = torch.zeros((), dtype=torch.int64)
        form: dict[str, torch.Tensor] = {
            "observation": observation,
            "action": torch.zeros(player.num_actions) if player.continuous else whole,
            "reward": torch.zeros(()),
            "next_observation": observation,
            "terminated": torch.zeros((), dtype=torch.bool),
            "steps": whole,
        }
        if self.masks:
            form[NEXT_MASK] = torch.zeros(player.num_actions, dtype=torch.bool)
        return form

    def close(self) -> None:
        """Stop collecting."""
        self.collector.shutdown()

    def _sampler(self) -> Any:
        settings = self.replayed
        exponents = (settings.priority_exponent, settings.importance_exponent)
        return prioritized_sampler(self.rows, *exponents)
