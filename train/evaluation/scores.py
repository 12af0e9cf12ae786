"""The interface of contests (evaluations of one agent), their measures, scores and references."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.policy import ArmPolicy
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.rendering.rendering import Drawable
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents.exact.references import Solution
from scripted_agents.games.simulator import GameSimulator, StatePolicy
from train.evaluation.departures import RATES
from train.evaluation.games import Lengths, half_width, play_out
from train.evaluation.hidden_contest import Certificate
from train.files import Plain

BEST_RETURN = "optimal return"
"""Name of the policy with the highest return."""
FULL_VIEW = ", full view"
"""Suffix of an optimum with full view, which is a bound for an agent with a limited view."""


OUTCOME = "captures - escapes"
DISCOUNTED = "discounted steps"


@dataclass(frozen=True)
class Measure:
    """What policies or runs are compared by: its name, unit, sign and direction.

    Tables, reports, figures and files take these from here. `results.json` has its fields as
    "objective", and files of rows the first two.

    Attributes:
        column: of `metrics.csv`, of results and of rows; the attribute of `Score`, if it has one.
        unit: of its values; "%" for ratios, which are drawn and printed in per cent.
        less_is_better: whether smaller values are better.
    """

    column: str
    unit: str
    less_is_better: bool = True

    @property
    def name(self) -> str:
        """The column without the kind of average: "steps", "goals", "outcome", "gap", ..."""
        return self.column.removeprefix("mean_").removeprefix("optimality_")

    @property
    def by_steps(self) -> bool:
        """Whether it is the length of episodes."""
        return self.name == "steps"

    @property
    def title(self) -> str:
        """Name and unit in words, for tables and axes."""
        if self.unit.startswith("%"):
            return f"gap to the optimum, {self.unit}"
        name = "NashConv" if self.name == "nash_conv" else self.name.replace("_", " ")
        return name if self.unit in name else f"{name} ({self.unit})"

    @property
    def is_signed(self) -> bool:
        """Whether values of both signs are usual; others are at least 0, but for rounding."""
        return self.name in ("return", "outcome")

    @property
    def factor(self) -> float:
        """The factor of values where they are printed and drawn."""
        return 100.0 if self.unit.startswith("%") else 1.0

    @property
    def scale(self) -> str:
        """That of its axis (`Panel.scale`)."""
        if self.unit.startswith("%"):
            return "gap"
        return "log" if self.by_steps else "linear" if self.is_signed else "from 0"

    @property
    def optimum(self) -> str:
        """The name of the score of the exact optimum in this measure."""
        return "optimal" if self.by_steps else f"optimal {self.name}"

    def of(self, score: Score) -> float | None:
        """The value of a score in this measure; None if it is unknown."""
        return getattr(score, self.column)

    def best(self, scores: Sequence[Score]) -> Score | None:
        """The best score with a value; None if there is none."""
        known = [(value, score) for score in scores if (value := self.of(score)) is not None]
        sign = 1.0 if self.less_is_better else -1.0
        return min(known, key=lambda pair: sign * pair[0])[1] if known else None

    def distance(self, achieved: Score, best: Score | None) -> float | None:
        """The distance to the best: for steps the ratio - 1, else the difference; None if unknown.

        At most 0 in the steps of evaders, which maximise episode length; else at least 0.
        """
        value, most = self.of(achieved), None if best is None else self.of(best)
        return None if value is None or most is None else self.gap(value, most)

    def gap(self, value: float, most: float) -> float:
        """The distance of a value to the best one, as `distance`."""
        if self.by_steps:
            return value / most - 1.0
        return value - most if self.less_is_better else most - value


BY_STEPS, BY_MOST_STEPS = Measure("mean_steps", "steps"), Measure("mean_steps", "steps", False)
BY_GOALS, BY_RETURN = Measure("mean_goals", "goals", False), Measure("mean_return", "return", False)
UNTIL_CAPTURE = Measure("mean_steps", "steps until capture")
BY_OUTCOME = Measure("outcome", f"{OUTCOME} (chasers want more)", False)
"""What chasers and evaders play for, with the direction of chasers."""


@dataclass(frozen=True)
class Score:
    """The score of one policy.

    Attributes:
        name: of the policy.
        mean_steps: mean episode length, including truncated episodes.
        ci95: half width of the 95 % confidence interval of `mean_steps`; 0 if it is exact.
        success_rate: share of episodes won: all evaders caught; the evader not caught, with exits
            escaped; all goals collected; in a race, more goals than each other runner.
        episodes: number of sampled episodes; not used if `exact`.
        exact: whether `mean_steps` is an exact expectation over all starts, and so are the other
            numbers but for those that `apart` names.
        discounted_steps, discounted_ci95: mean discounted steps and half width of the interval, if
            there is a certified bound, which is in discounted steps; None otherwise.
        solved_gap: achieved / optimal - 1 over the solved starts, for a single runner; None
            otherwise.
        mean_return: mean return of the agent; None if no episodes were sampled.
        mean_goals: mean number of goals of the agent; None without goals.
        outcome: with exits, the mean number of captures minus escapes, of all evaders for a chaser,
            else of the evader; exact like the steps, and for the optimum. None without exits.
        capture_rate, escape_rate, timeout_rate: shares of these evaders, of sum 1.
        value_ci95: half width of the interval of the value in the measure of the contest, if that
            is not steps; 0 if it is exact.
        apart: of an optimum whose measure is exact, which other numbers are sampled, or of the
            policy of its first step alone; empty if there are none.
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
    outcome: float | None = None
    capture_rate: float | None = None
    escape_rate: float | None = None
    timeout_rate: float | None = None
    value_ci95: float | None = field(default=None, kw_only=True)
    apart: str = field(default="", kw_only=True)

    @classmethod
    def of_episodes(
        cls, name: str, lengths: Lengths, won: NDArray[np.bool_], *more: Any, **others: Any
    ) -> Score:
        """Of sampled episodes: their lengths, whether they were won, and further attributes."""
        mean, share = float(lengths.mean()), float(won.mean())
        return cls(name, mean, half_width(lengths), share, len(lengths), False, *more, **others)

    def plain(self) -> Plain:
        """As a dict, without what there is only with exits, for optima or other measures."""
        hidden: tuple[str, ...] = () if self.rates else ("outcome", *RATES)
        hidden += () if self.apart else ("apart",)
        hidden += () if self.value_ci95 is not None else ("value_ci95",)
        return {name: value for name, value in asdict(self).items() if name not in hidden}

    @property
    def rates(self) -> dict[str, float]:
        """The shares of captures, escapes and time-outs; empty without exits."""
        return {name: getattr(self, name) for name in RATES if self.outcome is not None}


