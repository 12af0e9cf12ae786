"""Contests: how well a policy does, beside the references and the exact optimum.

A run knows a `Contest` and nothing of what is played in it. `GameContest` is that of one agent in
the games of a task: one chaser against one evader in one maze is evaluated exactly, by backward
induction over all pairs of cells; everything else is played out from seeded starts that are the
same for everybody.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import Policy, TabularPolicy
from pursuit.simulator import Simulator
from pursuit.single_agent import fill_seats
from pursuit.task import ROLES, Task
from scripted_agents import (
    BestResponse,
    RandomAgent,
    TablePolicy,
    best_response,
    evaluate_exactly,
    mean_over_starts,
    tour_lengths,
)
from scripted_agents.environments import DEFAULTS
from train.evaluation.games import (
    EVALUATION_SEED,
    half_width,
    is_exact,
    play_out,
    table_in,
    won_by,
)


@dataclass(frozen=True)
class Score:
    """What one policy achieves.

    Attributes:
        name: of the policy.
        mean_steps: mean episode length; an episode that runs out of time counts with all its steps.
        ci95: half width of the 95 % confidence interval of the mean; 0 where it is exact.
        success_rate: share of episodes won: the chasers caught all, the evader lived to the last
            step, all goals were collected.
        episodes: played for this score (or, where exact, for the success rate alone).
        exact: whether `mean_steps` is an exact mean over all starts.
    """

    name: str
    mean_steps: float
    ci95: float
    success_rate: float
    episodes: int
    exact: bool


def optimality_gap(achieved: Score, optimum: Score | None) -> float | None:
    """Achieved / optimal - 1 in steps, on the same starts; negative for evaders that fall short."""
    return None if optimum is None else achieved.mean_steps / optimum.mean_steps - 1.0


def told(policy: Policy) -> str:
    """A policy in words: its own, or else the name of its class."""
    plain = type(policy).__repr__ is object.__repr__
    return type(policy).__name__ if plain else repr(policy)


class Contest(Protocol):
    """What a run is judged by.

    Attributes:
        less_is_better: whether few steps are good.
    """

    @property
    def less_is_better(self) -> bool: ...  # noqa: D102 -- see the class

    def describe(self) -> dict[str, Any]:
        """What is played, by whom and where, as plain values: "task", "role", "maze"."""

    def line(self) -> str:
        """The same in one line, with whoever else plays."""

    def score(self, name: str, policy: Policy) -> Score:
        """How well a policy does."""

    def optimal(self) -> Score | None:
        """The exact optimum; None where it is not known."""

    def baselines(self) -> list[Score]:
        """The references: random, scripted and, where it is known, optimal."""


@dataclass(frozen=True)
class GameContest:
    """One agent of a task, with fixed policies in all other seats; a `Contest`."""

    task: Task
    agent: str
    opponents: dict[str, Policy]
    episodes: int = 1000
    seed: int = EVALUATION_SEED

    @property
    def role(self) -> str:
        """The role of the agent."""
        return self.task.seat_roles[self.task.seat(self.agent)]

    @property
    def less_is_better(self) -> bool:
        """Whether few steps are good: for everybody but evaders that have nothing to collect."""
        return self.role != "evader" or self.task.num_goals > 0

    @property
    def is_exact(self) -> bool:
        """Whether lengths are means over all starts, computed without sampling."""
        return is_exact(self.task, *self.opponents.values())

    def describe(self) -> dict[str, Any]:
        """The names of the task, the role and the (first) maze."""
        return {"task": self.task.name, "role": self.role, "maze": self.task.mazes[0].name}

    def line(self) -> str:
        """One line that says what is evaluated."""
        task, maze = self.task, self.task.mazes[0]
        counts = {role: task.count(role) for role in ROLES} | {"goal": task.num_goals}
        parts = [f"{n} {name}{'s' if n > 1 else ''}" for name, n in counts.items() if n]
        others = sorted(
            {
                told(policy)
                for role, policy in self.opponents.items()
                if role in task.seat_roles and (role != self.role or task.count(role) > 1)
            }
        )
        against = f", with {', '.join(others)}" if others else ""
        return (
            f"{task.name}: {self.agent} on maze {maze.name} ({maze.num_cells} cells; "
            f"{', '.join(parts)}){against}, at most {task.max_steps} steps"
        )

    def starts(self) -> Simulator:
        """The games of the evaluation at their starts."""
        return Simulator(self.task, self.episodes, self.seed, auto_restart=False)

    def play(self, policy: Policy) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Play every start to its end: episode lengths [episodes], and who won [episodes]."""
        seat, policies = fill_seats(self.task, self.agent, self.opponents)
        policies[seat] = policy
        return play_out(
            self.starts(),
            policies,
            lambda games: games.terminated | games.truncated | (games.active[:, seat] == 0),
            lambda games: won_by(games, seat),
        )

    def _opponent_table(self) -> NDArray[np.float64]:
        other = "evader" if self.role == "chaser" else "chaser"
        policy = self.opponents.get(f"{other}_0", self.opponents.get(other))
        assert policy is not None  # is_exact
        return table_in(self.task, policy)

    def score(self, name: str, policy: Policy) -> Score:
        """Play, and solve where it can be solved."""
        lengths, won = self.play(policy)
        mean, ci95, exact = float(lengths.mean()), half_width(lengths), False
        if self.is_exact and isinstance(policy, TabularPolicy):
            task = self.task
            tables = (table_in(task, policy), self._opponent_table())
            values = evaluate_exactly(
                task.mazes[0],
                *(tables if self.role == "chaser" else tables[::-1]),
                horizon=task.max_steps,
                move_order=task.move_order,  # type: ignore[arg-type]
            )
            mean = mean_over_starts(values, task.mazes[0], task.min_start_distance)
            ci95, exact = 0.0, True
        return Score(name, mean, ci95, float(won.mean()), len(lengths), exact)

    def best_response(self) -> BestResponse | None:
        """The exact best response to the opponent, where `is_exact`."""
        if not self.is_exact:
            return None
        task = self.task
        return best_response(
            self.role,  # type: ignore[arg-type]
            task.mazes[0],
            self._opponent_table(),
            horizon=task.max_steps,
            stay_action=task.stay_action,
            move_order=task.move_order,  # type: ignore[arg-type]
        )

    def optimal(self) -> Score | None:
        """The exact optimum on the same starts; None where it is not known.

        Known for one chaser against one evader (the best response to the opponent) and for one
        runner (the shortest tours, exact up to 18 goals).
        """
        task, best = self.task, self.best_response()
        if best is not None:
            maze = task.mazes[0]
            mean = mean_over_starts(best.values, maze, task.min_start_distance)
            _, won = self.play(TablePolicy(maze, best.policy))
            return Score("optimal", mean, 0.0, float(won.mean()), self.episodes, True)
        if (task.num_agents, task.num_runners) != (1, 1):
            return None
        simulator = self.starts()
        lengths = np.zeros(self.episodes, dtype=np.int64)
        for number, maze in enumerate(task.mazes):
            here = simulator.maze_index == number
            if here.any():
                starts, goals = simulator.positions[here, 0], simulator.goals[here]
                lengths[here] = tour_lengths(maze, starts, goals)
        share = float((lengths <= task.max_steps).mean())
        mean = float(np.minimum(lengths, task.max_steps).mean())
        return Score("optimal", mean, half_width(lengths), share, self.episodes, False)

    def baselines(self) -> list[Score]:
        """Random, scripted (A* or nearest goal) and, where it is known, optimal."""
        scripted = {"chaser": "A* chaser", "evader": "A* evader", "runner": "nearest goal"}
        scores = [
            self.score("random", RandomAgent()),
            self.score(scripted[self.role], DEFAULTS[self.role](0.0)),
        ]
        optimum = self.optimal()
        return scores if optimum is None else [*scores, optimum]
