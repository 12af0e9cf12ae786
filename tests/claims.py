"""A game with a batch and an interface of its own: three players claim squares of a row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.interface import GameInterface
from pursuit.environments.types import Space
from pursuit.rendering.text import TextScene, text_scene
from pursuit.rules.arrays import Array
from pursuit.rules.randomness import draw_uniform
from pursuit.simulator.batch import Batch
from pursuit.simulator.state import SimulatorState, check_range

FREE = 3
"""The owner of a free square; 4 if several players wanted it."""


@dataclass(frozen=True)
class Claims:
    """In every step each player names a square. A free square that one player names becomes that
    player's, for a reward of 1; one that several name is lost."""

    agent_names: ClassVar[tuple[str, ...]] = ("red", "green", "blue")
    name: ClassVar[str] = "claims"
    num_agents: ClassVar[int] = 3
    steps_per_round: ClassVar[int] = 1

    squares: int = 9
    max_steps: int = 6

    def seat(self, agent: str | int) -> int:
        if agent not in (*self.agent_names, *range(3)):
            raise ValueError(f"agent {agent!r}; give one of {self.agent_names}")
        return agent if isinstance(agent, int) else self.agent_names.index(agent)


class ClaimsBatch(Batch[Claims]):
    """`owner` [num_games, squares] int32: a seat, or FREE or above."""

    def __init__(
        self,
        task: Claims,
        num_games: int = 1,
        seed: int = 0,
        first_game: int = 0,
        auto_restart: bool = True,
    ) -> None:
        super().__init__(task, num_games, seed, first_game, auto_restart)
        self.streams = np.zeros((num_games, 4), dtype=np.uint64)  # of starts, and of the players
        self.owner = np.zeros((num_games, task.squares), dtype=np.int32)
        self._steps = np.zeros(num_games, dtype=np.int32)
        self.rewards = np.zeros((num_games, 3), dtype=np.float32)
        self.returns = np.zeros((num_games, 3))
        self.terminated, self.truncated = np.zeros((2, num_games), dtype=bool)
        self._arrays = (*self._live().values(), self.rewards)
        self.reset(seed)

    @property
    def steps(self) -> NDArray[np.int32]:
        return self._steps

    def uniform(self, stream: int, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        numbers, part = np.empty(int(games.sum())), self.streams[games]
        draw_uniform(part, stream, numbers)
        self.streams[games] = part
        return numbers

    def _start(self, chosen: NDArray[np.bool_]) -> None:
        for array in (self._steps, self.rewards, self.returns, self.terminated, self.truncated):
            array[chosen] = 0
        self.owner[chosen] = FREE
        for seat in range(3):  # up to three squares are owned at the start
            square = (self.uniform(0, chosen) * self.task.squares).astype(int)
            self.owner[chosen, square] = seat

    def step(self, actions: ArrayLike) -> None:
        chosen = np.asarray(actions)
        assert not self.auto_restart and chosen.shape == self.rewards.shape
        self.rewards[:] = 0.0
        for game in np.flatnonzero(~self.ended):
            for square in {*chosen[game]}:
                (named,) = np.nonzero(chosen[game] == square)
                if self.owner[game, square] == FREE:
                    alone = len(named) == 1
                    self.owner[game, square] = named[0] if alone else FREE + 1
                    self.rewards[game, named] = alone
            self._steps[game] += 1
            self.returns[game] += self.rewards[game]
            self.terminated[game] = (self.owner[game] != FREE).all()
            self.truncated[game] = self._steps[game] >= self.task.max_steps
            self.truncated[game] &= not self.terminated[game]

    def _live(self) -> dict[str, Array]:
        names = ("streams", "owner", "steps", "returns", "terminated", "truncated")
        return {name: getattr(self, name) for name in names}

    def _check_values(self, state: SimulatorState) -> None:
        check_range(state, "owner", 0, FREE + 1)
        check_range(state, "steps", 0, self.task.max_steps)


class AnyFree:
    """A policy that names a uniformly random square, if it is free."""

    def act(self, view: Any) -> NDArray[np.int32]:
        return (view.uniform() * view.task.squares).astype(np.int32)


class ClaimsInterface(GameInterface):
    """What the environments need beside the batch."""

    simulator: ClaimsBatch

    def observation_space(self, seat: int) -> Space:
        return Box(0, 1, (5 * self.simulator.task.squares,), np.float32)

    def action_space(self, seat: int) -> Space:
        return Discrete(self.simulator.task.squares)

    def observe(self, seat: int) -> Array:
        owner = self.simulator.owner
        relative = np.where(owner < FREE, (owner - seat) % 3, owner)
        return np.eye(5, dtype=np.float32)[relative].reshape(len(owner), -1)

    def has_masks(self, seat: int) -> bool:
        return True

    def masks(self, seat: int) -> NDArray[np.bool_]:
        free = self.simulator.owner == FREE
        return free | ~free.any(axis=1, keepdims=True)  # at the end every square

    def scene(self, game: int) -> TextScene:
        row = "".join("rgb.x"[owner] for owner in self.simulator.owner[game])
        return text_scene(self.simulator, game, row)
