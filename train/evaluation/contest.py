"""Evaluation of one agent of a task in one maze, with exact references.

Small chases of one evader are evaluated exactly, by backward induction over the cells of all
agents. Other games are sampled from seeded starts that are the same for all policies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Rewards, Task
from scripted_agents import (
    BestResponse,
    HiddenChaseSolution,
    JointResponse,
    RandomAgent,
    TeamResponse,
    best_team_response,
    mean_over_starts,
    solve_joint,
)
from scripted_agents.environments import DEFAULTS
from scripted_agents.limits import MAX_WORK, SEARCH_SECONDS, work_of
from scripted_agents.references import (
    Solution,
    exact_work,
    is_exact_team,
    is_table_duel,
    reference_of,
)
from train.evaluation.departures import rates_of
from train.evaluation.games import Lengths, best_reply, half_width, table_in
from train.evaluation.hidden_contest import Certificate, discounted, solution_of
from train.evaluation.matchups import Matchup, exact_match
from train.evaluation.maze_contest import SCRIPTED, MazeContest
from train.evaluation.scores import (
    BY_GOALS,
    BY_RETURN,
    BY_STEPS,
    DISCOUNTED,
    FULL_VIEW,
    Measure,
    Reference,
    Score,
)

OUTCOMES = {
    "chaser": Rewards(capture=1.0, escape=-1.0, per_evader=True),
    "evader": Rewards(capture=-1.0, escape=1.0),
}
"""Rewards whose returns are captures minus escapes, and for an evader its negative."""


@dataclass(frozen=True)
class GameContest(MazeContest):
    """One agent of a task, against fixed policies of all other agents; a `Contest`.

    The optimum may use all actions. With `mask_bumps` the optimum without moves into walls is
    included. Whole games (teams, races, heists) are solved up to the size `most_work`
    (`work_of`). The search for a certificate takes at most `search_seconds`.
    """

    mask_bumps: bool = False
    most_work: int = MAX_WORK
    search_seconds: float = SEARCH_SECONDS

    @cached_property
    def exact_reference(self) -> Solution:
        """As `Contest`, for games of up to `most_work`."""
        return reference_of(self.task, self.agent, self.opponents, self.most_work)

    def solved_up_to(self, most_work: int) -> GameContest:
        """As `Contest`."""
        return replace(self, most_work=most_work)

    @property
    def is_table_duel(self) -> bool:
        """Whether the mean length over all starts is computed without sampling."""
        return is_table_duel(self.task, *self.opponents.values())

    def _means(self, simulator: Simulator) -> tuple[float, float | None]:
        """Mean return and number of goals of the agent, or of the team, in finished games."""
        returns, collected = (
            float(found[:, [*self.seats]].sum(axis=1).mean())
            for found in (simulator.returns, simulator.collected)
        )
        return returns, collected if self.task.num_goals else None

    def opponent_table(self) -> NDArray[np.float64]:
        """[self cell, other cell, action] of the opponent; requires `is_table_duel`."""
        assert self.opponent is not None  # is_table_duel
        return table_in(self.task, self.opponent)

    def exact_match(self, policy: Policy) -> Matchup | None:
        """The result over all starts; None if it is sampled."""
        most = exact_work(self.task, self.most_work)
        return exact_match(self.task, self.with_policy(policy), most)

    def score(self, name: str, policy: Policy) -> Score:
        """Exact over all starts if that can be computed; otherwise of sampled episodes."""
        certain: tuple[float, float] | tuple[None, None] = (None, None)
        bounded = self.is_limited and self.is_table_duel
        if (found := self.exact_match(policy)) is not None:
            if bounded:
                certain = discounted(self.task, self.role, policy, self.opponent_table())
            score = self._exact_score(name, found.steps, found.caught, *certain)
            if found.escaped is None:
                return score
            rates: Any = rates_of(found.caught, found.escaped, self.task.num_evaders)
            share = found.escaped if self.role == "evader" else found.caught
            return replace(score, **rates, success_rate=share, value_ci95=0.0)
        simulator = self.starts()
        lengths, won, left = self.played_out(simulator, policy)
        rates = {} if left is None else left.rates()
        if bounded:
            certain = discounted(self.task, self.role, policy, self.opponent_table(), lengths)
        mean, ci95, share = float(lengths.mean()), half_width(lengths), float(won.mean())
        more = (*certain, self._gap_of(lengths, won), *self._means(simulator))
        half = self._value_ci95(self.measured(simulator, lengths, left))
        return Score(name, mean, ci95, share, len(lengths), False, *more, **rates, value_ci95=half)

    def _value_ci95(self, values: NDArray[np.float64]) -> float | None:
        """The half width of the interval of values in the measure; None if that is steps."""
        return None if self.measure.by_steps else half_width(values)

    def _exact_score(self, name: str, steps: float, caught: float, *certain: float | None) -> Score:
        """The score of these expectations over all starts."""
        share = 1.0 - caught if self.role == "evader" else caught
        return Score(name, steps, 0.0, share, self.episodes, True, *certain)

    def _gap_of(self, lengths: NDArray[np.int64], won: NDArray[np.bool_]) -> float | None:
        """The gap to the shortest tours over the solved starts, if these are known."""
        if self.is_limited or self.tours is None or not won.any():
            return None
        return float(lengths[won].sum() / self.tours[won].sum()) - 1.0

    @cached_property
    def with_full_view(self) -> GameContest:
        """The same contest with a full view of this agent (or team): its optimum is a bound.

        The views of the other agents are unchanged.
        """
        task = self.task
        limits = dict(zip(task.agent_names, task.sight.limits, strict=True))
        for seat in self.seats:
            del limits[task.agent_names[seat]]
        sight: dict[str, Any] = {
            "view_radius": {name: limit.view_radius for name, limit in limits.items()},
            "line_of_sight": [name for name, limit in limits.items() if limit.line_of_sight],
            "unknown_maze": [name for name, limit in limits.items() if limit.unknown_maze],
        }
        return replace(self, task=replace(task, **sight))

    def solution(self) -> HiddenChaseSolution | None:
        """The proven bounds of the optimum under a limited view; None if there are none."""
        if self.exact_reference.kind != "bounds":
            return None
        return solution_of(self.task, self.agent, self.opponent_table(), self.search_seconds)

    def certificate(self) -> Certificate | None:
        """As `Contest`."""
        proven = self.solution()
        if proven is None:
            return None
        return Certificate(proven.role, proven.discount, proven.lower, proven.upper)

    def best_response(self, mask_bumps: bool = False) -> BestResponse | None:
        """The exact best response to the opponent; None unless `is_table_duel`."""
        if not self.is_table_duel:
            return None
        table, horizon = self.opponent_table(), self.task.max_steps
        return best_reply(self.task, self.role, table, horizon, mask_bumps=mask_bumps)

    def _score_of(self, name: str, best: BestResponse) -> Score:
        """The score of a best response."""
        starts = (self.task.mazes[0], self.task.min_start_distance)
        mean, caught = (mean_over_starts(each, *starts) for each in (best.values, best.captured))
        return self._exact_score(name, mean, caught)

    def best_team_response(self) -> TeamResponse | None:
        """The best response of this agent in a team chase; None if that is not solved, and with
        exits, see `best_of_outcomes`."""
        task, most = self.task, exact_work(self.task, self.most_work)
        if task.most_exits or not is_exact_team(task, self.with_policy(RandomAgent()), most):
            return None
        if self.task.options.turns:
            return self._joint_response(self.task)
        name = self.task.agent_names[self.seat]
        return best_team_response(self.task, name, self.opponents, self.task.max_steps)

    def optimal(self) -> Score | None:
        """The exact optimum on the same starts; None if it is not known.

        `exact_reference` says whether it is known. Also unknown if `max_steps` truncates every
        episode, with a limited view (see `certificate`), and if evaders collect goals (see
        `optimal_in`).
        """
        kind, most = self.exact_reference.kind, self.task.max_steps
        if kind == "duel" and (best := self.best_response()) is not None:
            return self._score_of("optimal", best)
        if kind == "team" and (team := self.best_team_response()) is not None:
            mean, (_, won) = team.mean_over_starts, self.play(team.policy)
            share = float(won.mean())
            return Score("optimal", mean, 0.0, share, self.episodes, True, apart="success: sampled")
        if kind == "joint" and self.best_of_steps is not None:
            return self._joint_score(self.best_of_steps, BY_STEPS)
        if kind != "tour" or self.tours is None:
            return None
        share = float((self.tours <= most).mean())
        if share == 0.0:  # every episode is truncated, so all policies have equal lengths
            return None
        lengths = np.minimum(self.tours, most)
        mean = float(lengths.mean())
        return Score("optimal", mean, half_width(lengths), share, self.episodes, False)

    @property
    def solves_whole_game(self) -> bool:
        """Whether `solve_joint` gives best responses of this agent."""
        kind = self.exact_reference.kind
        return kind == "joint" or (kind == "team" and work_of(self.task) <= self.most_work)

    def _joint_response(
        self, task: Task, objective: Literal["steps", "return"] = "steps"
    ) -> JointResponse:
        """The best response of this agent, or of this team as one player, in a whole game."""
        own = [task.agent_names[seat] for seat in self.seats]
        return solve_joint(task, own, self.opponents, task.max_steps, objective=objective)

    @cached_property
    def best_of_steps(self) -> JointResponse | None:
        """The best response in steps, for games that only `solve_joint` solves; None if the measure
        is not steps."""
        task = self.task
        heist = task.num_goals and task.num_evaders
        if heist or self.measure.name == "outcome" or not self.solves_whole_game:
            return None
        return self._joint_response(task)

    @cached_property
    def best_of_returns(self) -> JointResponse | None:
        """The best response in returns, if other agents compete for goals; None with a user-defined
        reward function."""
        task = self.task
        rivals = task.num_goals and task.num_agents > 1
        if not rivals or task.reward_function is not None or not self.solves_whole_game:
            return None
        return self._joint_response(task, "return")

    @cached_property
    def best_of_goals(self) -> JointResponse | None:
        """The best response in goals of a runner in a race, for any rewards."""
        if self.measure != BY_GOALS or not self.solves_whole_game:
            return None
        by_goals = replace(self.task, rewards={self.role: Rewards(goal=1.0)})
        return self._joint_response(by_goals, "return")

    @cached_property
    def best_of_outcomes(self) -> JointResponse | None:
        """The best response in captures minus escapes (of an evader, in its negative); None if that
        is not the measure."""
        if self.measure.name != "outcome" or not self.solves_whole_game:
            return None
        return self._joint_response(self.by_outcome, "return")

    @property
    def by_outcome(self) -> Task:
        """The task with rewards whose sum over the evaluated agents is captures minus escapes (of
        evaders its negative)."""
        shared = 1.0 / len(self.seats)
        own = replace(OUTCOMES["chaser"], capture=shared, escape=-shared)
        rewards = {**OUTCOMES, "chaser": own if self.role == "chaser" else OUTCOMES["chaser"]}
        return replace(self.task, rewards=rewards)

    def _joint_score(self, best: JointResponse, measure: Measure) -> Score:
        """The score of a best response: exact expectations in this measure from the starts of the
        evaluation, or over all starts if scores are; the other columns are sampled."""
        name = measure.optimum
        simulator = self.starts()
        expected = best.values_of(simulator.games)
        if self.exact_reference.kind == "team":
            expected = np.full_like(expected, best.mean_over_starts)
        if measure.name == "outcome" and measure.less_is_better:
            expected = -expected
        lengths, won, left = self.played_out(simulator, best.policy)
        in_steps: Lengths = expected if measure is BY_STEPS else lengths
        mean, ci95, share = float(in_steps.mean()), half_width(in_steps), float(won.mean())
        means = dict(zip(("mean_return", "mean_goals"), self._means(simulator), strict=True))
        means |= {} if left is None else left.rates()
        values, others = self.measured(simulator, lengths, left), "success: sampled"
        if measure is not BY_STEPS:
            means[measure.column] = float(expected.mean())
            others = "the rest sampled"
        if measure == self.measure:
            values = expected
        more: Any = means | {"value_ci95": self._value_ci95(values), "apart": others}
        return Score(name, mean, ci95, share, self.episodes, False, **more)

    def optimal_in(self, measure: Measure) -> Score | None:
        """The best response in returns, in the goals of a runner in a race, or in captures minus
        escapes: its exact expectation from the same starts. None if it is not known, or if no other
        agent competes for goals."""
        best = self.best_of_goals if measure == BY_GOALS else self.best_of_returns
        best = self.best_of_outcomes if measure.name == "outcome" else best
        return None if best is None else self._joint_score(best, measure)

    def _optima(self) -> list[Score]:
        """The known exact optima in steps, goals and returns."""
        found = [self.optimal(), self.optimal_in(BY_GOALS), self.optimal_in(BY_RETURN)]
        if self.measure.name == "outcome":
            found.append(self.optimal_in(self.measure))
        return [score for score in found if score is not None]

    def baselines(self) -> list[Score]:
        """Random, scripted (A* or nearest goal) and the known optima."""
        scores = [
            self.score("random", RandomAgent()),
            self.score(SCRIPTED[self.role], DEFAULTS[self.role](0.0)),
        ]
        scores += [self.score(name, policy) for name, policy in self.limited.items()]
        solution = self.solution()
        if solution is not None:
            scores.append(self.score("certified", solution.policy))
        if self.is_limited:
            full = self.with_full_view._optima()
            scores += [replace(best, name=f"{best.name}{FULL_VIEW}") for best in full]
        scores += self._optima()
        best = self.best_response(mask_bumps=True) if self.mask_bumps else None
        return scores if best is None else [*scores, self._score_of("optimal with masks", best)]

    def reference(self, scores: Sequence[Score], learned: Score) -> Reference | None:
        """As `Contest`: the certified bound, else the exact optimum, a bound, or the best known."""
        proven, steps = self.certificate(), learned.discounted_steps
        if proven is not None and steps is not None:
            name = "optimum under limited view, pessimistic bound"
            return Reference("certified", name, DISCOUNTED, proven.far, proven.gap(steps))
        return super().reference(scores, learned)

    def optimal_lengths(self) -> NDArray[np.float64] | None:
        """As `Contest`; known for duels, single runners, and whole games measured in steps."""
        if self.is_limited:
            return None
        best = self.best_response()
        if best is not None:
            return best.values[tuple(self.starts().positions.T)]
        if self.best_of_steps is not None:
            return self.best_of_steps.values_of(self.starts().games)
        if self.tours is None:
            return None
        return np.minimum(self.tours, self.task.max_steps).astype(np.float64)