def optimality_gap(achieved: Score, optimum: Score | None) -> float | None:
    """Achieved / optimal - 1 in steps on the same starts; for evaders at most 0 if exact."""
    return None if optimum is None else achieved.mean_steps / optimum.mean_steps - 1.0


def measure_of_role(task: Task, role: str) -> Measure:
    """The measure of an agent of a role in a task; see `MazeContest.measure`."""
    if task.most_exits and task.num_goals == 0:
        return Measure("outcome", OUTCOME, role == "evader")
    if task.num_goals == 0:
        return BY_MOST_STEPS if role == "evader" else BY_STEPS
    if role != "runner":
        return BY_RETURN
    return BY_GOALS if task.num_runners + task.num_evaders > 1 else BY_STEPS


@dataclass(frozen=True)
class Reference:
    """The reference with which a learned policy is compared.

    Attributes:
        kind: "exact"; "certified", the pessimistic end of a proven interval of the optimum;
            "bound", a bound of the optimum, such as the optimum with full view; "best known", the
            best of the scripted and random agents.
        name: of the reference score.
        unit: the name of the measure, or `DISCOUNTED`.
        value: in that unit.
        distance: in steps the gap achieved / reference - 1, in goals and returns the difference.
    """

    kind: str
    name: str
    unit: str
    value: float
    distance: float

    def line(self) -> str:
        """The reference as one line of text."""
        missing = self.unit not in ("steps", DISCOUNTED)
        how = ("worse", "better") if self.unit == OUTCOME else ("less", "more")
        less = how[self.distance < 0]
        far = f"{abs(self.distance):.3f} {less}" if missing else f"gap {100 * self.distance:+.2f} %"
        kinds = {"bound": "a bound", "best known": "best known, not proven"}
        what = kinds.get(self.kind, self.kind)
        return f"reference: {self.name} ({what}), {self.value:.3f} {self.unit}; learned: {far}"


