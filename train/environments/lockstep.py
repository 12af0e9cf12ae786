"""The base class of the TorchRL environments over all simulators."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.simulator.simulator import Simulator
from scripted_agents.games.simulator import GameSimulator
from train.environments.hooks import EpisodeHook
from train.networks.policy import Player

AnySimulator = Simulator | ReacherSimulator | GameSimulator
FLAGS = ("terminated", "truncated", "done")
NOT_OBSERVED = {"reward", *FLAGS}


class StepOutcome(NamedTuple):
    """What a step of all games gave.

    Attributes:
        rewards: [batch] float32, in any shape; a copy.
        terminated, truncated: [batch] bool, likewise.
        over: [num_games] bool, the games that ended.
    """

    rewards: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    over: NDArray[np.bool_]


class LockstepEnv(EnvBase):
    """A batch of games, in each of which the learner controls k agents; ordered by game.

    Keys: "observation" [batch, ...], "action" [batch, ...], "reward", "terminated", "truncated" and
    "done" [batch, 1]. After a step, "next" holds the last observation of an episode that ended. The
    partial reset that follows starts the next episode, so nothing is bootstrapped across episodes.

    Subclasses implement observations (`_observe`), steps (`_play`) and episode returns
    (`_returns`), and define the specs of observations and actions.

    Args:
        simulator: made with `auto_restart=False`.
        hook: configures the next episodes.
        members: k.

    Raises:
        ValueError: a simulator with `auto_restart=True`, which hides the end of an episode.

    Attributes:
        simulator, hook, members: the arguments.
        num_games: in the batch.
        finished_returns, finished_lengths: of the episodes that ended since the lists were cleared;
            lengths count rounds.
        resume: if set, the next full reset continues the current episodes.
        was_reset: whether `reset_games` was called.
    """

    simulator: AnySimulator
    player: Player

    def __init__(
        self, simulator: AnySimulator, hook: EpisodeHook | None = None, members: int = 1
    ) -> None:
        if simulator.auto_restart:
            raise ValueError(
                "this simulator restarts games automatically, which hides the end of episodes; "
                f"use {type(simulator).__name__}(..., auto_restart=False)"
            )
        batch = simulator.num_games * members
        super().__init__(device="cpu", batch_size=[batch])
        self.simulator, self.hook, self.members = simulator, hook or EpisodeHook(), members
        self.num_games = simulator.num_games
        self.finished_returns: list[NDArray[np.float64]] = []
        self.finished_lengths: list[NDArray[np.int32]] = []
        self.resume = self.was_reset = False
        self.reward_spec = Unbounded((batch, 1))
        flag = Binary(n=1, shape=(batch, 1), dtype=torch.bool)
        self.full_done_spec = Composite({key: flag.clone() for key in FLAGS}, shape=(batch,))

    # -- implemented by subclasses ---------------------------------------------------------------

    @abstractmethod
    def _observe(self) -> dict[str, torch.Tensor]:
        """The observations of the learner's agents, "observation" [batch, ...], and any masks."""

    @abstractmethod
    def _play(self, actions: torch.Tensor) -> StepOutcome:
        """One step with the learner's actions [batch, ...]."""

    @abstractmethod
    def _returns(self, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        """[n] the episode return in each game of the mask [num_games]."""

    def _restarted(self, games: NDArray[np.intp]) -> None:
        """Called after new episodes have started in `games` [n]."""

    # -- episodes and steps ----------------------------------------------------------------------

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
            self._restarted(chosen)
            self.hook.after_restart(chosen)

    def finish(self, games: NDArray[np.bool_]) -> None:
        """Record the episodes in the mask [num_games], which have just ended."""
        self.finished_returns.append(self._returns(games))
        each = self.simulator.task.steps_per_round
        self.finished_lengths.append(-(-self.simulator.steps[games] // each))
        self.hook.episode_ended(games)

    def _batch(self, content: dict[str, torch.Tensor]) -> TensorDictBase:
        return TensorDict(content, batch_size=self.batch_size, device=self.device)

    def _step_games(
        self, actions: torch.Tensor, alive: NDArray[np.bool_] | None = None
    ) -> tuple[dict[str, torch.Tensor], NDArray[np.bool_]]:
        """One step with the learner's actions: all results, and the games that ended [num_games].

        Args:
            actions: [batch, ...].
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

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            self.restart(tensordict["_reset"].view(-1, self.members).all(dim=1).numpy())
        elif not self.resume:
            self.reset_games()
        self.resume = False
        return self._batch(self._observe())

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._batch(self._step_games(tensordict["action"])[0])

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

    def step_tensors(
        self, actions: torch.Tensor
    ) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """As `step_and_maybe_reset`, without TensorDicts, which take as long as 500 games.

        Args:
            actions: [batch, ...].

        Returns:
            The results of the step, and the observations for the next step. After the end of an
            episode the latter is the first one of the next episode. They may share tensors.
        """
        after, over = self._step_games(actions)
        if over.any():
            self.restart(over)
            return after, self._observe()
        return after, {name: seen for name, seen in after.items() if name not in NOT_OBSERVED}

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.simulator.seed(seed)
