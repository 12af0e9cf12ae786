"""A kind of game of its own: two seekers and a hider on a line, who see only near cells.

All move at once by one cell, or stay. The seekers win as soon as one is in the cell of the hider.
`pursuit train --allow line_game --task line_game:FAMILY` trains a seeker.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

import numpy as np

from pursuit.rules.randomness import draw_uniform
from pursuit.simulator.batch import Batch, Rules
from scripted_agents.agents.random_policy import RandomPolicy
from train.evaluation.return_sides import ReturnSides
from train.families import Family
from train.families.game_world import GameWorld, policies_by_name
from train.networks.batch_seat import BatchSeat
from train.settings.task_form import TaskForm

MOVES, GAINED = np.array([-1, 0, 1]), np.array([1.0, 1.0, -2.0])


@dataclass(frozen=True)
class Line(Rules):
    """The rules: cells in a row, and how far all see."""

    size: int = 5
    view: int = 1
    max_steps: int = 8
    name: ClassVar[str] = "line"  # type: ignore[misc]
    agent_names: ClassVar[Any] = ("seeker_0", "seeker_1", "hider_0")  # type: ignore[misc]
    seat_roles: ClassVar[Any] = ("seeker", "seeker", "hider")  # type: ignore[misc]

    def caught(self, cells: Any) -> Any:
        """[games] whether a seeker is in the cell of the hider."""
        return (cells[:, :2] == cells[:, 2:]).any(axis=1)


class LineBatch(Batch[Line]):
    """Games stepped together; those that are over keep their state until they are reset."""

    def __init__(
        self, task: Line, num_games: int = 1, seed: int = 0, first_game: int = 0, **how: bool
    ) -> None:
        super().__init__(task, num_games, seed, first_game, **{"auto_restart": False, **how})
        self.streams = np.zeros((num_games, 1 + 3), dtype=np.uint64)  # of starts, of agents
        self.cells, self._steps = np.zeros((num_games, 3), np.int32), np.zeros(num_games, np.int32)
        self.rewards, self.returns = np.zeros((num_games, 3), np.float32), np.zeros((num_games, 3))
        self.terminated, self.truncated = np.zeros((2, num_games), dtype=bool)
        self._arrays = (self.rewards, *self._live().values())
        self.reset(seed)

    @property
    def steps(self) -> Any:
        return self._steps

    def _start(self, chosen: Any) -> None:
        drawn, streams = np.empty((3, int(chosen.sum()))), self.streams[chosen]
        for numbers in drawn:
            draw_uniform(streams, 0, numbers)
        self.streams[chosen] = streams
        half = self.task.size // 2  # the hider starts in the second half, the seekers in the first
        self.cells[chosen] = drawn.T * [half, half, self.task.size - half] + [0, 0, half]
        for array in (self._steps, self.rewards, self.returns, self.terminated, self.truncated):
            array[chosen] = 0

    def step(self, actions: Any) -> None:
        running = ~self.ended
        target = self.cells + MOVES[np.asarray(actions)] * running[:, None]
        if ((target < 0) | (target >= self.task.size)).any():
            raise ValueError(f"actions={actions!r}; one leaves the line, see `LineSeat.allowed`")
        self.cells[:], self._steps[:] = target, self._steps + running
        caught = running & self.task.caught(target)
        self.rewards[:] = caught[:, None] * GAINED
        self.returns += self.rewards
        self.terminated |= caught
        self.truncated |= running & ~caught & (self._steps >= self.task.max_steps)

    def _live(self) -> dict[str, Any]:
        names = ("streams", "cells", "returns", "terminated", "truncated")
        return {"steps": self._steps, **{name: getattr(self, name) for name in names}}

    def text(self, game: int) -> str:
        return " ".join("_" + "".join(np.array([*"abH"])[self.cells[game] == cell])
                        for cell in range(self.task.size))  # fmt: skip


@dataclass(frozen=True)
class LineSeat(BatchSeat):
    """What an agent observes: its cell, the steps, and the others where it sees them."""

    num_actions = 3
    has_masks = True
    limits = np.full(5, -1, np.float32), np.full(5, 1, np.float32)

    def seen(self, batch: Any, agents: slice) -> Any:
        found, task, done = [], batch.task, batch.steps[:, None] / batch.task.max_steps
        for seat in range(3)[agents]:
            own, others = batch.cells[:, [seat]], np.delete(batch.cells, seat, axis=1)
            near = np.where(np.abs(others - own) > task.view, -task.size, others)
            found.append(np.concatenate([own / task.size, near / task.size, done, 1 - done], 1))
        return np.stack(found, axis=1).astype(np.float32)

    def allowed(self, batch: Any, agents: slice) -> Any:
        target = batch.cells[:, agents, None] + MOVES
        return (target >= 0) & (target < batch.task.size)


class LineSolver:
    """Backward induction over the cells of all, for games in which all see everything."""

    def why_not(self, task: Line, policies: Any) -> str | None:
        if not all(hasattr(own, "probabilities") for own in policies.values()):
            return "a policy without known probabilities"
        return None if task.view >= task.size else f"agents see {task.view} cells far"

    def returns(self, task: Line, policies: Any) -> Any:
        return self.solved(task, policies, [])[0]

    def respond(self, task: Line, agent: str, policies: Any) -> Any:
        own = [seat for seat, name in enumerate(task.agent_names) if agent in name]
        found, plan = self.solved(task, policies, own)
        return float(found[own].sum()), Plan(plan, own)

    def solved(self, task: Line, policies: Any, own: list[int]) -> Any:
        """[agents] returns, the mean over starts, where the agents `own` play their best response;
        and that: [steps, states, own] actions."""
        states = np.array([*product(range(task.size), repeat=3)])
        batch, values, plan = LineBatch(task, len(states)), np.zeros((len(states), 3)), []
        for step in reversed(range(task.max_steps)):
            batch.cells[:], batch.steps[:] = states, step
            legal = LineSeat(task, "hider").allowed(batch, slice(0, 3)) * 1.0
            shares = [legal[:, s] if s in own else policies[name].probabilities(batch.view(s))
                      for s, name in enumerate(task.agent_names)]  # fmt: skip
            found, can = np.zeros((3 ** len(own), len(states), 3)), np.zeros(3 ** len(own))[:, None]
            can = np.repeat(can, len(states), axis=1)
            for joint in product(range(3), repeat=3):
                target = np.clip(states + MOVES[[*joint]], 0, task.size - 1)
                after = values[np.ravel_multi_index(target.T, (task.size,) * 3)]
                gained = np.where(task.caught(target)[:, None], GAINED, after)
                chance = np.prod([share[:, a] for share, a in zip(shares, joint, strict=True)], 0)
                mine = int("0" + "".join(str(joint[s]) for s in own), 3)
                found[mine] += chance[:, None] * gained
                can[mine] += chance
            best = np.where(can > 0.0, found[:, :, own].sum(axis=2), -np.inf).argmax(axis=0)
            values = found[best, np.arange(len(states))]
            plan.insert(0, best[:, None] // 3 ** np.arange(len(own))[::-1] % 3)
        half = task.size // 2
        starts = (states[:, :2] < max(half, 1)).all(axis=1) & (states[:, 2] >= half)
        return values[starts].mean(axis=0), np.array(plan)


@dataclass
class Plan:
    """The best response of `LineSolver`."""

    plan: Any
    own: list[int]

    def act(self, view: Any) -> Any:
        cells = view.of(lambda batch: batch.cells)
        steps = np.minimum(view.steps, len(self.plan) - 1)
        states = np.ravel_multi_index(cells.T, (view.task.size,) * 3)
        return self.plan[steps, states, self.own.index(view.seat)].astype(np.int32)


@dataclass(frozen=True)
class LineSettings(TaskForm):
    """A line of cells."""

    OBSERVATION: ClassVar[str] = "observe"
    AGENT: ClassVar[str] = "role"
    POLICIES: ClassVar[tuple[str, ...]] = ("opponent", "opponent_policy", "opponent_epsilon")
    AGENTS: ClassVar[tuple[str, ...]] = ("random",)
    sides: ClassVar[tuple[str, ...]] = ("seeker", "hider")
    discount: ClassVar[float] = 1.0
    game: ClassVar[str] = "line"

    role: str = "auto"
    size: int = 5
    view: int = 1
    max_steps: int = 8
    opponent: str = "random"
    opponent_policy: str = "sampled"
    opponent_epsilon: float = 0.0

    def build(self) -> Line:
        return Line(self.size, self.view, self.max_steps)


class LineWorld(GameWorld):
    """A line with its policies."""

    BATCH: ClassVar[Any] = LineBatch
    ZERO_SUM: ClassVar[bool] = True
    SOLVER: ClassVar[Any] = LineSolver()
    POLICIES: ClassVar[Any] = policies_by_name(
        LineSettings,
        {"random": lambda task, role, _: RandomPolicy(3, LineSeat(task, role).allowed)},
    )


def seat_of(settings: Any) -> LineSeat:
    task, least = settings.task.build(), settings.min_probability or 0.0
    agent = settings.task.agent_in(task)
    return LineSeat(task, agent, settings.observation, settings.network, least)


FAMILY = Family(LineSettings, seat_of, LineWorld, LineWorld.POLICIES, ReturnSides)
