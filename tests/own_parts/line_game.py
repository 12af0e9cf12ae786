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
from pursuit.simulator.state import check_range
from scripted_agents.agents.random_policy import RandomPolicy
from train.evaluation.return_sides import ReturnSides
from train.families import Family
from train.families.game_world import GameWorld, policies_by_name
from train.networks.batch_seat import BatchSeat
from train.settings.task_form import TaskForm

SEEKERS, HIDER, MOVES = slice(0, 2), 2, np.array([-1, 0, 1])


@dataclass(frozen=True)
class Line(Rules):
    """The rules: cells in a row, and how far all see."""

    size: int = 5
    view: int = 1
    max_steps: int = 8
    name: ClassVar[str] = "line"  # type: ignore[misc]
    agent_names: ClassVar[tuple[str, ...]] = ("seeker_0", "seeker_1", "hider_0")  # type: ignore[misc]
    seat_roles: ClassVar[tuple[str, ...]] = ("seeker", "seeker", "hider")  # type: ignore[misc]


class LineBatch(Batch[Line]):
    """Games stepped together; those that are over keep their state until they are reset."""

    def __init__(self, task: Line, num_games: int = 1, seed: int = 0, first_game: int = 0,
                 auto_restart: bool = False) -> None:  # fmt: skip
        super().__init__(task, num_games, seed, first_game, auto_restart)
        self.streams = np.zeros((num_games, 1 + 3), dtype=np.uint64)  # of starts, of agents
        self.cells, self._steps = np.zeros((num_games, 3), np.int32), np.zeros(num_games, np.int32)
        self.rewards = np.zeros((num_games, 3), dtype=np.float32)
        self.returns = np.zeros((num_games, 3))
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
        # The hider starts in the second half, the seekers in the first.
        half, starts = self.task.size // 2, drawn.T
        self.cells[chosen] = starts * [half, half, self.task.size - half] + [0, 0, half]
        for array in (self._steps, self.rewards, self.returns, self.terminated, self.truncated):
            array[chosen] = 0

    def step(self, actions: Any) -> None:
        moves, running = MOVES[np.asarray(actions)], ~self.ended
        target = self.cells + moves * running[:, None]
        if ((target < 0) | (target >= self.task.size)).any():
            raise ValueError(f"actions={actions!r}; one leaves the line, see `LineSeat.allowed`")
        self.cells[:] = target
        self._steps += running
        caught = running & (target[:, SEEKERS] == target[:, HIDER:]).any(axis=1)
        self.rewards[:] = caught[:, None] * np.array([1.0, 1.0, -2.0])
        self.returns += self.rewards
        self.terminated |= caught
        self.truncated |= running & ~caught & (self._steps >= self.task.max_steps)

    def _live(self) -> dict[str, Any]:
        names = ("streams", "cells", "returns", "terminated", "truncated")
        return {"steps": self._steps, **{name: getattr(self, name) for name in names}}

    def _check_values(self, state: Any) -> None:
        check_range(state, "cells", 0, self.task.size - 1)
        check_range(state, "steps", 0, self.task.max_steps)

    def text(self, game: int) -> str:
        board = [["."] for _ in range(self.task.size)]
        for letter, cell in zip("abH", self.cells[game].tolist(), strict=True):
            board[cell].append(letter)
        return " ".join("".join(cell) for cell in board)


@dataclass(frozen=True)
class LineSeat(BatchSeat):
    """What an agent observes: its cell, the steps, and the others where it sees them."""

    num_actions = 3
    has_masks = True

    @property
    def limits(self) -> Any:
        return np.full(5, -1, np.float32), np.full(5, 1, np.float32)

    def seen(self, batch: Any, agents: slice) -> Any:
        cells, found, task = batch.cells, [], batch.task
        for seat in range(3)[agents]:
            others = np.delete(cells, seat, axis=1)
            far = np.abs(others - cells[:, seat : seat + 1]) > task.view
            parts = [cells[:, seat : seat + 1], np.where(far, -task.size, others)]
            own = np.concatenate(parts, axis=1) / task.size
            done = batch.steps[:, None] / task.max_steps
            found.append(np.concatenate([own, done, 1.0 - done], axis=1))
        return np.stack(found, axis=1).astype(np.float32)

    def allowed(self, batch: Any, agents: slice) -> Any:
        target = batch.cells[:, agents, None] + MOVES
        return (target >= 0) & (target < batch.task.size)


