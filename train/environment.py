"""SimulatorEnv: a batch of games of the Simulator as a native TorchRL environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from pursuit.policy import Policy
from pursuit.simulator import Simulator

if TYPE_CHECKING:
    from train.teacher import Teacher


class SimulatorEnv(EnvBase):
    """One seat of every game is the learner's; policies fill the others.

    Keys: "observation" [num_games, ...], "action" [num_games] int64, "reward", "terminated",
    "truncated" and "done" [num_games, 1]. After a step, "next" holds the last observation of an
    episode that ended; the partial reset that follows begins the next one, so that nothing is
    bootstrapped across episodes.

    Args:
        simulator: made with `auto_restart=False`.
        seat: the learner's seat.
        policies: whoever fills each seat; None in the learner's.
        encoding: one of `pursuit.observations.ENCODINGS`.
        copies: how many seats of each game the learner has; a subclass fills all of them.

    Attributes:
        finished_returns, finished_lengths: of the episodes that ended since they were last cleared.
        resume: set it to have the next full reset go on with the games as they stand.
        begun: whether `begin` was called.
        teacher: gives every episode its lesson; None where there is no curriculum.
    """

    def __init__(
        self,
        simulator: Simulator,
        seat: int,
        policies: Sequence[Policy | None],
        encoding: str = "index",
        copies: int = 1,
    ) -> None:
        super().__init__(device="cpu", batch_size=[simulator.num_games * copies])
        self.simulator, self.seat, self.policies, self.encoding = (
            simulator,
            seat,
            list(policies),
            encoding,
        )
        self.finished_returns: list[np.ndarray[Any, Any]] = []
        self.finished_lengths: list[np.ndarray[Any, Any]] = []
        self.resume = False
        self.begun = False
        self.teacher: Teacher | None = None
        self._actions = np.zeros((simulator.num_games, simulator.num_agents), dtype=np.int32)
        games, space = simulator.num_games * copies, simulator.encoder(encoding).space
        dtype = torch.from_numpy(np.zeros(1, dtype=space.dtype)).dtype
        shape = (games, *space.shape)
        low, high = (torch.as_tensor(bound, dtype=dtype) for bound in (space.low, space.high))
        self.observation_spec = Composite(
            observation=Bounded(low.expand(shape), high.expand(shape), shape=shape, dtype=dtype),
            shape=(games,),
        )
        self.action_spec = Categorical(
            simulator.task.num_actions, shape=(games,), dtype=torch.int64
        )
        self.reward_spec = Unbounded((games, 1))
        self.full_done_spec = Composite(
            {
                key: Binary(n=1, shape=(games, 1), dtype=torch.bool)
                for key in ("done", "terminated", "truncated")
            },
            shape=(games,),
        )

    def restart(self, games: NDArray[np.bool_] | None = None) -> None:
        """Begin new episodes in the games of the mask, or in all, as the teacher says."""
        if self.teacher is not None:
            self.teacher.restart(games)
        else:
            self.simulator.reset(games=games)

    def begin(self) -> None:
        """New episodes in all games; the first time those of the simulator's seed, with lessons."""
        if not self.begun and self.simulator.last_seed is not None:
            self.simulator.seed(self.simulator.last_seed)
        self.begun = True
        self.restart()

    def finish(self, games: NDArray[np.bool_]) -> None:
        """Note the games of the mask, whose episodes have just ended, before they restart."""
        self.finished_returns.append(self.simulator.returns[games, self.seat])
        self.finished_lengths.append(self.simulator.steps[games].copy())
        if self.teacher is not None:
            self.teacher.finish(games)

    def _observe(self) -> torch.Tensor:
        return torch.from_numpy(self.simulator.observe(self.encoding, self.seat))

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            self.restart(tensordict["_reset"].view(-1).numpy())
        elif not self.resume:
            self.begin()
        self.resume = False
        return TensorDict(
            {"observation": self._observe()}, batch_size=self.batch_size, device=self.device
        )

    def _step(
        self, tensordict: TensorDictBase, alive: torch.Tensor | None = None
    ) -> TensorDictBase:
        simulator = self.simulator
        simulator.act(self.policies, self._actions)
        self._actions[:, self.seat] = tensordict["action"].numpy()
        simulator.step(self._actions)
        terminated = torch.from_numpy(simulator.terminated.copy())
        truncated = torch.from_numpy(simulator.truncated.copy())
        if simulator.task.num_evaders > 1:
            captured = torch.from_numpy(simulator.active[:, self.seat] == 0)
            terminated, truncated = terminated | captured, truncated & ~captured
        done = terminated | truncated
        ending = done if alive is None else done & alive
        if ending.any():
            self.finish(ending.numpy())
        return TensorDict(
            {
                "observation": self._observe(),
                "reward": torch.from_numpy(simulator.rewards[:, self.seat, None].copy()),
                "terminated": terminated[:, None],
                "truncated": truncated[:, None],
                "done": done[:, None],
            },
            batch_size=self.batch_size,
            device=self.device,
        )

    def step_episodes(self, actions: torch.Tensor, running: torch.Tensor) -> TensorDictBase:
        """A step without restarts, for learning from whole episodes.

        Args:
            actions: [num_games] int64; those of games that have ended are ignored.
            running: [n] int64, the games whose episode is not over yet.

        Returns:
            Everything after the step, for all games.
        """
        alive = torch.zeros(self.simulator.num_games, dtype=torch.bool)
        alive[running] = True
        action = TensorDict({"action": actions}, batch_size=self.batch_size)
        return self._step(action, alive)

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """What `EnvBase.step_and_maybe_reset` does, in a quarter of its time.

        The games that ended begin anew without the checks and copies of the general partial reset;
        a test holds the two against each other.
        """
        after = self._step(tensordict)
        done = after["done"]
        observation = after["observation"]
        if done.any():
            self.restart(done.view(-1).numpy())
            observation = self._observe()
        running = torch.zeros_like(done)
        following = TensorDict(
            {
                "observation": observation,
                "done": running,
                "terminated": running.clone(),
                "truncated": running.clone(),
            },
            batch_size=self.batch_size,
            device=self.device,
        )
        return tensordict.set("next", after), following

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.simulator.seed(seed)
