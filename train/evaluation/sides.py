"""`Sides`: the policies of all sides of a game against each other, for self-play and leagues."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder
from pursuit.validation import Missing
from scripted_agents.exact.limits import (
    MAX_EVALUATED_WORK,
    MAX_FINAL_WORK,
    MAX_WORK,
    SEARCH_SECONDS,
)
from train.evaluation.scores import Measure
from train.files import Plain
from train.reports.curves import Panel, Series
from train.reports.figures import time_scale
from train.reports.tables import ResultTable, Row
from train.settings.checks import EVALUATION_SEED

PAIR_EPISODES = 200
"""Games per payoff without an exact value."""
Policies = Mapping[str, Any]
"""Policies by side."""
PolicyTable = NDArray[np.float64]
Reply = Callable[[PolicyTable], tuple[PolicyTable, float]]
"""The best response to a table, and what it gains over the value of the game."""
Gain = Callable[[PolicyTable, PolicyTable], float]
"""What a response to a table gains over the value of the game."""


@dataclass(frozen=True)
class ResultLimits:
    """How much is computed for the results of a run.

    Attributes:
        evaluated_work: size up to which games of teams are evaluated exactly (`match`).
        whole_game_work: size up to which whole games are solved (`whole_game`).
        response_work: size up to which exact best responses of teams are solved.
        team_work: as `GameContest.most_work`, for the results of teams.
        search_seconds: of each interval of a best response with a limited view.
        is_dry_run: whether the last evaluation is used again, best responses are not trained, and
            the current policies are taken for the snapshots, which a new run does not have.
    """

    evaluated_work: int = MAX_FINAL_WORK
    whole_game_work: int = MAX_WORK
    response_work: int = MAX_FINAL_WORK
    team_work: int = MAX_EVALUATED_WORK
    search_seconds: float = SEARCH_SECONDS
    is_dry_run: bool = False


DRY_RUN = ResultLimits(0, 20_000, 20_000, 20_000, 0.0, is_dry_run=True)


@dataclass(frozen=True)
class Profile:
    """The policies of a run of self-play.

    Attributes:
        policies: those that are evaluated, by side.
        learning: the sides that learn.
        scripted: others to compare with, by name and side.
        seed: of the games of results that are not exact, a seed of evaluations.
    """

    policies: Policies
    learning: tuple[str, ...]
    scripted: Mapping[tuple[str, str], Any] = field(default_factory=dict)
    seed: int = EVALUATION_SEED


class PairResult(NamedTuple):
    """The result of a policy of the first side against one of the second.

    Attributes:
        payoff: what the second maximises; the mean of `sampled` unless it is exact.
        ci95: half width of its interval; 0 if it is exact.
        sampled: [games] payoffs of games from the same starts for all pairs; empty if there are
            none.
        first: the payoff of the first side where that may not be the negative; else None.
    """

    payoff: float
    ci95: float
    sampled: NDArray[Any]
    first: float | None = None


class EndTable(NamedTuple):
    """A table of the results of self-play.

    Attributes:
        title: of its section on a page.
        table: the rows.
        head, legend: lines above and below it in a terminal.
        unit: a line below it on a page.
    """

    title: str
    table: ResultTable
    head: str = ""
    legend: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Sides(ABC):
    """The policies of all sides of a game against each other.

    A side is a role, or an agent where agents have no roles.

    Attributes:
        world: the task with its policies (`train.families.family.TaskWorld`).
        task: the game, with its time limit.
        discount: of the exact game, that of the learners.
    """

    world: Any
    task: Any
    discount: float = 1.0

    @property
    def roles(self) -> tuple[str, ...]:
        """The sides, in their order."""
        return tuple(self.world.settings.sides)

    @property
    def by_agent(self) -> tuple[str, ...]:
        """The side of every agent."""
        return tuple(self.task.agent_names)

    @property
    def mixtures(self) -> bool | Missing:
        """Whether a Nash mixture of the payoffs of two sides exists, or why not."""
        if len(self.roles) != 2:
            return Missing(f"needs two sides, but {len(self.roles)} play")
        return True

    @abstractmethod
    def line(self) -> str:
        """The game and its sides in one line of text."""

    @abstractmethod
    def describe_game(self) -> Plain:
        """The first entries of results: "task", "maze" and others."""

    def place(self) -> str:
        """Where the game is, in words."""
        return f"in game {self.task.name}"

    def brief(self, steps: int) -> Sides:
        """The same with episodes of at most so many steps."""
        return replace(self, task=replace(self.task, max_steps=min(self.task.max_steps, steps)))

    # -- for learning ----------------------------------------------------------------------------

    @abstractmethod
    def scripted(self, members: Sequence[str]) -> dict[tuple[str, str], Any]:
        """The policies to compare with, and these members of pools, by name and side."""

    def episode_steps(self, given: int | None) -> int:
        """The steps after which training episodes are truncated."""
        return given or int(self.task.max_steps)

    def scale(self, role: str) -> float:
        """The factor of the rewards of a side in training."""
        return 1.0

    @property
    def bounded(self) -> bool:
        """Whether the time limit ends the game, as returns have no discount."""
        return self.discount == 1.0

    @abstractmethod
    def scores(self, batch: Any, role: str, games: NDArray[np.bool_]) -> NDArray[np.float64]:
        """[n] the scores in [0, 1] of a side in the games of a mask, which have just ended."""

    # -- results ---------------------------------------------------------------------------------

    @abstractmethod
    def objective(self, policies: Policies) -> Measure:
        """The measure by which evaluations are compared."""

    @abstractmethod
    def payoff(self, one: Any, two: Any, seed: int) -> float:
        """The payoff of a policy of the first side against one of the second, which maximises it;
        `seed` is a seed of evaluations."""

    @abstractmethod
    def evaluate(self, profile: Profile, episodes: int, most: int = 0) -> dict[str, float]:
        """The columns of an evaluation during training.

        Args:
            profile: the policies.
            episodes: of results that are not exact.
            most: the size of games of teams that are solved.
        """

    @abstractmethod
    def fields(self, row: Mapping[str, float]) -> list[str]:
        """Such columns as text."""

    @abstractmethod
    def played(self, profile: Profile, episodes: int, limits: ResultLimits) -> Plain:
        """The entries of results with the policies against others."""

    def more(
        self,
        content: Plain,
        profile: Profile,
        episodes: int,
        limits: ResultLimits,
        add_snapshots: Callable[[], None],
        respond: Callable[[str], Any] | None,
    ) -> None:
        """Add further results to the content.

        Args:
            content: of `results.json` so far.
            profile, episodes: as of `evaluate`.
            limits: how much is computed.
            add_snapshots: adds the results of snapshots, which need exact best responses.
            respond: trains a best response to a side, and gives the policies of both; None if that
                is not wanted.
        """
        if "nash_conv" in content["evaluation"]:
            add_snapshots()

    def nash_conv(self, policies: Policies) -> float | Missing:
        """Exact NashConv in the unit of evaluations, or why it is not known."""
        return Missing("no exact solution of this game is known")

    def why_not_always(self) -> str | None:
        """Why NashConv of learned policies is not always known; None if it is."""
        return "no exact solution of this game is known"

    @property
    def compares_weights(self) -> bool:
        """Whether NashConv of the last and of the averaged weights is compared in results."""
        return True

    def mixed_share(self) -> float | None:
        """How much an equilibrium mixes; None where it is not computed."""
        return None

    # -- mixtures of snapshots -------------------------------------------------------------------

    def are_tables(self, policies: Sequence[Any]) -> bool:
        """Whether these policies are tables for which `replies` are exact."""
        return False

    def table(self, policy: Any, least: float) -> PolicyTable:
        """The table of a policy, without actions of a probability below `least`."""
        raise AssertionError("asked only for tables")

    def replies(self, role: str) -> tuple[Reply, Gain]:
        """Best responses to tables of a side, and what responses gain."""
        raise AssertionError("asked only for tables")

    def diversity(self, kept: Mapping[str, Sequence[Any]]) -> Plain:
        """ "diversity" of snapshots in the results; {} where it is not measured."""
        return {}

    # -- leagues ---------------------------------------------------------------------------------

    @abstractmethod
    def pair(self, one: Any, two: Any, games: int, seed: int, most: int) -> PairResult:
        """The result of a policy of the first side against one of the second.

        Args:
            one, two: the policies.
            games: number of sampled games.
            seed: of evaluations.
            most: the size of games of teams that are solved.
        """

    @property
    @abstractmethod
    def league_measure(self) -> Measure:
        """Of the payoffs of a league that are shown, with the direction of the first side."""

    @property
    def horizon(self) -> int | None:
        """Steps after which payoffs that count steps are truncated; None for others."""
        return None

    def team_rows(self, entries: Sequence[Any], table: Any) -> list[Row]:
        """Teams of several agents beside their best responses; empty where there are none."""
        return []

    # -- in words --------------------------------------------------------------------------------

    @abstractmethod
    def describe(self, content: Plain) -> list[str]:
        """The results as sentences."""

    @abstractmethod
    def tables(self, content: Plain) -> list[EndTable]:
        """The tables of the results."""

    def files(self, content: Plain) -> dict[str, ResultTable]:
        """The tables that are written beside the results, by the name of the file."""
        return {}

    @abstractmethod
    def panels(self, rows: Sequence[Mapping[str, float]], unit: str) -> list[Panel]:
        """The panels of the figure of evaluations over training time (in seconds or frames)."""

    def legend(self, names: Sequence[str], epsilon: float) -> str:
        """What the named policies among these are; `epsilon` is their share of random moves."""
        return ""

    @abstractmethod
    def add_episodes(
        self,
        builder: Builder,
        policies: Policies,
        games: Mapping[str, int],
        labels: Mapping[str, str],
    ) -> Replay | None:
        """Play episodes and add them to a page; the replay if there is one.

        Args:
            builder: of the page.
            policies: by side.
            games: the numbers of the episodes, which are those of evaluations, by label.
            labels: the names of the policies by side.
        """


def known(
    rows: Sequence[Mapping[str, float]], unit: str, lines: Mapping[str, Series]
) -> list[Series]:
    """The lines whose columns are in these rows, over training time, with their curves."""
    times = np.array([row[unit] for row in rows]) * time_scale(unit)
    return [
        replace(line, curves=[(times, np.array([row[name] for row in rows]))])
        for name, line in lines.items()
        if name in rows[0]
    ]
