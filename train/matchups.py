"""One policy for all chasers against one for all evaders: exactly, or by episodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import Policy, TabularPolicy
from pursuit.simulator import Simulator
from pursuit.task import Task
from scripted_agents import evaluate_exactly, mean_over_starts, table_of
from train.evaluation import EVALUATION_SEED, MAX_EXACT_CELLS


@dataclass(frozen=True)
class Matchup:
    """How long the chasers need.

    Attributes:
        steps: expected steps until the last capture, cut at the task's `max_steps`.
        ci95: half width of its 95 % confidence interval; 0 where it is exact.
        caught: share of games in which all evaders were caught in time.
        games: played; 0 where it is exact.
    """

    steps: float
    ci95: float
    caught: float
    games: int


def is_exact(task: Task, *policies: Policy) -> bool:
    """Whether all these policies are tables in a duel that is small enough to be solved."""
    return (
        task.is_duel
        and len(task.mazes) == 1
        and task.max_cells <= MAX_EXACT_CELLS
        and task.start == "random"
        and all(isinstance(policy, TabularPolicy) for policy in policies)
    )


def table_in(task: Task, policy: Policy) -> NDArray[np.float64]:
    """[self cell, other cell, action] of a policy, where `is_exact`."""
    assert isinstance(policy, TabularPolicy)
    return table_of(policy, task.mazes[0], task.stay_action, task.move_order)


def play_pair(
    task: Task, chaser: Policy, evader: Policy, episodes: int, seed: int = EVALUATION_SEED
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Play from the starts of `seed`: lengths [episodes], and whether all evaders were caught."""
    simulator = Simulator(task, episodes, seed, auto_restart=False)
    policies = [chaser if role == "chaser" else evader for role in task.seat_roles]
    evaders = [role == "evader" for role in task.seat_roles]
    actions = np.zeros((episodes, task.num_agents), dtype=np.int32)
    lengths = np.full(episodes, task.max_steps, dtype=np.int64)
    caught = np.zeros(episodes, dtype=bool)
    running = np.ones(episodes, dtype=bool)
    for step in range(1, task.max_steps + 1):
        simulator.act(policies, actions)
        simulator.step(actions)
        ended = running & simulator.ended
        lengths[ended] = step
        caught[ended] = (simulator.active[ended][:, evaders] == 0).all(axis=1)
        running &= ~ended
        if not running.any():
            break
    return lengths, caught


def match(
    task: Task, chaser: Policy, evader: Policy, episodes: int = 1000, seed: int = EVALUATION_SEED
) -> Matchup:
    """Exact where `is_exact`; else the mean over `episodes` games."""
    if is_exact(task, chaser, evader):
        maze, horizon = task.mazes[0], task.max_steps
        own, other = (table_in(task, policy) for policy in (chaser, evader))
        order: Any = task.move_order
        values = evaluate_exactly(maze, own, other, horizon, 1.0, order)
        longer = evaluate_exactly(maze, own, other, horizon + 1, 1.0, order)
        least = task.min_start_distance
        steps = mean_over_starts(values, maze, least)
        # What one more step adds to the expected length is P(not caught by then).
        late = mean_over_starts(longer, maze, least) - steps
        return Matchup(steps, 0.0, 1.0 - late, 0)
    lengths, caught = play_pair(task, chaser, evader, episodes, seed)
    half = 1.96 * float(lengths.std(ddof=1)) / len(lengths) ** 0.5 if len(lengths) > 1 else 0.0
    return Matchup(float(lengths.mean()), half, float(caught.mean()), episodes)
