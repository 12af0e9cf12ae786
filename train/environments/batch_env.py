"""A batch of games for learners, as tensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.observations.masks import ACTION_MASK
from pursuit.rules.arrays import Array
from pursuit.simulator.batch import Batch
from pursuit.validation import check
from train.environments.hooks import EpisodeHook
from train.networks.frames import FrameStack, Observations, shift
from train.networks.policy import CRITIC

FLAGS = ("terminated", "truncated", "done")
NOT_OBSERVED = {"reward", *FLAGS}


class Expert(NamedTuple):
    """A policy that a learner imitates, and the frames of the learner until which it does."""

    policy: Any
    frames: int


class StepOutcome(NamedTuple):
    """What a step of all games gave.

    Attributes:
        rewards: [num_games, k] float32; a copy.
        terminated, truncated: [num_games, k] bool, likewise.
        over: [num_games] bool, the games that ended.
    """

    rewards: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    over: NDArray[np.bool_]


class BatchEnv:
    """A batch of games, in each of which the learner controls k agents; rows are ordered by game.

    Tensors by name: "observation" [rows, ...] and, where the player has masks, "action_mask"
    [rows, actions] bool, the allowed actions. A step takes actions ([rows] int64, or for continuous
    actions [rows, numbers] float32 in [-1, 1]), and gives "reward", "terminated", "truncated" and
    "done" [rows, 1] beside the last observation of an episode that ended; the next step starts from
    the first one of the next episode, so nothing is bootstrapped across episodes.

    The learner's agents have consecutive indices: a single agent, or all of a role. With k = 1 and
    `Seat.joint` the learner chooses joint actions of all agents of the role, for their mean reward.
    An episode ends with its game, or when none of the learner's agents is left. With k > 1, an
    agent that has left is "idle" ([rows, 1] bool) while others continue; its data is excluded from
    learning.

    Args:
        simulator: of any kind of game, made with `auto_restart=False`.
        player: the learning agent, with the encoding of its observations.
        policies: the policy of each agent; None for the learner's agents. Not needed where there
            are no others.
        hook: configures the next episodes.
        members: k.
        scale: factor of the rewards.
        bounded: whether the time limit ends the game: without discount, returns are those within
            it, so nothing is bootstrapped after it.

    Raises:
        ValueError: a simulator with `auto_restart=True`, which hides the end of an episode.

    Attributes:
        simulator, player, policies, hook, members, scale, bounded: the arguments.
        num_games: in the batch.
        rows: num_games · k.
        seat, seats: the learner's first agent index, and all of them.
        moved: the indices of the agents that the learner moves.
        idle: [num_games, k] bool.
        stack: of the observations, with frame stacking; None without.
        frames: [rows, frame_stack, ...], the stacked observations.
        finished_returns, finished_lengths: of the episodes that ended since the lists were cleared;
            lengths count rounds.
        resume: if set, the next full reset continues the current episodes.
        was_reset: whether `reset_games` was called.
        expert: the policy that the learner imitates; None for none.
    """

    expert: Expert | None = None

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
        check(
            not simulator.auto_restart,
            "this simulator restarts games automatically, which hides the end of episodes; "
            f"use {type(simulator).__name__}(..., auto_restart=False)",
        )
        games, agents = simulator.num_games, simulator.task.num_agents
        self.simulator: Any = simulator
        self.player, self.policies = player, list(policies)
        self.hook, self.members = hook or EpisodeHook(), members
        self.scale, self.bounded, self.num_games = scale, bounded, games
        self.rows = games * members
        self.seat = player.number
        self.seats = slice(self.seat, self.seat + members)
        self.moved = slice(self.seat, self.seat + (player.team_size if player.joint else members))
        self.idle = np.zeros((games, members), dtype=bool)
        alone = self.moved == slice(0, agents)
        self._actions = None if alone else np.zeros((games, agents), dtype=np.int32)
        self.finished_returns: list[NDArray[np.float64]] = []
        self.finished_lengths: list[NDArray[np.int32]] = []
        self.resume = self.was_reset = False
        self.stack, self.frames = None, np.zeros(0)
        if player.frame_stack > 1:
            self.stack = FrameStack(player.seen, player.frame_stack)
            self.frames = self.stack.empty_frames(self.rows, player.bounds(simulator)[0].dtype)

    # -- one step ----------------------------------------------------------------------------------

    def _observe(self) -> dict[str, torch.Tensor]:
        """The observations [rows, ...] of the learner's agents, their idle flags and masks."""
        simulator, player = self.simulator, self.player
        seen = self._stacked(player.observe(simulator, self.seats))
        found = {"observation": torch.from_numpy(seen).flatten(0, 1)}
        if self.members > 1:
            found["idle"] = torch.from_numpy(self.idle.reshape(-1, 1).copy())
        if player.critic:
            central = player.critic_observations(simulator)
            found[CRITIC] = torch.from_numpy(central).flatten(0, 1)
        if player.has_masks:
            allowed = player.allowed(simulator, self.seats)
            found[ACTION_MASK] = torch.from_numpy(allowed.reshape(-1, allowed.shape[-1]))
        return found

    def expert_probabilities(self) -> torch.Tensor:
        """[rows, actions] float32: what the imitated policy plays in the current states, of the
        allowed actions; uniform where it plays none of these."""
        assert self.expert is not None
        found = self.player.probabilities_of(self.expert.policy, self.simulator, self.seats)
        if self.player.has_masks:
            allowed = self.player.allowed(self.simulator, self.seats)
            found = np.where(allowed, found, 0.0)
            found = np.where(found.any(axis=-1, keepdims=True), found, allowed)
            found = found / found.sum(axis=-1, keepdims=True)
        return torch.from_numpy(found.astype(np.float32)).flatten(0, 1)

    def _stacked(self, seen: Observations) -> Observations:
        """[games, k, *shape]: the current observations, stacked with the previous ones."""
        if self.stack is None:
            return seen
        flat = self.stack.with_newest(self.frames, seen.reshape(-1, *seen.shape[2:]))
        return flat.reshape(*seen.shape[:2], *flat.shape[1:])

    def _play(self, actions: torch.Tensor) -> StepOutcome:
        """One step with the learner's actions [rows, ...]."""
        simulator, player, games = self.simulator, self.player, self.num_games
        chosen = player.moves(actions.numpy()).reshape(games, -1)
        if self._actions is not None:
            simulator.act(self.policies, self._actions)
            self._actions[:, self.moved] = chosen
            chosen = self._actions
        simulator.step(chosen)
        rewards = simulator.rewards.reshape(games, -1)[:, self.moved]
        if self.stack is not None:
            shift(self.frames)
        left = player.left(simulator, self.moved)
        if left is None:
            left = np.zeros(rewards.shape, dtype=bool)
        if player.joint:
            rewards, left = rewards.mean(axis=1, keepdims=True), left.all(axis=1, keepdims=True)
        terminated = simulator.terminated[:, None] | left
        truncated = simulator.truncated[:, None] & ~left
        if self.bounded:
            terminated, truncated = terminated | truncated, np.zeros_like(truncated)
        over = (terminated | truncated).all(axis=1)
        if self.members > 1:
            self.idle[:] = left & ~over[:, None]
        return StepOutcome(rewards * np.float32(self.scale), terminated, truncated, over)

    def _returns(self, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        """[n] the mean episode return of the learner's agents in each game of the mask."""
        returns: Array = self.simulator.returns.reshape(self.num_games, -1)
        return returns[games, self.moved].mean(axis=1)

    # -- episodes ----------------------------------------------------------------------------------

    def reset_games(self) -> None:
        """Reset all games; the first time to the first episodes of the simulator's seed.

        The simulator itself has already started these, but without the hook.
        """
        if not self.was_reset and self.simulator.last_seed is not None:
            self.simulator.seed(self.simulator.last_seed)
        self.was_reset = True
        self.restart()

    def restart(self, games: NDArray[np.bool_] | None = None) -> None:
        """Start new episodes, configured by the hook, in the games of the mask, by default all."""
        chosen = np.arange(self.num_games) if games is None else np.flatnonzero(games)
        if len(chosen):
            self.hook.before_restart(chosen)
            self.simulator.reset(games=games)
            self.idle[chosen] = False
            if self.stack is not None:
                rows = self.frames.reshape(self.num_games, self.members, *self.frames.shape[1:])
                self.stack.forget(rows, chosen)
            self.hook.after_restart(chosen)

    def finish(self, games: NDArray[np.bool_]) -> None:
        """Record the episodes in the mask [num_games], which have just ended."""
        self.finished_returns.append(self._returns(games))
        each = self.simulator.task.steps_per_round
        self.finished_lengths.append(-(-self.simulator.steps[games] // each))
        self.hook.episode_ended(games)

    def _step_games(
        self, actions: torch.Tensor, alive: NDArray[np.bool_] | None = None
    ) -> tuple[dict[str, torch.Tensor], NDArray[np.bool_]]:
        """One step with the learner's actions: all results, and the games that ended [num_games].

        Args:
            actions: [rows, ...].
            alive: [num_games], the episodes that were running before the step; None for all.
        """
        rewards, terminated, truncated, over = self._play(actions)
        ending = over if alive is None else over & alive
        if ending.any():
            self.finish(ending)
        flags = dict(zip(FLAGS, (terminated, truncated, terminated | truncated), strict=True))
        after = {
            **self._observe(),
            "reward": torch.from_numpy(rewards.reshape(-1, 1)),
            **{name: torch.from_numpy(flag.reshape(-1, 1)) for name, flag in flags.items()},
        }
        return after, over

    def reset(self) -> Any:
        """Reset all games, or continue them with `resume`; returns the observations."""
        if not self.resume:
            self.reset_games()
        self.resume = False
        return self._observe()

    def step_episodes(
        self, actions: torch.Tensor, running: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        """A step without restarts, for learning from whole episodes; one agent per game.

        Args:
            actions: [num_games, ...]; those of games that have ended are ignored.
            running: [n] int64, the running games.

        Returns:
            The results of the step for all games.
        """
        alive = np.zeros(self.num_games, dtype=bool)
        alive[running.numpy()] = True
        return self._step_games(actions, alive)[0]

    def step_tensors(
        self, actions: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """A step; then the next episode starts in each game that has ended.

        Args:
            actions: [rows, ...].

        Returns:
            The results of the step, and the observations for the next step. After the end of an
            episode the latter is the first one of the next episode. They may share tensors.
        """
        after, over = self._step_games(actions)
        if over.any():
            self.restart(over)
            return after, self._observe()
        return after, {name: seen for name, seen in after.items() if name not in NOT_OBSERVED}
