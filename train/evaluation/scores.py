"""What a run knows of what it is judged by: contests, and the scores that they give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from train.evaluation.hidden_contest import Certificate
from train.reports.tables import Column, ResultTable, Row, numeric, words

BEST_PAID, MOST_GOALS = "optimal return", "optimal goals"
"""The names of the policies that are paid most, and that collect most, where these are known."""
FULL_SIGHT = ", full sight"
"""Behind the name of an optimum of who sees everything: a bound for an agent that does not."""


MeasureName = Literal["steps", "goals", "return"]


@dataclass(frozen=True)
class Measure:
    """What the policies of a contest are compared by: the one place that says which is better.

    Attributes:
        name: "steps" of an episode, "goals" that the agent collects in it, or its "return"; means
            over episodes.
        less_is_better: whether the smaller value is the better one.
    """

    name: MeasureName = "steps"
    less_is_better: bool = True

    @property
    def column(self) -> str:
        """The attribute of `Score`, and the column of `metrics.csv`, that holds it."""
        return f"mean_{self.name}"

    @property
    def optimum(self) -> str:
        """The name of the score that is the exact optimum in this measure."""
        return "optimal" if self.name == "steps" else f"optimal {self.name}"

    def of(self, score: Score) -> float | None:
        """The value of a score; None where it was not measured."""
        value: float | None = getattr(score, self.column)
        return value

    def best(self, scores: Sequence[Score]) -> Score | None:
        """The best of those scores that have a value; None where none has."""
        known = [score for score in scores if self.of(score) is not None]
        choose: Any = min if self.less_is_better else max
        return choose(known, key=self.of) if known else None

    def distance(self, achieved: Score, best: Score | None) -> float | None:
        """How far from the best: of steps the ratio less 1, else the difference; None if unknown.

        Of steps it is below 0 for evaders that live less long; of goals and returns it is above 0
        for agents that get less.
        """
        value, most = self.of(achieved), None if best is None else self.of(best)
        if value is None or most is None:
            return None
        return value / most - 1.0 if self.name == "steps" else most - value


@dataclass(frozen=True)
class Score:
    """What one policy achieves.

    Attributes:
        name: of the policy.
        mean_steps: mean episode length; an episode that runs out of time counts with all its steps.
        ci95: half width of the 95 % confidence interval of the mean; 0 where it is exact.
        success_rate: share of episodes won: the chasers caught all, the evader lived to the last
            step, all goals were collected; of a race, the runner collected more goals than each of
            the others.
        episodes: played for this score (or, where exact, for the success rate alone).
        exact: whether `mean_steps` is an exact mean over all starts.
        discounted_steps, discounted_ci95: the same of discounted steps, for agents with limited
            sight, whose optimum is certified in these; None elsewhere.
        solved_gap: achieved / optimal - 1 over the starts that were solved alone, of one runner:
            what is left of the gap without those that ran out of time. None elsewhere.
        mean_return: the mean of what the agent is paid in an episode; None where none was played.
        mean_goals: the mean number of goals that it collects, likewise; None without goals.
    """

    name: str
    mean_steps: float
    ci95: float
    success_rate: float
    episodes: int
    exact: bool
    discounted_steps: float | None = None
    discounted_ci95: float | None = None
    solved_gap: float | None = None
    mean_return: float | None = None
    mean_goals: float | None = None


def optimality_gap(achieved: Score, optimum: Score | None) -> float | None:
    """Achieved / optimal - 1 in steps, on the same starts; negative for evaders that fall short."""
    return None if optimum is None else achieved.mean_steps / optimum.mean_steps - 1.0


BY_STEPS, BY_GOALS = Measure(), Measure("goals", False)
BY_LONG_LIFE, BY_RETURN = Measure("steps", False), Measure("return", False)
DISCOUNTED = "discounted steps"


def measure_of(task: Task, role: str) -> Measure:
    """What an agent of a role is judged by in a task; see `GameContest.measure`."""
    if task.num_goals == 0:
        return BY_LONG_LIFE if role == "evader" else BY_STEPS
    if role != "runner":
        return BY_RETURN
    return BY_GOALS if task.num_runners + task.num_evaders > 1 else BY_STEPS


@dataclass(frozen=True)
class Reference:
    """What a learned policy is held against.

    Attributes:
        kind: "exact"; "certified", the far end of what is proven of an optimum; "bound", that which
            nobody can pass, such as the optimum of an agent that sees everything; "best known", the
            best of the scripted agents, random play among them.
        name: of the score that it is.
        unit: the name of the measure, or `DISCOUNTED`.
        value: in that unit.
        distance: of steps the gap to it, achieved / reference - 1; of goals and returns what is
            missing.
    """

    kind: str
    name: str
    unit: str
    value: float
    distance: float

    def line(self) -> str:
        """In words."""
        missing = self.unit not in ("steps", DISCOUNTED)
        less = "less" if self.distance >= 0 else "more"
        far = f"{abs(self.distance):.3f} {less}" if missing else f"gap {100 * self.distance:+.2f} %"
        kinds = {"bound": "a bound", "best known": "best known, not proven"}
        what = kinds.get(self.kind, self.kind)
        return f"reference: {self.name} ({what}), {self.value:.3f} {self.unit}; learned: {far}"


def reference_of(
    scores: Sequence[Score],
    learned: Score,
    measure: Measure = BY_STEPS,
    fair: Sequence[str] | None = None,
) -> Reference | None:
    """The strongest reference among these scores: exact, a bound, or the best known.

    Args:
        scores: of the references and of what was learned.
        learned: what is held against it.
        measure: what policies are compared by.
        fair: names of the scripted agents that see no more than the learner, for one of limited
            sight: the others are no reference. None for all of them.

    Returns:
        None where nobody but the learner has been scored.
    """
    by_name = {score.name: score for score in scores}
    for kind, name in (("exact", measure.optimum), ("bound", measure.optimum + FULL_SIGHT)):
        if name in by_name:
            return _held_against(kind, by_name[name], learned, measure)
    known = [
        score
        for score in scores
        if (fair is None or score.name in fair) and not score.name.startswith("learned")
    ]
    best = measure.best(known)
    return None if best is None else _held_against("best known", best, learned, measure)


def _held_against(kind: str, best: Score, learned: Score, measure: Measure) -> Reference:
    value, distance = measure.of(best), measure.distance(learned, best)
    return Reference(kind, best.name, measure.name, float(value or 0.0), float(distance or 0.0))


def score_table(
    scores: Sequence[Score], certificate: Certificate | None = None, measure: Measure = BY_STEPS
) -> ResultTable:
    """Scores with the gap to the optimal one, or to what is proven of it.

    Where they are compared by goals or returns, these stand first, with what is missing to the
    best where that is known.
    """
    by_steps = measure.name == "steps"
    optimum = next((score for score in scores if score.name == "optimal"), None)
    names = (measure.optimum, measure.optimum + FULL_SIGHT)
    best = next((score for score in scores if score.name in names), None)
    rows: list[Row] = []
    for score in scores:
        row: Row = asdict(score) | {"interval": "exact" if score.exact else f"± {score.ci95:.3f}"}
        row["value"] = measure.of(score)
        if score is not best:
            row["missing"] = measure.distance(score, best)
        if score is not optimum:
            row["gap"] = optimality_gap(score, optimum)
        elif not by_steps:
            row["name"] = "optimal steps"
        if certificate is not None and score.discounted_steps is not None:
            row["certified_gap"] = certificate.gap(score.discounted_steps)
        if score.success_rate == 1.0:
            row["solved_gap"] = None
        rows.append(row)
    columns = [words("", "name")]
    if not by_steps:
        columns.append(numeric(measure.name, "value", ".3f"))
        if best is not None:
            columns.append(numeric("below the best", "missing", ".3f"))
    columns += [
        numeric("steps", "mean_steps", ".3f"),
        Column("95 % interval", lambda row: str(row["interval"])),
        numeric("success", "success_rate", ".1f", 100, " %"),
    ]
    if by_steps:
        columns.append(numeric("gap to optimum", "gap", "+.2f", 100, " %"))
    if any(row["solved_gap"] is not None for row in rows):
        columns.append(numeric("of the solved", "solved_gap", "+.2f", 100, " %"))
    if certificate is not None:
        columns.append(numeric("discounted", "discounted_steps", ".3f"))
        columns.append(numeric(certificate.head, "certified_gap", "+.2f", 100, " %"))
    return ResultTable(rows, columns)


def label_of(policy: Policy) -> str:
    """A policy in words: its own, or else the name of its class."""
    plain = type(policy).__repr__ is object.__repr__
    return type(policy).__name__ if plain else repr(policy)


class Contest(Protocol):
    """What a run is judged by; the base of all contests.

    Attributes:
        measure: what policies are compared by, and which is better.
    """

    @property
    def measure(self) -> Measure: ...  # noqa: D102 -- see the class

    def describe(self) -> dict[str, Any]:
        """What is played, by whom and where, as plain values: "task", "role", "maze"."""

    def line(self) -> str:
        """The same in one line, with whoever else plays."""

    def score(self, name: str, policy: Any) -> Score:
        """How well a policy does."""

    def optimal(self) -> Score | None:
        """The exact optimum; None where it is not known."""

    def baselines(self) -> list[Score]:
        """The references: random, scripted and, where it is known, optimal."""

    def reference(self, scores: Sequence[Score], learned: Score) -> Reference | None:
        """What `learned` is held against, of these scores; None where there is nothing."""

    def scene(self, simulator: Any, caption: str) -> Any:
        """What a person sees of one of its simulators now, for `save_animation`."""

    def scenes(self, policy: Any, episodes: int = 3) -> list[Any]:
        """The scenes of some episodes, one after the other."""
        scenes: list[Any] = []
        for episode in range(episodes):
            caption = f"episode {episode + 1} of {episodes}"
            simulator, play = self.game(policy, episode)
            scenes.append(self.scene(simulator, caption))
            scenes += [self.scene(simulator, caption) for _ in play]
            scenes.extend([scenes[-1]] * 3)
        return scenes

    def game(self, policy: Any, number: int) -> tuple[Any, Iterator[None]]:
        """The episode of that number: a simulator at its start, and what steps it to its end."""

    def play(self, policy: Any) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Play every start to its end: episode lengths [episodes], and who won [episodes]."""

    def lengths(self, policy: Any) -> NDArray[np.float64]:
        """[episodes], how long each takes this policy; expected ones where they are known."""
        return self.play(policy)[0].astype(np.float64)

    def optimal_lengths(self) -> NDArray[np.float64] | None:
        """[episodes], the optimum of each start; None where it is not known."""
