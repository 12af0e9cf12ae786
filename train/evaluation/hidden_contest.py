"""Certified bounds of the optimum of an agent with a limited view.

The best response to an opponent is the optimum of an agent with full view. For a limited view
`solve_hidden_chase` proves an interval of the optimum in discounted steps, so scores are given in
discounted steps as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from pursuit.mazes.maze import Maze
from pursuit.rules.arrays import Longs, Reals
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from scripted_agents import HiddenChaseSolution, mean_over_starts, solve_hidden_chase
from scripted_agents.exact.limits import SEARCH_SECONDS, SEARCH_WIDTH
from scripted_agents.exact.references import is_table_in
from train.evaluation.games import best_reply, duel_role, half_width, mean_steps, order_of, table_in

DISCOUNT = 0.95


@dataclass(frozen=True)
class Certificate:
    """The proven interval of the optimum's mean over the starts, in discounted steps."""

    role: str
    discount: float
    lower: float
    upper: float

    def gap(self, discounted_steps: float) -> float:
        """Achieved / optimal - 1 at the pessimistic end of the interval.

        The true gap of a chaser is at most this. The true gap of an evader is at most 0 and at
        least this.
        """
        return discounted_steps / self.far - 1.0

    @property
    def far(self) -> float:
        """The pessimistic end of the interval, with the larger gap."""
        return self.lower if self.role == "chaser" else self.upper

    @property
    def head(self) -> str:
        """The header of a column of such gaps."""
        return "gap at most" if self.role == "chaser" else "gap at least"

    def line(self) -> str:
        """The interval as one line of text."""
        return (
            f"optimum under limited view, proven: {self.lower:.4f} to {self.upper:.4f} discounted "
            f"steps (discount {self.discount:g}; {100 * (self.upper / self.lower - 1):.2f} % wide)"
        )


def bounds_in(
    task: Task, agent: str, table: Reals, seconds: float = SEARCH_SECONDS
) -> HiddenChaseSolution:
    """The bounds of a duel in one maze against a table, cached."""
    limit = task.sight.limits[task.seat(agent)]
    return _solution(
        task.mazes[0],
        table.tobytes(),
        table.shape,
        view_radius=limit.view_radius,
        line_of_sight=limit.line_of_sight,
        seconds=seconds,
        role=duel_role(task.seat_roles[task.seat(agent)]),
        stay_action=task.stay_action,
        move_order=order_of(task),
        min_start_distance=task.min_start_distance,
    )


@lru_cache(maxsize=16)
def _solution(
    maze: Maze, table: bytes, shape: tuple[int, ...], **rules: Any
) -> HiddenChaseSolution:
    opponent = np.frombuffer(table).reshape(shape)
    return solve_hidden_chase(maze, opponent, discount=DISCOUNT, width=SEARCH_WIDTH, **rules)


def best_response_interval(
    task: Task, role: str, table: Reals, seconds: float = SEARCH_SECONDS
) -> tuple[float, float]:
    """Bounds of the best response of a role, with its view, to the table of its opponent.

    Args:
        task: a duel in one maze that `INTERVALS` of `scripted_agents.exact.references` solve.
        role: of the best response.
        table: [own cell, other cell, action] of its opponent.
        seconds: of the search for an interval.

    Returns:
        The mean over the starts in discounted steps: a proven interval with a limited view, twice
        the exact value with full view.
    """
    (agent,) = (task.agent_names[seat] for seat, own in enumerate(task.seat_roles) if own == role)
    if task.hides_from(agent):
        proven = bounds_in(task, agent, table, seconds)
        return float(proven.lower), float(proven.upper)
    best = best_reply(task, role, table, None, DISCOUNT)
    mean = mean_over_starts(best.values, task.mazes[0], task.min_start_distance)
    return mean, mean


def discounted(
    task: Task, role: str, policy: Policy, table: Reals, lengths: Longs | None = None
) -> tuple[float, float]:
    """The mean discounted steps of a policy, and half the width of its 95 % confidence interval.

    Exact over all starts, without time limit, for a policy that is a table. Otherwise from sampled
    games with `lengths` [games]: truncated games count as the worst case for `role`, as infinite
    for a chaser, and as ended there for an evader.
    """
    if lengths is None or is_table_in(task, policy):
        return mean_steps(task, role, (table_in(task, policy), table), None, DISCOUNT), 0.0
    steps = (1.0 - DISCOUNT ** lengths.astype(np.float64)) / (1.0 - DISCOUNT)
    if role == "chaser":
        steps = np.where(lengths >= task.max_steps, 1.0 / (1.0 - DISCOUNT), steps)
    return float(steps.mean()), half_width(steps)
