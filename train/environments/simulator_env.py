"""A batch of games of the Simulator as a native TorchRL environment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec

from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import ACTION_MASK, action_masks, warn_of_masks
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from train.environments.hooks import EpisodeHook
from train.environments.lockstep import LockstepEnv, StepOutcome
from train.networks.frames import FrameStack, Observations, shift
from train.networks.policy import Seat


class SimulatorEnv(LockstepEnv):
    """An environment in which the learner controls k agents of every game, policies the others.

    The learner's agents have consecutive indices: a single agent, or all of a role, which then
    learn with shared parameters (independent PPO; de Witt et al., 2020).
    Keys are those of `LockstepEnv`; "action" is [batch] int64. An episode ends with its game, or
    when none of the learner's agents is active. With k > 1, a captured agent is "idle" ([batch, 1]
    bool) while others continue; its data is excluded from learning.

    If the player has `mask_bumps`, "action_mask" ([batch, actions] bool, beside each "observation")
    marks the allowed actions, and the action spec samples only these. (Without the stay action,
    agents cannot wait then; a warning says so.)

    Args:
        simulator: made with `auto_restart=False`.
        player: the learning agent, with the encoding of its observations.
        policies: the policy of each agent; None for the learner's agents.
        hook: configures the next episodes.
        members: k.
        scale: factor of the rewards.

    Attributes:
        seat, seats: the learner's first agent index, and all of them.
        idle: [num_games, k] bool.
        frames: [batch, frame_stack, ...], the stacked observations, with frame stacking.
    """

    simulator: Simulator
    player: Seat

    def __init__(
        self,
        simulator: Simulator,
        player: Seat,
        policies: Sequence[Policy | None],
        hook: EpisodeHook | None = None,
        members: int = 1,
        scale: float = 1.0,
    ) -> None:
        super().__init__(simulator, hook, members)
        self.scale = scale
        batch = self.batch_size[0]
        self.player, self.policies, self.encoding = player, list(policies), player.encoding
        self.seat = player.number
        self.seats = slice(self.seat, self.seat + members)
        self.idle = np.zeros((self.num_games, members), dtype=bool)
        self._actions = np.zeros((self.num_games, simulator.num_agents), dtype=np.int32)
        self._world = lay_out(simulator.task.mazes).world
        if player.mask_bumps:
            warn_of_masks(simulator.task)
        self.action_spec = Categorical(player.num_actions, shape=(batch,), dtype=torch.int64)
        self.stack, self.frames = None, np.zeros(0)
        if player.frame_stack > 1:
            self.stack = FrameStack(player.seen, player.frame_stack)
            dtype = simulator.encoder(self.encoding).dtype
            self.frames = self.stack.empty_frames(self.num_games * members, dtype)
        self._specify_observation()

    def _specify_observation(self) -> None:
        batch, space = self.batch_size[0], self.simulator.encoder(self.encoding).space
        dtype = torch.from_numpy(np.zeros(1, dtype=space.dtype)).dtype
        ends = [space.low, space.high]
        if self.stack is not None:
            one = np.concatenate([ends[0]] * self.stack.count)
            ends = [one, self.player.features.high]
        shape = (batch, *ends[0].shape)
        low, high = (torch.as_tensor(bound, dtype=dtype).expand(shape) for bound in ends)
        spec: dict[str, TensorSpec] = {"observation": Bounded(low, high, shape=shape, dtype=dtype)}
        if self.members > 1:
            spec["idle"] = Binary(n=1, shape=(batch, 1), dtype=torch.bool)
        if self.player.has_masks:
            actions = self.player.num_actions
            spec[ACTION_MASK] = Binary(n=actions, shape=(batch, actions), dtype=torch.bool)
        self.observation_spec = Composite(spec, shape=(batch,))

    def _restarted(self, games: NDArray[np.intp]) -> None:
        self.idle[games] = False
        if self.stack is not None:
            rows = self.frames.reshape(self.num_games, self.members, *self.frames.shape[1:])
            self.stack.forget(rows, games)

    def _stacked(self, seen: Observations) -> Observations:
        """[games, k, *shape]: the current observations, stacked with the previous ones."""
        if self.stack is None:
            return seen
        flat = self.stack.with_newest(self.frames, seen.reshape(-1, *seen.shape[2:]))
        return flat.reshape(*seen.shape[:2], *flat.shape[1:])

    def _returns(self, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        returns = self.simulator.returns[games, self.seats]
        return returns.mean(axis=1) if self.members > 1 else returns[:, 0]

    def _observe(self) -> dict[str, torch.Tensor]:
        """The observations [batch, ...] of the learner's agents, their idle flags and masks."""
        simulator = self.simulator
        encoder = simulator.encoder(self.encoding)
        seen = torch.from_numpy(self._stacked(encoder.encode(simulator.games, self.seats)))
        found = {"observation": seen.flatten(0, 1)}
        if self.members > 1:
            found["idle"] = torch.from_numpy(self.idle.reshape(-1, 1).copy())
        if self.player.has_masks:
            task, over = simulator.task, simulator.terminated
            allowed = action_masks(simulator.games, self._world, task, self.seats, over)
            found[ACTION_MASK] = torch.from_numpy(allowed).flatten(0, 1)
            self.action_spec.update_mask(found[ACTION_MASK])
        return found

    def _play(self, actions: torch.Tensor) -> StepOutcome:
        """One step with the learner's actions [batch] int64."""
        simulator = self.simulator
        simulator.act(self.policies, self._actions)
        self._actions[:, self.seats] = actions.numpy().reshape(-1, self.members)
        simulator.step(self._actions)
        if self.stack is not None:
            shift(self.frames)
        caught = simulator.active[:, self.seats] == 0
        terminated = simulator.terminated[:, None] | caught
        truncated = simulator.truncated[:, None] & ~caught
        over = (terminated | truncated).all(axis=1)
        if self.members > 1:
            self.idle[:] = caught & ~over[:, None]
        rewards = simulator.rewards[:, self.seats] * np.float32(self.scale)
        return StepOutcome(rewards, terminated, truncated, over)
