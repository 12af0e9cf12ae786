"""A batch of games as a Gymnasium vector environment, for learners with a loop of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.interface import GameInterface
from pursuit.environments.types import Info, Observations, Options, Space
from pursuit.environments.vector import GameVectorEnv
from pursuit.rendering.text import TextScene, text_scene
from pursuit.rules.arrays import Array
from pursuit.simulator.batch import Batch
from train.networks.flat import FlatInputs
from train.networks.seat import Seat


class SeatInterface(GameInterface):
    """Games of any kind as the environments use them, observed by a seat as flat numbers.

    Args:
        simulator: the games, made with `auto_restart=False`.
        player: the learning agent.
        policies: of all agents in their order; None for the learner's.
    """

    def __init__(self, simulator: Batch[Any], player: Seat, policies: Sequence[Any]) -> None:
        super().__init__(simulator)
        self.player, self.policies = player, list(policies)
        self.inputs = FlatInputs(player.features)

    def observation_space(self, seat: int) -> Space:
        """Flat numbers."""
        return Box(-np.inf, np.inf, (self.inputs.size,), np.float32)

    def action_space(self, seat: int) -> Space:
        """The discrete actions of the seat."""
        return Discrete(self.player.num_actions)

    def observe(self, seat: int) -> Array:
        """[num_games, size] float32."""
        seen = self.player.observe(self.simulator, slice(seat, seat + 1))[:, 0]
        return self.inputs(torch.from_numpy(seen)).numpy()

    def scene(self, game: int) -> TextScene:
        """The game as text."""
        return text_scene(self.simulator, game, self.simulator.text(game))

    def policies_of(self, seat: int, policies: Mapping[str, Any]) -> list[Any]:
        """Those of the constructor."""
        return self.policies

    def step(self, seat: int, actions: Any) -> None:
        """As of `GameInterface`; of an arm the turns of all joints."""
        moves = self.player.moves(actions)
        if len(self.policies) == 1:
            self.simulator.step(moves.reshape(len(moves), -1))
        else:
            super().step(seat, moves)

    @property
    def active(self) -> Array | None:
        """As of `GameInterface`."""
        left = self.player.left(self.simulator, slice(0, len(self.agents)))
        return None if left is None else ~left


class LearnerVectorEnv(GameVectorEnv):
    """The games of a learner with a loop of its own, which restart in the step that ends them.

    Observations are [num_envs, size] float32 (`FlatInputs`), actions `Discrete`. What runs save and
    log of it is as of `SimulatorEnv`.

    Args:
        simulator, player, policies: as of `SeatInterface`.
        scale: factor of the rewards.
        bounded: whether the time limit ends the game, so that nothing is bootstrapped after it.

    Attributes:
        player, scale, bounded: the arguments.
        finished_returns, finished_lengths: of the episodes that ended since the lists were cleared;
            lengths count rounds.
        resume: if set, the next reset continues the current episodes.
        stack: None, as there is no frame stacking.
    """

    interface: SeatInterface
    stack = None

    def __init__(
        self,
        simulator: Batch[Any],
        player: Seat,
        policies: Sequence[Any],
        scale: float = 1.0,
        bounded: bool = False,
    ) -> None:
        games = SeatInterface(simulator, player, policies)
        super().__init__(games, player.number, {}, autoreset_mode="SAME_STEP")
        self.player, self.scale, self.bounded = player, scale, bounded
        self.finished_returns: list[NDArray[np.float64]] = []
        self.finished_lengths: list[NDArray[np.int32]] = []
        self.resume = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Options = None
    ) -> tuple[Observations, Info]:
        """As of `GameVectorEnv`, unless `resume` is set."""
        if not self.resume:
            return super().reset(seed=seed, options=options)
        self.resume, self._seeded = False, True
        return self._observe(), {}

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observations, Array, NDArray[np.bool_], NDArray[np.bool_], Info]:
        """As of `GameVectorEnv`, with scaled rewards."""
        seen, rewards, terminated, truncated, infos = super().step(actions)
        if "final_info" in infos:
            ended, last = infos["_final_info"], infos["final_info"]
            self.finished_returns.append(last["episode_return"][ended])
            rounds = -(-last["episode_length"][ended] // self.task.steps_per_round)
            self.finished_lengths.append(rounds.astype(np.int32))
        if self.bounded:
            terminated, truncated = terminated | truncated, np.zeros_like(truncated)
        return seen, rewards * np.float32(self.scale), terminated, truncated, infos
