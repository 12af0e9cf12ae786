"""Evaluation of one agent of a task in one maze, with exact references.

Small chases of one evader are evaluated exactly, by backward induction over the cells of all
agents. Other games are sampled from seeded starts that are the same for all policies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pursuit.replays.viewer.data import Overlay
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Rewards, Task
from pursuit.validation import check
from scripted_agents import (
    BestResponse,
    HiddenChaseSolution,
    JointResponse,
    RandomAgent,
    TablePolicy,
    TourRunner,
    count_joint_states,
    mean_over_starts,
    solve_joint,
    why_not_optimal,
    why_not_team_chase,
)
from scripted_agents.environments import DEFAULTS
from scripted_agents.exact.duel.best_response import random_starts
from scripted_agents.exact.limits import (
    MAX_OBJECTIVE_CELLS,
    MAX_OBJECTIVE_WORK,
    MAX_WORK,
    SEARCH_SECONDS,
    is_single_runner,
    why_no_tour,
    work_of,
)
from scripted_agents.exact.long_work import OutOfTime, why_no_time
from scripted_agents.exact.references import (
    Solution,
    exact_work,
    is_table_duel,
    is_table_in,
    reference_of,
)
from scripted_agents.exact.tours.tour import expected_tour_length, num_states
from train.evaluation.departures import OUTCOME_REWARDS, rates_of
from train.evaluation.games import Lengths, best_reply, half_width, table_in, values_between
from train.evaluation.hidden_contest import Certificate, bounds_in, discounted
from train.evaluation.matchups import Matchup, exact_match
from train.evaluation.maze_contest import SCRIPTED_TITLES, MazeContest
from train.evaluation.objective_gap import duel_gap, joint_gap, tour_gap
from train.evaluation.optimal_policy import OptimalActions
from train.evaluation.recordings import MOST_BOTH_CELLS, MOST_OVERLAY_CELLS, duel_overlays
from train.evaluation.scores import (
    BY_GOALS,
    BY_RETURN,
    BY_STEPS,
    DISCOUNTED,
    FULL_VIEW,
    OUTCOME,
    UNKNOWN_GAP,
    Measure,
    ObjectiveGap,
    Reference,
    Score,
    not_imitable,
)


@dataclass(frozen=True)
class GameContest(MazeContest):
    """One agent of a task, against fixed policies of all other agents; a `Contest`.

    The optimum may use all actions. With `mask_bumps` the optimum without moves into walls is
    included. Whole games (teams, races, heists) are solved up to the size `most_work`
    (`work_of`). The search for a certificate takes at most `search_seconds`.
    """

    most_work: int = MAX_WORK
    search_seconds: float = SEARCH_SECONDS

    @cached_property
    def exact_reference(self) -> Solution:
        """As `Contest`, for games of up to `most_work`."""
        return reference_of(self.task, self.agent, self.opponents, self.most_work)

    def solved_up_to(self, most_work: int) -> GameContest:
        """As `Contest`."""
        return replace(self, most_work=most_work)

    def brief(self, steps: int) -> Self:
        """As `Contest`."""
        return replace(super().brief(steps), most_work=0, search_seconds=0.0)

    @property
    def why_no_optimum(self) -> str:
        """As `Contest`."""
        return self.full.exact_reference.reason

    def facts(self) -> Iterator[str]:
        """As `Contest`: the number of states, and the optima over all starts, or why none is
        known."""
        task, maze = self.task, self.task.mazes[0]
        if is_single_runner(task):
            if why_no_tour(task.num_goals) is None:
                mean = expected_tour_length(maze, task.num_goals)
                how = "exact" if mean.exact else f"±{mean.ci95:.2f}, sampled"
                yield f"mean optimal tour over all placements: {mean:.4f} ({how})"
            yield f"distinct states: {num_states(maze.num_cells, task.num_goals):,}"
        elif why_not_team_chase(task) is None:
            cells, chasers = maze.num_cells, task.num_chasers
            yield f"distinct states: {(cells - 1) ** chasers * cells:,}"
        else:
            yield f"distinct states: {count_joint_states(task):,}"
            yield from self._optima_over_starts()

    def _optima_over_starts(self) -> Iterator[str]:
        """The optima of a game of several agents over all starts, or why they are not known."""
        if self.exact_reference.reason:
            yield f"no exact optimum: {self.exact_reference.reason}"
            return
        agent = self.agent
        found = (
            ("mean optimum over all starts", " steps", BY_STEPS),
            (f"highest return of {agent}, over all starts", "", BY_RETURN),
            (f"most goals of {agent}, over all starts", "", BY_GOALS),
        )
        outcome = self.best_in(self.measure)
        if outcome is not None and self.measure.name == "outcome":
            mean = outcome.mean_over_starts * (-1.0 if self.role == "evader" else 1.0)
            yield f"{OUTCOME} with the best {agent}, over all starts: {mean:.4f} (exact)"
        for text, unit, measure in found:
            if (best := self.best_in(measure)) is not None:
                yield f"{text}: {best.mean_over_starts:.4f}{unit} (exact)"

    @property
    def is_table_duel(self) -> bool:
        """Whether it is a duel that is solved, apart from a limited view of the agent."""
        return self.full.exact_reference.kind == "duel"

    def _means(self, simulator: Simulator) -> tuple[float, float | None]:
        """Mean return and number of goals of the agent, or of the team, in finished games."""
        returns, collected = (
            float(found[:, [*self.seats]].sum(axis=1).mean())
            for found in (simulator.returns, simulator.collected)
        )
        return returns, collected if self.task.num_goals else None

    def opponent_table(self) -> NDArray[np.float64]:
        """[self cell, other cell, action] of the opponent; requires `is_table_duel`."""
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
        more = (*certain, self._gap_of(lengths, won), *self._means(simulator))
        half = self._value_ci95(self.measured(simulator, lengths, left))
        return Score.of_episodes(name, lengths, won, *more, **rates, value_ci95=half)

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
    def full(self) -> Self:
        """The contest whose optimum is the best response: with a full view of this agent (or team).

        The views of the other agents are unchanged.
        """
        if not self.is_limited:
            return self
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
        return bounds_in(self.task, self.agent, self.opponent_table(), self.search_seconds)

    def certificate(self) -> Certificate | None:
        """As `Contest`."""
        proven = self.solution()
        if proven is None:
            return None
        return Certificate(proven.role, proven.discount, proven.lower, proven.upper)

    # -- optima --------------------------------------------------------------------------------

    @cached_property
    def _best(self) -> dict[str, BestResponse | JointResponse | None]:
        """The results of `best_in`, by name of the measure."""
        return {}

    def best_in(self, measure: Measure = BY_STEPS) -> BestResponse | JointResponse | None:
        """The exact best response of this agent, or of this team as one player, solved once.

        None if no solver takes this game (`exact_reference`), in a measure that is no aim in it
        (`_aims`), and for a runner alone, whose optimum is `tours`.
        """
        name, kind = measure.name, self.exact_reference.kind
        if name not in self._best:
            solved: BestResponse | JointResponse | None = None
            if kind == "duel" and measure.by_steps:
                solved = self._best_reply()
            elif kind in ("team", "joint") and name in self._aims:
                task, objective = self._aims[name]
                own = [task.agent_names[seat] for seat in self.seats]
                given: Any = {"objective": objective}
                solved = solve_joint(task, own, self.opponents, task.max_steps, **given)
            self._best[name] = solved
        return self._best[name]

    @property
    def _aims(self) -> dict[str, tuple[Task, str]]:
        """By name of a measure, the task and the objective of `solve_joint` whose value it is.

        Steps, but not if evaders collect goals or may escape; returns, if other agents compete for
        goals, but for user-defined rewards; and the measure of the contest.
        """
        task, measure, aims = self.task, self.measure.name, {}
        if measure != "outcome" and not (task.num_goals and task.num_evaders):
            aims["steps"] = task, "steps"
        if task.num_goals and task.num_agents > 1 and task.reward_function is None:
            aims["return"] = task, "return"
        if measure == "goals":
            aims["goals"] = replace(task, rewards={self.role: Rewards(goal=1.0)}), "return"
        if measure == "outcome":
            aims["outcome"] = self.by_outcome, "return"
        return aims

    @property
    def by_outcome(self) -> Task:
        """The task with rewards whose sum over the evaluated agents is captures minus escapes (of
        evaders its negative)."""
        rewards = dict(OUTCOME_REWARDS)
        if self.role == "chaser":
            shared = 1.0 / len(self.seats)
            rewards["chaser"] = replace(rewards["chaser"], capture=shared, escape=-shared)
        return replace(self.task, rewards=rewards)

    def _best_reply(self, mask_bumps: bool = False) -> BestResponse:
        """The best response in a duel."""
        table, horizon = self.opponent_table(), self.task.max_steps
        return best_reply(self.task, self.role, table, horizon, mask_bumps=mask_bumps)

    def _duel_score(self, name: str, best: BestResponse) -> Score:
        """The score of a best response in a duel."""
        starts = (self.task.mazes[0], self.task.min_start_distance)
        mean, caught = (mean_over_starts(each, *starts) for each in (best.values, best.captured))
        return self._exact_score(name, mean, caught)

    def optimal(self, measure: Measure = BY_STEPS) -> Score | None:
        """The exact optimum in a measure on the same starts, or over all; None if it is not known.

        `exact_reference` says whether it is known, and `best_in` in which measures. Also unknown if
        `max_steps` truncates every episode of a runner alone, and with a limited view (see
        `certificate`).
        """
        best, kind = self.best_in(measure), self.exact_reference.kind
        if isinstance(best, BestResponse):
            return self._duel_score("optimal", best)
        if best is not None and kind == "team" and measure.by_steps:
            mean, share = best.mean_over_starts, float(self.play(best.policy)[1].mean())
            return Score("optimal", mean, 0.0, share, self.episodes, True, apart="success: sampled")
        if best is not None:
            return self._joint_score(best, measure)
        if kind != "tour" or self.tours is None or not measure.by_steps:
            return None
        most = self.task.max_steps
        within = self.tours <= most
        if not within.any():  # every episode is truncated, so all policies have equal lengths
            return None
        return Score.of_episodes("optimal", np.minimum(self.tours, most), within)

    def best_policy(self) -> Policy:
        """As `Contest`."""
        by_steps = self.measure.by_steps
        own = self.full if by_steps and len(self.seats) == 1 else self
        outcome, kind = self.measure.name == "outcome", own.exact_reference.kind
        best = own.best_in(self.measure) if outcome or kind in ("duel", "team") else None
        if isinstance(best, BestResponse):
            return TablePolicy(self.task.mazes[0], best.policy)
        if best is not None:
            return best.policy
        reason = why_not_optimal(self.task, "runner")
        if self.role != "runner":
            reason = "the best response to these agents in this task is not solved"
        check(reason is None, f"optimal {self.role}: {reason}; leave out --optimal")
        return TourRunner()

    def optimal_actions(self) -> OptimalActions:
        """As `MazeContest`; of a team one joint action (`JointResponse.optimal_actions`)."""
        if self.exact_reference.kind in ("tour", "duel"):
            return super().optimal_actions()
        best = self.best_in(self.measure)
        if not isinstance(best, JointResponse):
            raise not_imitable("it is not solved")
        return best.optimal_actions

    def optimum(self) -> Score | None:
        """As `Contest`."""
        return self.optimal(self.measure)

    def is_exact_for(self, policy: Policy) -> bool:
        """As `Contest`: of tables in a duel."""
        return self.is_table_duel and is_table_in(self.task, policy)

    def optima(self) -> list[Score]:
        """The known exact optima in steps, goals, returns and outcomes."""
        measures = {each.name: each for each in (BY_STEPS, BY_GOALS, BY_RETURN)}
        measures |= {self.measure.name: self.measure} if self.measure.name == "outcome" else {}
        found = map(self.optimal, measures.values())
        return [score for score in found if score is not None]

    def _joint_score(self, best: JointResponse, measure: Measure) -> Score:
        """The score of a best response: exact expectations in this measure from the starts of the
        evaluation, or over all starts if scores are; the other columns are sampled."""
        simulator = self.starts()
        expected = best.values_of(simulator.games)
        if self.exact_reference.kind == "team":
            expected = np.full_like(expected, best.mean_over_starts)
        if measure.name == "outcome" and measure.less_is_better:
            expected = -expected
        lengths, won, left = self.played_out(simulator, best.policy)
        in_steps: Lengths = expected if measure.by_steps else lengths
        means = dict(zip(("mean_return", "mean_goals"), self._means(simulator), strict=True))
        means |= {} if left is None else left.rates()
        values, others = self.measured(simulator, lengths, left), "success: sampled"
        if not measure.by_steps:
            means[measure.column] = float(expected.mean())
            others = "the rest sampled"
        if measure == self.measure:
            values = expected
        more: Any = means | {"value_ci95": self._value_ci95(values), "apart": others}
        return Score.of_episodes(measure.optimum, in_steps, won, **more)

    def objective_gap(self, discount: float) -> ObjectiveGap:
        """As `Contest`.

        Ties are broken by the fewest steps (evader: the most), in a whole game (team, race, heist)
        arbitrarily. In a race both values are known. The gap in steps is large there with any
        discount, as rewards for goals do not favour short games.

        Unknown for games that are too large, action masks, distance or user-defined rewards,
        several mazes, starts at marks, a team as one player, too many goals to enumerate, rewards
        that do not favour short episodes (evader: long ones), a limited view, a whole game without
        discount, and discount 0.
        """
        if self.is_limited or discount == 0.0 or len(self.seats) > 1:
            return UNKNOWN_GAP
        task, rewards = self.task, self.task.role_rewards[self.role]
        by_time = rewards.distance == 0.0 and task.reward_function is None
        if len(task.mazes) > 1 or task.start != "random" or not by_time:
            return UNKNOWN_GAP
        if is_single_runner(task):
            return ObjectiveGap(tour_gap(task, rewards, discount))
        if self.is_table_duel and not self.mask_bumps and task.max_cells <= MAX_OBJECTIVE_CELLS:
            best: Any = self.best_in()
            given = (task, self.role, self.opponent_table(), best, discount)
            return UNKNOWN_GAP if best is None else ObjectiveGap(duel_gap(*given))
        masked_or_large = self.mask_bumps or work_of(task) > MAX_OBJECTIVE_WORK
        if self.is_table_duel or masked_or_large or discount >= 1.0:
            return UNKNOWN_GAP
        name = task.agent_names[self.seat]
        try:
            return joint_gap(task, name, self.opponents, self.measure, self.best_in, discount)
        except OutOfTime:  # the optimum is known already
            if why_no_time(work_of(task)) is None:
                raise
            return UNKNOWN_GAP

    def baselines(self) -> list[Score]:
        """Random, scripted (A* or nearest goal) and the known optima."""
        scores = [
            self.score("random", RandomAgent()),
            self.score(SCRIPTED_TITLES[self.role], DEFAULTS[self.role](0.0)),
        ]
        scores += [self.score(name, policy) for name, policy in self.limited.items()]
        solution = self.solution()
        if solution is not None:
            scores.append(self.score("certified", solution.policy))
        if self.is_limited:
            bounds = self.full.optima()
            scores += [replace(best, name=f"{best.name}{FULL_VIEW}") for best in bounds]
        scores += self.optima()
        if self.mask_bumps and self.is_table_duel:
            scores.append(self._duel_score("optimal with masks", self._best_reply(mask_bumps=True)))
        return scores

    def reference(self, scores: Sequence[Score], learned: Score) -> Reference | None:
        """As `Contest`: the certified bound, else the exact optimum, a bound, or the best known."""
        proven, steps = self.certificate(), learned.discounted_steps
        if proven is not None and steps is not None:
            name = "optimum under limited view, pessimistic bound"
            return Reference("certified", name, DISCOUNTED, proven.far, proven.gap(steps))
        return super().reference(scores, learned)

    def overlays(self, policy: Policy, most_both: int = MOST_BOTH_CELLS) -> list[Overlay]:
        """As `MazeContest`."""
        task = self.task
        if not self.is_table_duel or task.max_cells > MOST_OVERLAY_CELLS:
            return []
        learned = table_in(task, policy) if is_table_duel(task, policy) else None
        return duel_overlays(task, self.seat, self.opponent_table(), learned, most_both)

    def optimal_lengths(self) -> NDArray[np.float64] | None:
        """As `Contest`; known for duels, single runners, and whole games measured in steps."""
        best = self.best_in()
        if isinstance(best, BestResponse):
            return best.values[tuple(self.starts().positions.T)]
        if best is not None:
            return best.values_of(self.starts().games)
        if self.is_limited or self.tours is None:
            return None
        return np.minimum(self.tours, self.task.max_steps).astype(np.float64)

    def lost_by_start(self, policy: Policy) -> NDArray[np.float64] | None:
        """As `Contest`: in duels of tables exact, the mean over the opponent's start cells; for a
        runner alone over the starts of the evaluation."""
        task = self.task
        if len(task.mazes) > 1 or not self.measure.by_steps:
            return None
        best = self.optimal_lengths()
        if best is None:
            return None
        if self.is_exact_for(policy) and not self.is_limited:
            tables, response = (table_in(task, policy), self.opponent_table()), self.best_in()
            assert isinstance(response, BestResponse)
            lost = values_between(task, self.role, tables, task.max_steps).values - response.values
            starts = np.nonzero(random_starts(task.mazes[0], task.min_start_distance))
            cells: NDArray[Any] = starts[self.seat]
            lost = lost[starts]
        elif is_single_runner(task):
            cells, lost = self.starts().positions[:, self.seat], self.play(policy)[0] - best
        else:
            return None
        lost, most = lost if self.measure.less_is_better else -lost, task.max_cells
        with np.errstate(invalid="ignore"):
            return np.bincount(cells, lost, most) / np.bincount(cells, minlength=most)
