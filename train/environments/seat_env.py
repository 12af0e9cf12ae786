"""The base class of the environments in which the learner has seats beside other policies."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec

from pursuit.observations.masks import ACTION_MASK
from train.environments.hooks import EpisodeHook
from train.environments.lockstep import LockstepEnv


class SeatEnv(LockstepEnv):
    """An environment in which the learner controls k seats of every game, policies the others.

    Keys are those of `LockstepEnv`; "action" is [batch] int64. Where the player has masks,
    "action_mask" ([batch, actions] bool, beside each "observation") marks the allowed actions, and
    the action spec samples only these.

    Args:
        simulator: made with `auto_restart=False`.
        player: the learning agent, with the encoding of its observations.
        policies: the policy of each agent; None for the learner's agents.
        hook: configures the next episodes.
        members: k.
        scale: factor of the rewards.

    Attributes:
        seat, seats: the learner's first agent index, and all of them.
        moved: the indices of the agents that the learner moves.
        idle: [num_games, k] bool.
    """

    simulator: Any
    player: Any

    def __init__(
        self,
        simulator: Any,
        player: Any,
        policies: Sequence[Any],
        hook: EpisodeHook | None = None,
        members: int = 1,
        scale: float = 1.0,
    ) -> None:
        super().__init__(simulator, hook, members)
        self.player, self.policies, self.scale = player, list(policies), scale
        self.encoding, self.seat = player.encoding, player.number
        self.seats = self.moved = slice(self.seat, self.seat + members)
        self.idle = np.zeros((self.num_games, members), dtype=bool)
        self._actions = np.zeros((self.num_games, simulator.task.num_agents), dtype=np.int32)
        batch, actions = self.batch_size[0], player.num_actions
        self.action_spec = Categorical(actions, shape=(batch,), dtype=torch.int64)
        low, high = self._bounds()
        shape = (batch, *low.shape)
        ends = low.expand(shape), high.expand(shape)
        spec: dict[str, TensorSpec] = {"observation": Bounded(*ends, shape=shape, dtype=low.dtype)}
        if members > 1:
            spec["idle"] = Binary(n=1, shape=(batch, 1), dtype=torch.bool)
        if player.has_masks:
            spec[ACTION_MASK] = Binary(n=actions, shape=(batch, actions), dtype=torch.bool)
        self.observation_spec = Composite(spec | self._more_specs(), shape=(batch,))

    @abstractmethod
    def _bounds(self) -> tuple[torch.Tensor, torch.Tensor]:
        """The least and the largest observation [*shape], in the dtype of observations."""

    def _more_specs(self) -> dict[str, TensorSpec]:
        """The specs of further observations."""
        return {}

    def _returns(self, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        return self.simulator.returns[games, self.moved].mean(axis=1)

    def _masked(self, found: dict[str, torch.Tensor], allowed: NDArray[np.bool_]) -> None:
        """Add the mask [batch, actions] to observations, and set it in the action spec."""
        found[ACTION_MASK] = torch.from_numpy(allowed)
        self.action_spec.update_mask(found[ACTION_MASK])

    def _move(self, actions: NDArray[Any]) -> NDArray[np.float32]:
        """One step of all games with the actions [num_games, agents] of the agents `moved`: their
        rewards [num_games, agents]."""
        self.simulator.act(self.policies, self._actions)
        self._actions[:, self.moved] = actions
        self.simulator.step(self._actions)
        return self.simulator.rewards[:, self.moved]