class LineSolver:
    """Backward induction over all cells, for games in which all see everything."""

    def why_not(self, task: Line, policies: Any) -> str | None:
        return None if task.view >= task.size else f"agents see {task.view} cells far"

    def returns(self, task: Line, policies: Any) -> Any:
        return self._solved(task, policies, ())[0]

    def respond(self, task: Line, agent: str, policies: Any) -> Any:
        names = zip(task.agent_names, task.seat_roles, strict=True)
        own = [seat for seat, name in enumerate(names) if agent in name]
        found, plan = self._solved(task, policies, own)
        return float(found[own].sum()), Plan(plan)

    def _solved(self, task: Line, policies: Any, own: Any) -> Any:
        """Expected returns over the starts, and [steps][states, agents] the best actions of the
        agents `own`, which the others' policies do not have."""
        batch, joints = LineBatch(task, task.size**3), [*product(range(3), repeat=3)]
        states = np.array([*product(range(task.size), repeat=3)])
        values, plan, fixed = np.zeros((len(states), 3)), {}, [s for s in range(3) if s not in own]
        for step in reversed(range(task.max_steps)):
            batch.cells[:], batch.steps[:] = states, step
            legal = LineSeat(task, "hider").allowed(batch, slice(0, 3))
            shares = {s: policies[task.agent_names[s]].probabilities(batch.view(s)) for s in fixed}
            found: Any = {}
            for joint in joints:
                target = np.clip(states + MOVES[list(joint)], 0, task.size - 1)
                caught = (target[:, SEEKERS] == target[:, HIDER:]).any(axis=1)[:, None]
                after = values[np.ravel_multi_index(target.T, (task.size,) * 3)]
                chance = np.prod([shares[s][:, joint[s]] for s in fixed], axis=0)
                gained = np.where(caught, [1.0, 1.0, -2.0], after) * np.reshape(chance, (-1, 1))
                ours = tuple(joint[s] for s in own)
                found[ours] = found.get(ours, 0.0) + gained
            choices = [*found]
            can = [np.all([legal[:, s, a] for s, a in zip(own, c, strict=True)], axis=0)
                   for c in choices]  # fmt: skip
            worth = [np.where(ok, found[c][:, own].sum(axis=1), -np.inf) if own else np.zeros(1)
                     for c, ok in zip(choices, can, strict=True)]  # fmt: skip
            best = np.broadcast_to(np.argmax(worth, axis=0), len(states))
            values = np.stack([found[c] for c in choices])[best, np.arange(len(states))]
            plan[step] = np.array(choices).reshape(len(choices), -1)[best], list(own)
        half = task.size // 2
        starts = (states[:, SEEKERS] < max(half, 1)).all(axis=1) & (states[:, HIDER] >= half)
        return values[starts].mean(axis=0), plan


class Plan:
    """The best response of `LineSolver`."""

    def __init__(self, plan: Any) -> None:
        self.plan = plan

    def act(self, view: Any) -> Any:
        size, cells = view.task.size, view.of(lambda batch: batch.cells)
        rows = zip(view.steps.tolist(), np.ravel_multi_index(cells.T, (size,) * 3), strict=True)
        last = view.task.max_steps - 1
        found = [self.plan[min(step, last)] for step, _ in rows]
        places = np.ravel_multi_index(cells.T, (size,) * 3)
        moves = [
            best[at][own.index(view.seat)] for (best, own), at in zip(found, places, strict=True)
        ]
        return np.array(moves, dtype=np.int32)


@dataclass(frozen=True)
class LineSettings(TaskForm):
    """A line of cells."""

    OBSERVATION: ClassVar[str] = "observe"
    AGENT: ClassVar[str] = "role"
    POLICIES: ClassVar[tuple[str, ...]] = ("opponent", "opponent_policy", "opponent_epsilon")
    AGENTS: ClassVar[tuple[str, ...]] = ("random",)
    sides: ClassVar[tuple[str, ...]] = ("seeker", "hider")

    role: str = "auto"
    """Learning agent or role."""
    size: int = 5
    """Number of cells."""
    view: int = 1
    """How far all see, in cells."""
    max_steps: int = 8
    """Steps of an episode."""
    opponent: str = "random"
    """Policy of the others: random, or the folder of a run."""
    opponent_policy: str = "sampled"
    """Of learned policies: sampled or greedy."""
    opponent_epsilon: float = 0.0
    """Not used."""

    def build(self) -> Line:
        return Line(self.size, self.view, self.max_steps)


def random_policy(task: Line, role: str, epsilon: float) -> RandomPolicy:
    return RandomPolicy(3, LineSeat(task, role).allowed)


class LineWorld(GameWorld):
    """A line with its policies."""

    BATCH: ClassVar[Any] = LineBatch
    POLICIES = policies_by_name(LineSettings, {"random": random_policy})
    SOLVER = LineSolver()


def seat_of(settings: Any) -> LineSeat:
    task, least = settings.task.build(), settings.min_probability or 0.0
    agent = settings.task.agent_in(task)
    return LineSeat(task, agent, settings.observation, settings.network, least)


FAMILY = Family(LineSettings, seat_of, LineWorld, LineWorld.POLICIES, ReturnSides)
