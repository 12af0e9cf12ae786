"""Evaluation in several mazes, with the exact optimum of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.suite_files import suite_names, suite_rows
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import BestResponse, RandomAgent, mean_over_starts
from scripted_agents.environments import DEFAULTS
from scripted_agents.exact.limits import SOLVED_MAZES
from scripted_agents.exact.references import Solution, is_known, is_solvable, reference_of
from train.evaluation.departures import Departures
from train.evaluation.games import Lengths, best_reply, half_width
from train.evaluation.maze_contest import SCRIPTED_TITLES, MazeContest
from train.evaluation.scores import Measure, Score
from train.evaluation.suite_tables import opponent_tables, pairs_of_values, tables_of
from train.files import Plain


@dataclass(frozen=True, eq=False)
class InMazes:
    """The results of one policy in each maze.

    Attributes:
        name: of the policy.
        steps: [mazes] mean episode length.
        success: [mazes] share of episodes won.
        exact: whether `steps` and `success` are exact expectations over all starts.
        lengths: [games] of the sampled episodes; None if exact.
        returns, goals: [games] returns and goals of the agent; None if exact or not sampled.
        left: how evaders left; None without exits.
    """

    name: str
    steps: NDArray[np.float64]
    success: NDArray[np.float64]
    exact: bool
    lengths: Lengths | None = None
    returns: NDArray[np.float64] | None = None
    goals: NDArray[np.float64] | None = None
    left: Departures | None = None

    def score(self, episodes: int) -> Score:
        """The mean over the mazes, with equal weights."""
        mean, won = float(self.steps.mean()), float(self.success.mean())
        ci95 = 0.0 if self.lengths is None else half_width(self.lengths)
        returns, goals = (
            None if found is None else float(found.mean()) for found in (self.returns, self.goals)
        )
        rest: dict[str, Any] = {"mean_return": returns, "mean_goals": goals}
        if self.left is not None:
            rest |= {**self.left.rates(), "value_ci95": half_width(self.left.outcome)}
        return Score(self.name, mean, ci95, won, episodes, self.exact, **rest)

    def values(self, measure: Measure) -> NDArray[np.float64] | None:
        """[mazes] the mean of a measure in each maze; None if it was not sampled."""
        if measure.by_steps:
            return self.steps
        found = self.goals if measure.name == "goals" else self.returns
        if measure.name == "outcome":
            found = None if self.left is None else self.left.outcome
        return None if found is None else found.reshape(len(self.steps), -1).mean(axis=1)


@dataclass(frozen=True)
class SuiteContest(MazeContest):
    """Evaluation of one agent in several mazes against fixed policies; a `Contest`.

    Duels and runners with one goal can be exact: expectations over all starts of each maze. Other
    tasks are sampled, with the same seeded starts for all policies, equally many per maze.

    Attributes:
        task: with several mazes.
        agent, opponents, episodes, seed: as in `GameContest`.
        exact: whether policies are evaluated exactly if possible, instead of sampled.
    """

    why_no_optimum: ClassVar[str] = ""  # it is that of each maze

    exact: bool = False

    def exactly(self, policies: Iterable[Policy] = ()) -> SuiteContest:
        """As `Contest`."""
        return replace(self, exact=all(is_known(self.task, policy) for policy in policies))

    @property
    def by_maze(self) -> SuiteContest:
        """As `Contest`."""
        return self

    def best_policy(self) -> Policy:
        """As `Contest`."""
        raise ValueError("the optimum in several mazes is not one policy; give one of the mazes")

    @property
    def exact_reference(self) -> Solution:
        """As `Contest`, maze by maze."""
        return reference_of(self.task, self.agent, self.opponents, by_maze=True)

    @property
    def solvable(self) -> bool:
        """Whether it is a runner with one goal, or a duel with a tabular opponent."""
        return is_solvable(self.task, self.opponent)

    @property
    def is_computed(self) -> bool:
        """Whether policies are evaluated exactly, not sampled."""
        return self.exact and self.solvable

    def describe(self) -> Plain:
        """As `Contest`."""
        return {**super().describe(), "maze": suite_called(self.task)}

    def line(self) -> str:
        """As `Contest`."""
        first, called = self.task.mazes[0], suite_called(self.task)
        text = f"maze {first.name} ({first.num_cells} cells; "
        return super().line().replace(text, f"{len(self.task.mazes)} mazes of {called} (")

    # -- starts --------------------------------------------------------------------------------

    @cached_property
    def numbers(self) -> NDArray[np.intp]:
        """[games] the maze index of each sampled start, equally many per maze."""
        mazes = len(self.task.mazes)
        most = min(self.episodes, SOLVED_MAZES) if self.task.is_duel else self.episodes
        played = np.linspace(0, mazes - 1, min(most, mazes)).round().astype(np.intp)
        return np.repeat(played, max(self.episodes // len(played), 1))

    @cached_property
    def played(self) -> NDArray[np.intp]:
        """[mazes] the indices of the mazes that are evaluated."""
        return np.arange(len(self.task.mazes)) if self.is_computed else np.unique(self.numbers)

    def starts(self) -> Simulator:
        """As `MazeContest`, equally many in each maze."""
        games = Simulator(self.task, len(self.numbers), self.seed, auto_restart=False)
        return self._in(games, self.numbers)

    def start(self, number: int) -> Simulator:
        """As `MazeContest`."""
        return self._in(super().start(number), self.numbers[[number % len(self.numbers)]])

    def _in(self, simulator: Simulator, mazes: NDArray[np.intp]) -> Simulator:
        """Restart the games of a simulator in these mazes."""
        simulator.configure(maze=mazes)
        simulator.reset(self.seed)
        return simulator

    # -- scores --------------------------------------------------------------------------------

    def in_mazes(self, name: str, policy: Policy) -> InMazes:
        """The results of a policy in each of the mazes `played`.

        Raises:
            ValueError: the contest is exact, and the policy is no table.
        """
        if not self.is_computed:
            simulator = self.starts()
            lengths, won, left = self.played_out(simulator, policy)
            found = self._over_mazes(name, lengths, won)
            goals = simulator.collected[:, self.seat].copy() if self.task.num_goals else None
            returns = simulator.returns[:, self.seat].copy()
            return replace(found, returns=returns, goals=goals, left=left)
        return self._exactly(name, tables_of(policy, self.part, self.seat))

    def _exactly(self, name: str, tables: Iterator[NDArray[np.float64]]) -> InMazes:
        """The exact values of a policy's tables, one for each of the mazes `played`."""
        others = opponent_tables(self.opponent, self.part, self.seat)
        pairs = pairs_of_values(self.part, self.seat, tables, others)
        least, mazes = self.part.min_start_distance, self.part.mazes
        means = [
            [mean_over_starts(values, maze, least) for values in steps_and_chances]
            for maze, steps_and_chances in zip(mazes, pairs, strict=True)
        ]
        steps, caught = map(np.array, zip(*means, strict=True))
        return InMazes(name, steps, 1.0 - caught if self.role == "evader" else caught, True)

    def _over_mazes(self, name: str, lengths: Lengths, won: NDArray[np.bool_]) -> InMazes:
        """The means of the sampled episodes by maze."""
        mazes = len(self.played)
        steps, success = (found.reshape(mazes, -1).mean(axis=1) for found in (lengths, won))
        return InMazes(name, steps, success, False, lengths)

    def score(self, name: str, policy: Policy) -> Score:
        """As `Contest`."""
        return self.in_mazes(name, policy).score(self.episodes)

    @property
    def best(self) -> InMazes | None:
        """The exact optimum in each of the mazes `played`, on the same starts; None if unknown.

        Unknown with a limited view; `best_with_full_view` is a bound then.
        """
        return None if self.is_limited else self.best_with_full_view

    @cached_property
    def best_with_full_view(self) -> InMazes | None:
        """The optimum of an agent with full view."""
        task = self.task
        if self.solvable and task.is_duel:
            return self._best_responses()
        if self.is_computed:
            paths = [maze.distances[maze.distances > 0] for maze in task.mazes]
            steps = [float(np.minimum(each, task.max_steps).mean()) for each in paths]
            success = [float((each <= task.max_steps).mean()) for each in paths]
            return InMazes("optimal", np.array(steps), np.array(success), True)
        lengths = self._best_lengths()
        if lengths is None:
            return None
        within = lengths <= task.max_steps
        return self._over_mazes("optimal", np.minimum(lengths, task.max_steps), within)

    def _best_responses(self) -> InMazes:
        """The optimum of a duel."""
        solved = list(zip(self._solutions.values(), self.part.mazes, strict=True))
        least = self.task.min_start_distance
        caught = np.array([mean_over_starts(each.captured, maze, least) for each, maze in solved])
        success = 1.0 - caught if self.role == "evader" else caught
        if not self.is_computed and (found := self._best_lengths()) is not None:
            lengths = np.minimum(found, self.task.max_steps)
            steps = lengths.reshape(len(self.played), -1).mean(axis=1)
            return InMazes("optimal", steps, success, False, lengths)
        means = [mean_over_starts(each.values, maze, least) for each, maze in solved]
        return InMazes("optimal", np.array(means), success, True)

    @cached_property
    def _solutions(self) -> dict[int, BestResponse]:
        """The best response in each of the mazes `played`, by maze index."""
        task, found = self.task, {}
        others = opponent_tables(self.opponent, self.part, self.seat)
        for number, table in zip(self.played.tolist(), others, strict=True):
            maze, horizon = task.mazes[number], task.max_steps
            found[number] = best_reply(task, self.role, table, horizon, maze=maze)
            _ = found[number].captured  # computed now, as what it needs is large
        return found

    @cached_property
    def part(self) -> Task:
        """The task with only the mazes `played`."""
        if len(self.played) == len(self.task.mazes):
            return self.task
        return replace(self.task, maze=tuple(self.task.mazes[n] for n in self.played))

    def optimal(self) -> Score | None:
        """As `Contest`."""
        return None if self.best is None else self.best.score(self.episodes)

    def optimal_lengths(self) -> NDArray[np.float64] | None:
        """As `Contest`, for the sampled starts; expectations in a duel."""
        lengths = None if self.is_limited else self._best_lengths()
        return None if lengths is None else np.minimum(lengths, self.task.max_steps)

    def _best_lengths(self) -> NDArray[np.float64] | None:
        """Optimal lengths without time limit."""
        if not (self.solvable and self.task.is_duel):
            return None if self.tours is None else self.tours.astype(np.float64)
        cells, lengths = self.starts().positions, np.zeros(len(self.numbers))
        for number, solved in self._solutions.items():
            here = self.numbers == number
            lengths[here] = solved.values[tuple(cells[here].T)]
        return lengths

    def baselines(self) -> list[Score]:
        """As `Contest`."""
        return [found.score(self.episodes) for found in self.references()]

    def references(self) -> list[InMazes]:
        """Random, scripted (A* or nearest goal; if sampled also agents with the same limited view)
        and, if known, the optimum."""
        others = {} if self.is_computed else self.limited
        found = [
            self.in_mazes("random", RandomAgent()),
            self.in_mazes(SCRIPTED_TITLES[self.role], DEFAULTS[self.role](0.0)),
            *(self.in_mazes(name, policy) for name, policy in others.items()),
        ]
        best = self.best_with_full_view
        if best is not None and self.is_limited:
            best = replace(best, name="optimal, full view")
        return found if best is None else [*found, best]


def suite_called(task: Task) -> str:
    """The name of several mazes: that of their suite, or the first name and the number."""
    names = [maze.name for maze in task.mazes]
    suite, _, first = names[0].partition("/")
    if not all(name.startswith(f"{suite}/") for name in names):
        return f"{names[0]} and {len(names) - 1} more"
    whole = suite in suite_names() and len(names) == len(suite_rows(suite))
    last = names[-1].partition("/")[2]
    if not whole and int(last) - int(first) + 1 != len(names):
        return f"{len(names)} of suite:{suite}"
    return f"suite:{suite}" if whole else f"suite:{suite}/{first}-{last}"
