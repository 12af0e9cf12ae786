"""A batch of games as a native TorchRL environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from pursuit.observations.masks import ACTION_MASK
from pursuit.rules.arrays import Array
from pursuit.simulator.batch import Batch
from train.environments.batch_env import FLAGS, BatchEnv
from train.environments.hooks import EpisodeHook
from train.networks.policy import CRITIC


class SimulatorEnv(EnvBase, BatchEnv):
    """A `BatchEnv` with the interface of TorchRL; its batch are the rows.

    Keys: those of `BatchEnv`, and "action". The action spec samples only actions that masks allow.
    After a step, "next" holds the last observation of an episode that ended. The partial reset that
    follows starts the next episode.

    Args:
        simulator, player, policies, hook, members, scale, bounded: as of `BatchEnv`.
    """

    def __init__(
        self,
        simulator: Batch[Any],
        player: Any,
        policies: Sequence[Any] = (),
        hook: EpisodeHook | None = None,
        members: int = 1,
        scale: float = 1.0,
        bounded: bool = False,
    ) -> None:
        batch = simulator.num_games * members
        EnvBase.__init__(self, device="cpu", batch_size=[batch])
        BatchEnv.__init__(self, simulator, player, policies, hook, members, scale, bounded)
        self.reward_spec = Unbounded((batch, 1))
        flag = Binary(n=1, shape=(batch, 1), dtype=torch.bool)
        self.full_done_spec = Composite({key: flag.clone() for key in FLAGS}, shape=(batch,))
        if player.continuous:
            own = (batch, player.num_actions)
            self.action_spec = Bounded(-1.0, 1.0, shape=own, dtype=torch.float32)
        else:
            self.action_spec = Categorical(player.num_actions, shape=(batch,), dtype=torch.int64)
        self.observation_spec = Composite(self._observed_specs(batch), shape=(batch,))

    def _observed_specs(self, batch: int) -> dict[str, TensorSpec]:
        """The specs of observations, of idle agents and of masks."""
        player = self.player
        low, high = player.bounds(self.simulator)
        if self.stack is not None:
            low = np.concatenate([low] * self.stack.count)
            high = player.features.high.astype(low.dtype)
        specs: dict[str, TensorSpec] = {"observation": _bounded(batch, low, high)}
        if self.members > 1:
            specs["idle"] = Binary(n=1, shape=(batch, 1), dtype=torch.bool)
        if player.has_masks:
            shape = (batch, player.num_actions)
            specs[ACTION_MASK] = Binary(n=player.num_actions, shape=shape, dtype=torch.bool)
        if player.critic:
            specs[CRITIC] = _bounded(batch, *player.critic_bounds(self.simulator))
        return specs

    def _observe(self) -> dict[str, torch.Tensor]:
        found = super()._observe()
        if ACTION_MASK in found:
            self.action_spec.update_mask(found[ACTION_MASK])
        return found

    def _batch(self, content: dict[str, torch.Tensor]) -> TensorDictBase:
        return TensorDict(content, batch_size=self.batch_size, device=self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            self.restart(tensordict["_reset"].view(-1, self.members).all(dim=1).numpy())
            self.resume = False
            return self._batch(self._observe())
        return self._batch(BatchEnv.reset(self))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._batch(self._step_games(tensordict["action"])[0])

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """As `EnvBase.step_and_maybe_reset`, four times as fast.

        It omits the checks and copies of the general partial reset; a test compares both.
        """
        after, seen = self.step_tensors(tensordict["action"])
        running = torch.zeros_like(after["done"])
        following = self._batch({**seen, **{name: running.clone() for name in FLAGS}})
        return tensordict.set("next", self._batch(after)), following

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.simulator.seed(seed)


def _bounded(batch: int, low: Array, high: Array) -> TensorSpec:
    """The spec of observations [batch, *shape] between these."""
    shape = (batch, *low.shape)
    ends = (torch.as_tensor(end).expand(shape) for end in (low, high))
    return Bounded(*ends, shape=shape, dtype=torch.from_numpy(np.zeros(1, low.dtype)).dtype)
