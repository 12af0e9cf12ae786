"""SimulatorEnv: a batch of games of the Simulator as a native TorchRL environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from pursuit.masks import ACTION_MASK, action_masks, warn_of_masks
from pursuit.maze_arrays import lay_out
from pursuit.policy import Policy
from pursuit.simulator import Simulator
from train.environments.hooks import EpisodeHook
from train.networks.policy import Seat

FLAGS = ("terminated", "truncated", "done")


class SimulatorEnv(EnvBase):
    """The learner's seats of every game; policies fill the others.

    The learner has k seats of each game, one after the other: one here, all of a role in `TeamEnv`.
    Each of them is one entry of the batch, game by game.

    Keys: "observation" [batch, ...], "action" [batch] int64, "reward", "terminated", "truncated"
    and "done" [batch, 1]. After a step, "next" holds the last observation of an episode that ended;
    the partial reset that follows begins the next one, so that nothing is bootstrapped across
    episodes. An episode is over with its game, or when none of the learner's agents is left in it.
    Where k > 1, an agent that has been caught while others run on is "idle" ([batch, 1] bool): what
    it records counts for nothing.

    Where the player has `mask_bumps`, "action_mask" ([batch, actions] bool, beside each
    "observation") says what it may do, and the action spec draws from that alone. (Without the stay
    action it forbids waiting, with a warning.)

    Args:
        simulator: made with `auto_restart=False`.
        player: who learns; its encoding is observed.
        policies: whoever fills each seat; None in the learner's.
        hook: changes the next episodes.
        members: k.

    Attributes:
        seat, seats: the learner's first seat, and all of them.
        central: whether each agent observes what all k do as well.
        scale: rewards are multiplied by it.
        idle: [num_games, k] bool.
        finished_returns, finished_lengths: of the episodes that ended since they were last cleared.
        resume: set it to have the next full reset go on with the games as they stand.
        carries_over: whether episodes begin where the last ones ended: not in mazes.
        begun: whether `begin` was called.
    """

    central = False
    carries_over = False
    scale = 1.0

    def __init__(
        self,
        simulator: Simulator,
        player: Seat,
        policies: Sequence[Policy | None],
        hook: EpisodeHook | None = None,
        members: int = 1,
    ) -> None:
        batch = simulator.num_games * members
        super().__init__(device="cpu", batch_size=[batch])
        self.simulator, self.player, self.policies = simulator, player, list(policies)
        self.hook = hook or EpisodeHook()
        self.encoding, self.num_games, self.members = player.encoding, simulator.num_games, members
        self.seat = player.number
        self.seats = slice(self.seat, self.seat + members)
        self.finished_returns: list[NDArray[Any]] = []
        self.finished_lengths: list[NDArray[Any]] = []
        self.resume = self.begun = False
        self.idle = np.zeros((self.num_games, members), dtype=bool)
        self._actions = np.zeros((self.num_games, simulator.num_agents), dtype=np.int32)
        self._world = lay_out(simulator.task.mazes).world
        self._seen_keys = ["observation"] + ["idle"] * (members > 1)
        if player.mask_bumps:
            warn_of_masks(simulator.task)
            self._seen_keys.append(ACTION_MASK)
        self.action_spec = Categorical(player.num_actions, shape=(batch,), dtype=torch.int64)
        self.reward_spec = Unbounded((batch, 1))
        flag = Binary(n=1, shape=(batch, 1), dtype=torch.bool)
        self.full_done_spec = Composite({key: flag.clone() for key in FLAGS}, shape=(batch,))
        self._specify_observation()

    def _specify_observation(self) -> None:
        batch, space = self.batch_size[0], self.simulator.encoder(self.encoding).space
        dtype = torch.from_numpy(np.zeros(1, dtype=space.dtype)).dtype
        shape = (batch, *([self.members + 1] if self.central else []), *space.shape)
        low, high = (
            torch.as_tensor(bound, dtype=dtype).expand(shape) for bound in (space.low, space.high)
        )
        spec: Any = {"observation": Bounded(low, high, shape=shape, dtype=dtype)}
        if self.members > 1:
            spec["idle"] = Binary(n=1, shape=(batch, 1), dtype=torch.bool)
        if self.player.mask_bumps:
            actions = self.player.num_actions
            spec[ACTION_MASK] = Binary(n=actions, shape=(batch, actions), dtype=torch.bool)
        self.observation_spec = Composite(spec, shape=(batch,))

    def begin(self) -> None:
        """New episodes in all games; the first time those of the simulator's seed, with lessons.

        The simulator has begun them already, but without the hook.
        """
        if not self.begun and self.simulator.last_seed is not None:
            self.simulator.seed(self.simulator.last_seed)
        self.begun = True
        self.restart()

    def restart(self, games: NDArray[np.bool_] | None = None) -> None:
        """Begin new episodes in the games of the mask [num_games], or in all, as the hook says."""
        chosen = np.arange(self.num_games) if games is None else np.flatnonzero(games)
        if len(chosen):
            self.hook.before_restart(chosen)
            self.simulator.reset(games=games)
            self.idle[chosen] = False
            self.hook.after_restart(chosen)

    def finish(self, games: NDArray[np.bool_]) -> None:
        """Note the games of the mask [num_games], whose episodes have just ended."""
        returns = self.simulator.returns[games, self.seats]
        self.finished_returns.append(returns.mean(axis=1) if self.members > 1 else returns[:, 0])
        self.finished_lengths.append(self.simulator.steps[games].copy())
        self.hook.episode_ended(games)

    def _seen(self) -> dict[str, torch.Tensor]:
        """The observations [batch, ...] of the learner's seats, who is idle, and the masks."""
        encoder = self.simulator.encoder(self.encoding)
        seen = torch.from_numpy(encoder.encode(self.simulator.games, self.seats))
        if self.central:
            team = seen[:, None].expand(-1, self.members, *seen.shape[1:])
            seen = torch.cat([seen[:, :, None], team], dim=2)
        found = {"observation": seen.flatten(0, 1)}
        if self.members > 1:
            found["idle"] = torch.from_numpy(self.idle.reshape(-1, 1).copy())
        if self.player.mask_bumps:
            found[ACTION_MASK] = torch.from_numpy(self.masks()).flatten(0, 1)
            self.action_spec.update_mask(found[ACTION_MASK])
        return found

    def masks(self) -> NDArray[np.bool_]:
        """[num_games, k, actions] bool: what the learner's agents may do."""
        simulator, actions = self.simulator, self.player.num_actions
        if not self.player.mask_bumps:
            return np.ones((self.num_games, self.members, actions), dtype=bool)
        return action_masks(simulator.games, self._world, actions, self.seats, simulator.terminated)

    def _batch(self, content: dict[str, torch.Tensor]) -> TensorDictBase:
        return TensorDict(content, batch_size=self.batch_size, device=self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            self.restart(tensordict["_reset"].view(-1, self.members).all(dim=1).numpy())
        elif not self.resume:
            self.begin()
        self.resume = False
        return self._batch(self._seen())

    def _play(
        self, actions: torch.Tensor, alive: NDArray[np.bool_] | None = None
    ) -> tuple[TensorDictBase, NDArray[np.bool_]]:
        """One step with the learner's actions [batch]: all after it, and whose episode is over.

        Args:
            actions: int64.
            alive: [num_games]; an episode that is over elsewhere was so before.
        """
        simulator = self.simulator
        simulator.act(self.policies, self._actions)
        self._actions[:, self.seats] = actions.numpy().reshape(-1, self.members)
        simulator.step(self._actions)
        caught = simulator.active[:, self.seats] == 0
        terminated = simulator.terminated[:, None] | caught
        truncated = simulator.truncated[:, None] & ~caught
        done = terminated | truncated
        over = done.all(axis=1)
        if self.members > 1:
            self.idle[:] = caught & ~over[:, None]
        ending = over if alive is None else over & alive
        if ending.any():
            self.finish(ending)
        rewards = simulator.rewards[:, self.seats] * np.float32(self.scale)
        flags = dict(zip(FLAGS, (terminated, truncated, done), strict=True))
        after = {
            **self._seen(),
            "reward": torch.from_numpy(rewards.reshape(-1, 1)),
            **{name: torch.from_numpy(flag.reshape(-1, 1)) for name, flag in flags.items()},
        }
        return self._batch(after), over

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._play(tensordict["action"])[0]

    def step_episodes(self, actions: torch.Tensor, running: torch.Tensor) -> TensorDictBase:
        """A step without restarts, for learning from whole episodes; one seat a game.

        Args:
            actions: [num_games] int64; those of games that have ended are ignored.
            running: [n] int64, the games whose episode is not over yet.

        Returns:
            Everything after the step, for all games.
        """
        alive = np.zeros(self.num_games, dtype=bool)
        alive[running.numpy()] = True
        return self._play(actions, alive)[0]

    # -- without tensors, for learners that step the games themselves ------------------------------

    @property
    def returns(self) -> NDArray[np.float64]:
        """[num_games]: what the learner's first seat has been paid in the episode so far."""
        returns: NDArray[np.float64] = self.simulator.returns[:, self.seat]
        return returns

    def observe(self) -> NDArray[Any]:
        """[num_games, ...]: what the learner's first seat observes."""
        return self.simulator.observe(self.encoding, self.seat)

    def advance(self, actions: NDArray[np.int32], running: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """A step without restarts, as `step_episodes`; one seat a game.

        Args:
            actions: [num_games]; those of games that have ended are ignored.
            running: [num_games], whose episode is not over yet.

        Returns:
            [num_games]: those of them whose episode is over now.
        """
        simulator = self.simulator
        simulator.act(self.policies, self._actions)
        self._actions[:, self.seat] = actions
        simulator.step(self._actions)
        ending = simulator.ended
        if simulator.task.num_evaders > 1:
            ending |= simulator.active[:, self.seat] == 0
        ending &= running
        if ending.any():
            self.finish(ending)
        return ending

    def share_starts(self, each: int) -> None:
        """Make every game the copy of the one of its number modulo `each`, random streams too."""
        chosen = np.arange(self.num_games) % each
        self.simulator.set_state(self.simulator.get_state(chosen))

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """What `EnvBase.step_and_maybe_reset` does, in a quarter of its time.

        The games that are over begin anew without the checks and copies of the general partial
        reset; a test holds the two against each other.
        """
        after, over = self._play(tensordict["action"])
        seen = {name: after[name] for name in self._seen_keys}
        if over.any():
            self.restart(over)
            seen = self._seen()
        running = torch.zeros_like(after["done"])
        following = self._batch({**seen, **{name: running.clone() for name in FLAGS}})
        return tensordict.set("next", after), following

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.simulator.seed(seed)