def strongest_reference(
    scores: Sequence[Score],
    learned: Score,
    measure: Measure = BY_STEPS,
    comparable: Sequence[str] | None = None,
) -> Reference | None:
    """The strongest reference among these scores: exact, a bound, or the best known.

    Args:
        scores: of the references and of learned policies.
        learned: the score to compare.
        measure: of the comparison.
        comparable: names of the scores that may be "best known": for a learner with a limited view
            those of agents with the same view. None for all.

    Returns:
        None if there are only scores of learned policies.
    """
    by_name = {score.name: score for score in scores}
    for kind, name in (("exact", measure.optimum), ("bound", measure.optimum + FULL_VIEW)):
        if name in by_name:
            return _reference(kind, by_name[name], learned, measure)
    known = [
        score
        for score in scores
        if (comparable is None or score.name in comparable) and not score.name.startswith("learned")
    ]
    best = measure.best(known)
    return None if best is None else _reference("best known", best, learned, measure)


def _reference(kind: str, best: Score, learned: Score, measure: Measure) -> Reference:
    value, distance = measure.of(best), measure.distance(learned, best)
    return Reference(kind, best.name, measure.unit, float(value or 0.0), float(distance or 0.0))


def label_of(policy: object) -> str:
    """The label of a policy: its `repr`; without an own one its `name`, or that of its class."""
    if type(policy).__repr__ is not object.__repr__:
        return repr(policy)
    return str(getattr(policy, "name", type(policy).__name__))


def beside_of(teammates: Mapping[str, str]) -> str:
    """The labels of teammates as a suffix: " + AStarChaser(epsilon=0.2)", equal ones counted."""
    counts = Counter(teammates.values())
    return "".join(f" + {n} × {name}" if n > 1 else f" + {name}" for name, n in counts.items())


class ObjectiveGap(NamedTuple):
    """The loss of the policy with the best discounted return; None where unknown.

    Attributes:
        gap: its `optimality_gap`, at most 0 for evaders.
        missing_return: the best undiscounted return minus its own, if other agents collect goals;
            with exits in captures minus escapes, for an evader its own minus the least.
    """

    gap: float | None = None
    missing_return: float | None = None


UNKNOWN_GAP = ObjectiveGap()


class FunctionActions(NamedTuple):
    """The actions of an agent as a function of observations returns them.

    Attributes:
        number: of discrete ones, which are integers from 0; None for any numbers.
        shape: of those in one game.
        moves: (actions of all games) -> the same as the simulator takes them.
    """

    number: int | None
    shape: tuple[int, ...] = ()
    moves: Callable[[NDArray[Any]], NDArray[Any]] = lambda actions: actions.astype(np.int32)


PolicyT = TypeVar("PolicyT", Policy, ArmPolicy, StatePolicy)
GamesT = TypeVar("GamesT", Simulator, ReacherSimulator, GameSimulator)


