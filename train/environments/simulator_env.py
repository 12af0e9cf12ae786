"""A batch of games of the Simulator as a native TorchRL environment."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.data import Bounded, TensorSpec

from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import action_masks, warn_of_masks
from pursuit.simulator.simulator import Simulator
from train.environments.lockstep import StepOutcome
from train.environments.seat_env import SeatEnv
from train.networks.features import dtype_of
from train.networks.frames import FrameStack, Observations, shift
from train.networks.joint_policy import parts_of
from train.networks.policy import CRITIC, Seat


class SimulatorEnv(SeatEnv):
    """An environment in which the learner controls k agents of every game, policies the others.

    The learner's agents have consecutive indices: a single agent, or all of a role. With k = 1 and
    `Seat.joint` the learner chooses joint actions of all agents of the role, for their mean
    reward. An episode ends with its
    game, or when none of the learner's agents is active. With k > 1, a captured agent is "idle"
    ([batch, 1] bool) while others continue; its data is excluded from learning.

    Actions are masked if the player has `mask_bumps`. (Without the stay action, agents cannot wait
    then; a warning says so.)

    Arguments are those of `SeatEnv`.

    Attributes:
        frames: [batch, frame_stack, ...], the stacked observations, with frame stacking.
    """

    simulator: Simulator
    player: Seat

    def _bounds(self) -> tuple[torch.Tensor, torch.Tensor]:
        simulator, player = self.simulator, self.player
        self._world = lay_out(simulator.task.mazes).world
        agents = simulator.task.count(player.role) if player.joint else self.members
        self.moved = slice(self.seat, self.seat + agents)
        if player.mask_bumps:
            warn_of_masks(simulator.task)
        encoder = simulator.encoder(self.encoding, dtype_of(self.encoding))
        ends = [encoder.space.low, encoder.space.high]
        self.stack, self.frames = None, np.zeros(0)
        if player.frame_stack > 1:
            self.stack = FrameStack(player.seen, player.frame_stack)
            self.frames = self.stack.empty_frames(self.num_games * self.members, encoder.dtype)
            ends = [np.concatenate([ends[0]] * self.stack.count), player.features.high]
        dtype = torch.from_numpy(np.zeros(1, dtype=encoder.space.dtype)).dtype
        low, high = (torch.as_tensor(bound, dtype=dtype) for bound in ends)
        return low, high

    def _more_specs(self) -> dict[str, TensorSpec]:
        encoder = self.player.critic_encoder
        if encoder is None:
            return {}
        shape = (self.batch_size[0], *encoder.shape)
        low, high = torch.as_tensor(encoder.space.low), torch.as_tensor(encoder.space.high)
        return {CRITIC: Bounded(low.expand(shape), high.expand(shape), shape, dtype=low.dtype)}

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

    def _observe(self) -> dict[str, torch.Tensor]:
        """The observations [batch, ...] of the learner's agents, their idle flags and masks."""
        simulator = self.simulator
        encoder = simulator.encoder(self.encoding, dtype_of(self.encoding))
        seen = torch.from_numpy(self._stacked(encoder.encode(simulator.games, self.seats)))
        found = {"observation": seen.flatten(0, 1)}
        if self.members > 1:
            found["idle"] = torch.from_numpy(self.idle.reshape(-1, 1).copy())
        if self.player.critic:
            central = self.player.critic_observations(simulator.games)
            found[CRITIC] = torch.from_numpy(central).flatten(0, 1)
        if self.player.has_masks:
            task, over = simulator.task, simulator.terminated
            allowed = action_masks(simulator.games, self._world, task, self.seats, over)
            self._masked(found, allowed.reshape(-1, allowed.shape[-1]))
        return found

    def _play(self, actions: torch.Tensor) -> StepOutcome:
        """One step with the learner's actions [batch] int64."""
        simulator, joint, moves = self.simulator, self.player.joint, actions.numpy()
        if joint:
            moves = parts_of(moves, simulator.task, self.player.agent)
        rewards = self._move(moves.reshape(self.num_games, -1))
        if self.stack is not None:
            shift(self.frames)
        caught = simulator.active[:, self.moved] == 0
        if joint:
            rewards, caught = rewards.mean(axis=1, keepdims=True), caught.all(axis=1, keepdims=True)
        terminated = simulator.terminated[:, None] | caught
        truncated = simulator.truncated[:, None] & ~caught
        over = (terminated | truncated).all(axis=1)
        if self.members > 1:
            self.idle[:] = caught & ~over[:, None]
        return StepOutcome(rewards * np.float32(self.scale), terminated, truncated, over)
