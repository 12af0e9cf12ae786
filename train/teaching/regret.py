"""Exact scores of mazes: the regret or the learnability of the current policy in each maze."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from pursuit.validation import check
from scripted_agents import mean_over_starts
from scripted_agents.exact.references import is_known, is_solvable
from train.evaluation.games import best_reply, other_role
from train.evaluation.suite_tables import opponent_tables, pairs_of_values, tables_of

REGRET, LEARNABILITY = "regret", "learnability"


class RegretScorer:
    """Scores mazes of a task exactly, over all starts and random events, without simulation.

    - "regret": the relative difference of the mean steps to the optimum in that maze.
    - "learnability": the mean over starts of p(1 - p), where p is the success probability from that
      start. Rutherford et al. (2024) estimate it for whole levels by simulation.

    Args:
        task: with all mazes of the training games.
        agent: the learning agent, by name or role.
        opponents: the fixed policy of every other role.
        score: "regret" or "learnability".

    Raises:
        ValueError: a task that cannot be solved: neither a runner with one goal nor a duel
            against a tabular policy.
    """

    def __init__(
        self, task: Task, agent: str, opponents: Mapping[str, Policy], score: str = REGRET
    ) -> None:
        self.task, self.seat, self.score = task, task.seat(agent), score
        self.role = task.seat_roles[self.seat]
        self.opponent = opponents.get(other_role(self.role))
        check(
            is_solvable(task, self.opponent),
            f"exact scores are known for a runner with one goal and for duels against a tabular "
            f"policy, at random starts, and task {task.name!r} with these agents is neither; use "
            "curriculum level-replay or learnability, or num_goals=1",
        )
        self._optima: dict[int, float] = {}

    def scores(self, policy: Policy, mazes: NDArray[np.int64]) -> NDArray[np.float64]:
        """[mazes] float64, at least 0, the scores of the mazes with these indices.

        Raises:
            ValueError: a policy that is no table, such as a recurrent one.
        """
        check(
            is_known(self.task, policy),
            "exact scores need a policy without memory; leave out recurrent and frame_stack",
        )
        part = replace(self.task, maze=tuple(self.task.mazes[number] for number in mazes))
        others = opponent_tables(self.opponent, part, self.seat)
        values = pairs_of_values(part, self.seat, tables_of(policy, part, self.seat), others)
        scores = np.zeros(len(mazes))
        for place, (number, (steps, caught)) in enumerate(zip(mazes, values, strict=True)):
            least = part.min_start_distance
            if self.score == LEARNABILITY:
                chance = np.clip(caught, 0.0, 1.0)
                scores[place] = mean_over_starts(chance * (1.0 - chance), part.mazes[place], least)
            else:
                mean = mean_over_starts(steps, part.mazes[place], least)
                best = self.optimum(int(number))
                short = 1.0 - mean / best if self.role == "evader" else mean / best - 1.0
                scores[place] = max(short, 0.0)
        return scores

    def optimum(self, number: int) -> float:
        """The mean steps of the optimal policy in a maze."""
        if number not in self._optima:
            task, maze = self.task, self.task.mazes[number]
            least = task.min_start_distance
            if self.opponent is None:
                steps = mean_over_starts(np.minimum(maze.distances, task.max_steps), maze, least)
            else:
                alone = replace(task, maze=maze)
                (table,) = opponent_tables(self.opponent, alone, self.seat)
                solved = best_reply(task, self.role, table, task.max_steps, maze=maze)
                steps = mean_over_starts(solved.values, maze, least)
            self._optima[number] = steps
        return self._optima[number]