class Contest(ABC, Generic[PolicyT, GamesT]):
    """Evaluation of one agent; the base of all contests, which are frozen dataclasses.

    Attributes:
        simulator: the class of the simulator of its games.
        task, episodes, seed: what it simulates.
    """

    simulator: ClassVar[Any]
    task: Any
    episodes: int
    seed: int

    @property
    @abstractmethod
    def measure(self) -> Measure:
        """The measure by which policies are compared."""

    @property
    @abstractmethod
    def exact_reference(self) -> Solution:
        """Which exact optimum of the agent is known, or why none is."""

    NO_REPLAY: ClassVar[str] = (
        "games in mazes and arms; `pursuit view` shows episodes of a small game"
    )
    """Which games have replays; "" where this one has."""
    success: ClassVar[str] = "success"
    """The heading of success rates in tables."""

    @property
    def beside(self) -> str:
        """The policies of teammates, as a suffix of every policy that plays with them."""
        return ""

    @property
    def actions(self) -> FunctionActions:
        """The actions of the agent; ValueError where functions cannot give them."""
        raise ValueError("functions of observations do not play this game; give a policy")

    @abstractmethod
    def describe(self) -> Plain:
        """The evaluation as plain values: "task", "role", "maze" and others."""

    @abstractmethod
    def line(self) -> str:
        """The evaluation in one line of text, including the other agents."""

    def columns(self, policy: PolicyT) -> dict[str, float]:
        """Further columns of `metrics.csv` for an evaluated policy."""
        return {}

    def further(self, policy: PolicyT, score: Score, scores: Sequence[Score]) -> Plain:
        """Further entries of `results.json` for an evaluated policy: its score, and those of all
        policies."""
        return {}

    def objective_gap(self, discount: float) -> ObjectiveGap:
        """The loss of the policy with the best discounted return, exact over all starts."""
        return UNKNOWN_GAP

    def solved_up_to(self, most_work: int) -> Self:
        """The same contest; whole games are solved up to this size (`work_of`)."""
        return self

    def exactly(self, policies: Iterable[PolicyT] = ()) -> Self:
        """The same contest; scores are exact where that is a choice and can be for all of these."""
        return self

    def brief(self, steps: int) -> Self:
        """The same contest with episodes of at most these steps where tasks allow it, and without
        solutions of whole games; for measurements of the time that evaluations take."""
        return self

    @property
    def by_maze(self) -> Any:
        """The evaluation in each of several mazes, a `SuiteContest`; None for any other."""
        return None

    # -- what is said of the game --------------------------------------------------------------

    @property
    def notes(self) -> list[str]:
        """What is said of the optimum below tables of scores, as lines of text."""
        return []

    def facts(self) -> Iterator[str]:
        """What is known of the whole game beside the scores, as lines of text."""
        yield from ()

    @property
    def why_no_optimum(self) -> str:
        """Why no exact optimum is known even with full view; "" if one is, or if it is not said."""
        return self.exact_reference.reason

    # -- policies ------------------------------------------------------------------------------

    @property
    def best_name(self) -> str:
        """The name of `best_policy` on pages."""
        return "optimal"

    def scripted(self) -> PolicyT:
        """The scripted policy of the agent; ValueError if there is none."""
        raise ValueError("this game has only learned policies; give the folder of a run")

    def best_policy(self) -> PolicyT:
        """The exactly optimal policy of the agent; ValueError if it is not known."""
        reason = self.exact_reference.reason or "it is not solved"
        raise ValueError(f"optimal policy: {reason}; leave out --optimal")

    def optimal_policy(self) -> PolicyT:
        """The optimal policy as a target of imitation: in mazes and small games uniform over all
        equally good actions of a state. Of games whose solver gives one policy it is that one.

        Raises:
            ValueError: it is not known.
        """
        if reason := self.exact_reference.reason:
            raise not_imitable(reason)
        return self.uniform_policy()

    def uniform_policy(self) -> PolicyT:
        """`optimal_policy`, which is known."""
        return self.best_policy()

    # -- scores --------------------------------------------------------------------------------

    @abstractmethod
    def score(self, name: str, policy: PolicyT) -> Score:
        """The score of a policy."""

    def optimal(self) -> Score | None:
        """The exact optimum in steps; None if it is not known."""
        return None

    def optimum(self) -> Score | None:
        """The exact optimum in the measure; None if it is not known."""
        return self.optimal() if self.measure.by_steps else None

    def is_exact_for(self, policy: PolicyT) -> bool:
        """Whether the score of a policy is exact, for whole policies that are compared alone."""
        return False

    def values(self, policy: PolicyT) -> NDArray[np.float64]:
        """[episodes] the results in the measure."""
        return self.play(policy)[0].astype(float)

    @abstractmethod
    def baselines(self) -> list[Score]:
        """The references: random, scripted and, if known, optimal."""

    def reference(self, scores: Sequence[Score], learned: Score) -> Reference | None:
        """The reference for `learned` among these scores; None if there is none."""
        return strongest_reference(scores, learned, self.measure)

    def certificate(self) -> Certificate | None:
        """The proven interval of the optimum, under a limited view; None if there is none."""
        return None

    # -- episodes ------------------------------------------------------------------------------

    def starts(self) -> GamesT:
        """The games of the evaluation at their starts."""
        return self.simulator(self.task, self.episodes, self.seed, auto_restart=False)

    def start(self, number: int) -> GamesT:
        """One of the games of the evaluation at its start."""
        return self.simulator(self.task, 1, self.seed, number, auto_restart=False)

    @abstractmethod
    def stepper(self, games: GamesT, policy: PolicyT) -> Callable[[], None]:
        """A function that plays one step of games of this contest with a policy."""

    def play(self, policy: PolicyT) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Play all episodes: lengths [episodes], and whether they were won [episodes]; in games
        without a rule of their own those that end in time."""
        games: Any = self.starts()
        step = self.stepper(games, policy)
        return play_out(games, step, lambda each: each.ended, lambda each: each.terminated)

    def game(self, policy: PolicyT, number: int) -> tuple[GamesT, Iterator[None]]:
        """One episode by number: a simulator at its start, and an iterator that plays it."""
        games = self.start(number)
        step = self.stepper(games, policy)

        def play() -> Iterator[None]:
            while not games.ended.any():
                step()
                yield

        return games, play()

    @abstractmethod
    def scene(self, games: GamesT, caption: str, before: Any = None) -> Drawable:
        """The current frame of games of this contest, for `save_animation`; `before` is that of the
        last step."""

    def scenes(self, policy: PolicyT, episodes: int = 3) -> list[Drawable]:
        """The frames of some episodes."""
        scenes: list[Drawable] = []
        for episode in range(episodes):
            caption = f"episode {episode + 1} of {episodes}"
            games, play = self.game(policy, episode)
            scenes.append(self.scene(games, caption))
            for _ in play:
                scenes.append(self.scene(games, caption, scenes[-1]))
            scenes.extend([scenes[-1]] * 3)
        return scenes

    def players(self, policy_name: str) -> dict[str, str]:
        """The names of all policies by agent, if `policy_name` is that of the evaluated one."""
        return dict.fromkeys(self.task.agent_names, policy_name)

    def add_episodes(
        self,
        builder: Builder,
        policy: PolicyT,
        games: Mapping[str, int],
        policy_name: str,
        encoding: str | None = None,
    ) -> Replay | None:
        """Add episodes to a page.

        Args:
            builder: of the page.
            policy: the evaluated policy.
            games: the numbers of the episodes by label.
            policy_name: the name of the policy.
            encoding: the observation of the agent that is shown, where it can be.

        Returns:
            The replay; None where there is none.
        """
        return None

    # -- lengths -------------------------------------------------------------------------------

    def optimal_lengths(self) -> NDArray[np.float64] | None:
        """[episodes] optimal length from each start; None if it is not known."""
        return None

    def lost_by_start(self, policy: PolicyT) -> NDArray[np.float64] | None:
        """[cells] the mean steps that a policy loses to the optimum, by the start cell of the
        agent; NaN where it never starts, None if this is not known."""
        return None


def not_imitable(reason: str) -> ValueError:
    """The error where the optimal policy is not known, for this reason."""
    remedy = "a smaller game, a full view, or opponents with known probabilities"
    return ValueError(f"no optimal policy to imitate: {reason}; give {remedy}")


AnyContest: TypeAlias = Contest[Any, Any]
