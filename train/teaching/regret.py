"""Exams: how far the learner, as it is now, falls short of the optimum in some mazes, exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from scripted_agents import mean_over_starts
from train.evaluation.games import best_reply, other_role
from train.evaluation.suite_tables import (
    is_known,
    is_solvable,
    opponent_tables,
    pairs_of_values,
    tables_of,
)
from train.settings.checks import check

REGRET, LEARNABILITY = "regret", "learnability"


class RegretScorer:
    """Marks for mazes of a task: exact, over all starts and all chance, without playing a step.

    - "regret": how far the mean steps fall short of the optimum of that maze, as a share of it.
    - "learnability": the mean over starts of p(1 - p), p the chance that an episode from there is
      won (Rutherford et al., 2024; there of whole levels, by playing).

    Args:
        task: with all mazes of the training games.
        agent: who learns, by name or role.
        opponents: the policy of every other role; they stay as they are.
        mark: "regret" or "learnability".

    Raises:
        ValueError: a task whose policies are not solved: neither a runner with one goal nor a duel
            against a policy that is known.
    """

    def __init__(
        self, task: Task, agent: str, opponents: Mapping[str, Policy], mark: str = REGRET
    ) -> None:
        self.task, self.seat, self.mark = task, task.seat(agent), mark
        self.role = task.seat_roles[self.seat]
        self.opponent = opponents.get(other_role(self.role))
        check(
            is_solvable(task, self.opponent),
            f"exact regrets are known of a runner with one goal and of duels against policies that "
            f"are tables, at random starts, and task {task.name!r} with these agents is neither; "
            "take level-replay or learnability, or num_goals=1",
        )
        self._optima: dict[int, float] = {}

    def marks(self, policy: Any, mazes: NDArray[np.int64]) -> NDArray[np.float64]:
        """[mazes] float64, at least 0, of the mazes of these numbers.

        Raises:
            ValueError: a policy that is not known at all cells, as one that remembers.
        """
        check(
            is_known(policy),
            "an exact regret needs a policy that is a function of what it sees; this one remembers",
        )
        part = replace(self.task, maze=tuple(self.task.mazes[number] for number in mazes))
        others = opponent_tables(self.opponent, part, self.seat)
        found = pairs_of_values(part, self.seat, tables_of(policy, part, self.seat), others)
        marks = np.zeros(len(mazes))
        for place, (number, (steps, caught)) in enumerate(zip(mazes, found, strict=True)):
            least = part.min_start_distance
            if self.mark == LEARNABILITY:
                chance = np.clip(caught, 0.0, 1.0)
                marks[place] = mean_over_starts(chance * (1.0 - chance), part.mazes[place], least)
            else:
                mean = mean_over_starts(steps, part.mazes[place], least)
                best = self.optimum(int(number))
                short = 1.0 - mean / best if self.role == "evader" else mean / best - 1.0
                marks[place] = max(short, 0.0)
        return marks

    def optimum(self, number: int) -> float:
        """The mean steps of the best play in a maze."""
        if number not in self._optima:
            task, maze = self.task, self.task.mazes[number]
            least = task.min_start_distance
            if self.opponent is None:
                found = mean_over_starts(np.minimum(maze.distances, task.max_steps), maze, least)
            else:
                alone = replace(task, maze=maze)
                (table,) = opponent_tables(self.opponent, alone, self.seat)
                solved = best_reply(task, self.role, table, task.max_steps, maze=maze)
                found = mean_over_starts(solved.values, maze, least)
            self._optima[number] = found
        return self._optima[number]
