"""SelfPlayEnv: all seats of one role are the learner's, and every game has its own opponent."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded

from pursuit.policy import Policy
from pursuit.simulator import Simulator
from train.environment import SimulatorEnv
from train.opponent_pool import PoolPolicy, draw_opponents


class SelfPlayEnv(SimulatorEnv):
    """A batch of games in which every agent of a role learns, with shared parameters.

    Each of the k agents of each game is one entry of the batch [num_games * k], so that a learner
    for one seat learns for all of them (independent PPO; de Witt et al., 2020). An evader that has
    been caught while others run on is "idle" ([batch, 1] bool): what it records counts for nothing.

    Args:
        simulator: made with `auto_restart=False`.
        role: the learner's.
        opponent: fills all other seats.
        encoding: one of `pursuit.observations.ENCODINGS`.
        central: observe also what every agent of the role observes, for a central critic: [k + 1,
            *shape], the own observation first.
        discount: of the scores that the pool keeps.
        scale: rewards are multiplied by it.
        seed: of the drawing of opponents.

    Attributes:
        shares: how often each member of the pool is drawn.
        rng: what draws them.
    """

    def __init__(
        self,
        simulator: Simulator,
        role: str,
        opponent: PoolPolicy,
        encoding: str,
        central: bool,
        discount: float,
        scale: float,
        seed: int,
    ) -> None:
        task = simulator.task
        self.role, self.members, first = role, task.count(role), task.seat(role)
        self.seats = slice(first, first + self.members)
        self.opponent, self.central = opponent, central
        self.discount, self.scale = discount, scale
        self.rng = np.random.default_rng(seed)
        self.shares: NDArray[np.float64] = np.ones(1)
        policies: list[Policy | None] = [None if r == role else opponent for r in task.seat_roles]
        super().__init__(simulator, first, policies, encoding, self.members)
        self.idle = np.zeros((simulator.num_games, self.members), dtype=bool)
        spec: Any = self.observation_spec
        if central:
            own = spec["observation"]
            shape = (own.shape[0], self.members + 1, *own.shape[1:])
            low, high = (bound[:, None].expand(shape) for bound in (own.space.low, own.space.high))
            spec["observation"] = Bounded(low, high, shape=shape, dtype=own.dtype)
        if self.members > 1:
            spec["idle"] = Binary(n=1, shape=(*self.batch_size, 1), dtype=torch.bool)
        self.observation_spec = spec

    def restart(self, games: NDArray[np.bool_] | None = None) -> None:
        """New episodes, each against an opponent that is drawn anew."""
        chosen = np.ones(self.simulator.num_games, dtype=bool) if games is None else games
        self.simulator.reset(games=chosen)
        self.idle[chosen] = False
        count = int(chosen.sum())
        self.opponent.opponents[chosen] = draw_opponents(self.shares, count, self.rng)

    def finish(self, games: NDArray[np.bool_]) -> None:
        """Note the games of the mask, and the learner's scores against their opponents.

        An evader's score is 1 - discount ** steps: what it got of the most that it could get, in
        the discounted game; a chaser's is discount ** steps.
        """
        simulator = self.simulator
        self.finished_returns.append(simulator.returns[games, self.seats].mean(axis=1))
        self.finished_lengths.append(simulator.steps[games].copy())
        left = self.discount ** simulator.steps[games].astype(np.float64)
        scores = left if self.role == "chaser" else 1.0 - left
        opponents = self.opponent.opponents[games]
        for member in np.unique(opponents).tolist():
            self.opponent.pool.note(member, scores[opponents == member])

    def _seen(self) -> dict[str, torch.Tensor]:
        """The observations [batch, ...] of all seats of the role, and who is idle."""
        simulator = self.simulator
        each = simulator.encoder(self.encoding).encode(simulator.games, self.seats)
        seen = torch.from_numpy(each)
        if self.central:
            team = seen[:, None].expand(-1, self.members, *seen.shape[1:])
            seen = torch.cat([seen[:, :, None], team], dim=2)
        found = {"observation": seen.flatten(0, 1)}
        if self.members > 1:
            found["idle"] = torch.from_numpy(self.idle.reshape(-1, 1).copy())
        return found

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            over = tensordict["_reset"].view(-1, self.members).all(dim=1)
            self.restart(over.numpy())
        elif not self.resume:
            self.begin()
        self.resume = False
        return TensorDict(self._seen(), batch_size=self.batch_size, device=self.device)

    def _step(
        self, tensordict: TensorDictBase, alive: torch.Tensor | None = None
    ) -> TensorDictBase:
        simulator = self.simulator
        simulator.act(self.policies, self._actions)
        self._actions[:, self.seats] = tensordict["action"].view(-1, self.members).numpy()
        simulator.step(self._actions)
        caught = simulator.active[:, self.seats] == 0
        terminated = simulator.terminated[:, None] | caught
        truncated = simulator.truncated[:, None] & ~caught
        over = simulator.terminated | simulator.truncated
        if over.any():
            self.finish(over)
        self.idle = caught & ~over[:, None]
        rewards = simulator.rewards[:, self.seats] * np.float32(self.scale)
        flags = {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        return TensorDict(
            {
                **self._seen(),
                "reward": torch.from_numpy(rewards.reshape(-1, 1)),
                **{name: torch.from_numpy(flag.reshape(-1, 1)) for name, flag in flags.items()},
            },
            batch_size=self.batch_size,
            device=self.device,
        )

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """As `SimulatorEnv`; a game begins anew when it is over for all."""
        after = self._step(tensordict)
        over = self.simulator.terminated | self.simulator.truncated
        seen = {name: after[name] for name in self._seen_names}
        if over.any():
            self.restart(over)
            seen = self._seen()
        running = torch.zeros_like(after["done"])
        flags = {name: running.clone() for name in ("done", "terminated", "truncated")}
        following = TensorDict({**seen, **flags}, batch_size=self.batch_size, device=self.device)
        return tensordict.set("next", after), following

    @property
    def _seen_names(self) -> tuple[str, ...]:
        return ("observation", "idle") if self.members > 1 else ("observation",)
