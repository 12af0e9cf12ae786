"""Evaluation: how many steps an agent needs (or survives), beside the exact optimum.

One chaser against one evader in one maze is evaluated exactly, by backward induction over all pairs
of cells; everything else is played out from seeded starts that are the same for everybody.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import Policy, TabularPolicy
from pursuit.simulator import Simulator
from pursuit.single_agent import fill_seats
from pursuit.task import Task
from scripted_agents import (
    BestResponse,
    RandomAgent,
    TablePolicy,
    best_response,
    evaluate_exactly,
    mean_over_starts,
    table_of,
    tour_lengths,
)
from scripted_agents.environments import DEFAULTS

MAX_EXACT_CELLS = 1024
"""Above this number of cells a duel is played out rather than solved (seconds, gigabytes)."""

EVALUATION_SEED = 2**62
"""Far from the seeds that people train with, so that evaluation starts are never trained on."""


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


@dataclass(frozen=True)
class Contest:
    """What is evaluated: one agent of a task, with fixed policies in all other seats."""

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
    def is_exact(self) -> bool:
        """Whether lengths are means over all starts, computed without sampling."""
        task = self.task
        return (
            task.is_duel
            and len(task.mazes) == 1
            and task.max_cells <= MAX_EXACT_CELLS
            and task.start == "random"
            and all(isinstance(policy, TabularPolicy) for policy in self.opponents.values())
        )

    def starts(self) -> Simulator:
        """The games of the evaluation at their starts."""
        return Simulator(self.task, self.episodes, self.seed, auto_restart=False)

    def _opponent_table(self) -> NDArray[np.float64]:
        other = "evader" if self.role == "chaser" else "chaser"
        policy = self.opponents.get(f"{other}_0", self.opponents.get(other))
        assert isinstance(policy, TabularPolicy)  # is_exact
        task = self.task
        return table_of(policy, task.mazes[0], task.stay_action, task.move_order)

    def score(self, name: str, policy: Policy) -> Score:
        """Play, and solve where it can be solved."""
        lengths, won = self.play(policy)
        mean, exact = float(lengths.mean()), False
        ci95 = 1.96 * float(lengths.std(ddof=1)) / len(lengths) ** 0.5 if len(lengths) > 1 else 0.0
        if self.is_exact and isinstance(policy, TabularPolicy):
            task = self.task
            maze = task.mazes[0]
            own = table_of(policy, maze, task.stay_action, task.move_order)
            tables = (own, self._opponent_table())
            values = evaluate_exactly(
                maze,
                *(tables if self.role == "chaser" else tables[::-1]),
                horizon=task.max_steps,
                move_order=task.move_order,  # type: ignore[arg-type]
            )
            mean = mean_over_starts(values, maze, task.min_start_distance)
            ci95, exact = 0.0, True
        return Score(name, mean, ci95, float(won.mean()), len(lengths), exact)

    def play(self, policy: Policy) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Play every start to its end: episode lengths [episodes], and who won [episodes]."""
        simulator, task = self.starts(), self.task
        seat, policies = fill_seats(task, self.agent, self.opponents)
        policies[seat] = policy
        lengths = np.full(self.episodes, task.max_steps, dtype=np.int64)
        running, won = np.ones(self.episodes, dtype=bool), np.zeros(self.episodes, dtype=bool)
        actions = np.zeros((self.episodes, task.num_agents), dtype=np.int32)
        for step in range(1, task.max_steps + 1):
            simulator.act(policies, actions)
            simulator.step(actions)
            captured = simulator.active[:, seat] == 0
            ended = running & (simulator.terminated | simulator.truncated | captured)
            lengths[ended] = step
            won[ended] = won_by(simulator, seat)[ended]
            running &= ~ended
            if not running.any():
                break
        return lengths, won

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
        if (task.num_agents, task.num_runners) == (1, 1):
            simulator = self.starts()
            lengths = np.zeros(self.episodes, dtype=np.int64)
            for number, maze in enumerate(task.mazes):
                here = simulator.maze_index == number
                if here.any():
                    lengths[here] = tour_lengths(
                        maze, simulator.positions[here, 0], simulator.goals[here]
                    )
            spread = 1.96 * float(lengths.std(ddof=1)) / len(lengths) ** 0.5
            share = float((lengths <= task.max_steps).mean())
            mean = float(np.minimum(lengths, task.max_steps).mean())
            return Score("optimal", mean, spread, share, self.episodes, False)
        return None

    def baselines(self) -> list[Score]:
        """Random, scripted (A* or nearest goal) and, where it is known, optimal."""
        scripted = {"chaser": "A* chaser", "evader": "A* evader", "runner": "nearest goal"}
        scores = [
            self.score("random", RandomAgent()),
            self.score(scripted[self.role], DEFAULTS[self.role](0.0)),
        ]
        optimum = self.optimal()
        return scores if optimum is None else [*scores, optimum]


def won_by(simulator: Simulator, seat: int) -> NDArray[np.bool_]:
    """[num_games] bool: whether the agent in `seat` has won, of games that have just ended.

    Chasers win when no evader is left, runners when no goal is; evaders when they are not caught
    and, where there are goals, none is left.
    """
    task = simulator.task
    role, own = task.seat_roles[seat], simulator.active[:, seat] != 0
    if role == "chaser" and task.num_evaders:
        evaders = [other == "evader" for other in task.seat_roles]
        return np.asarray((simulator.active[:, evaders] == 0).all(axis=1))
    if role == "evader" and not task.num_goals:
        return own
    return np.asarray(simulator.terminated & own)


def optimality_gap(achieved: Score, optimum: Score | None) -> float | None:
    """Achieved / optimal - 1 in steps, on the same starts; negative for evaders that fall short."""
    return None if optimum is None else achieved.mean_steps / optimum.mean_steps - 1.0
