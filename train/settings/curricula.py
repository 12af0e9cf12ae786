"""The settings of every curriculum: frozen dataclasses, checked at birth. No torch here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, ClassVar

from curricula import Curriculum, Schedule
from curricula.levels import SCORES
from curricula.schedules import SHAPES, UNITS
from pursuit.plugins import Registry
from train.settings.checks import (
    Positive,
    Settings,
    Share,
    at_least,
    check,
    one_of,
    passes,
    rule,
)

AXES = (
    "opponent-epsilon",
    "goal-spread-fixed",
    "goal-spread-start",
    "start-distance",
    "num-goals",
    "maze-size",
    "loops",
    "target-distance",
    "free-joints",
    "hold",
    "tolerance",
)
"""What a curriculum can turn, from easy to hard; the last four of an arm."""


def is_axis(part: Any) -> bool:
    """Whether a part is a `Maker` of an axis."""
    return callable(getattr(part, "make", None)) and hasattr(part, "scripted")


AXIS_PARTS: Registry[Any] = Registry(
    "axis", "a train.teaching.axes.Maker", is_axis, plural="axes", ours=("auto", *AXES)
)
"""Axes of users' own."""


@dataclass(frozen=True)
class CurriculumSettings(Settings):
    """No curriculum: the task as it is, from the start."""

    @property
    def solved_within(self) -> float:
        """Success is an episode within this many times the exact optimum; 0: as the task says."""
        return 0.0

    @property
    def needs_optimum(self) -> bool:
        """Whether the exact optimum of every start must be known."""
        return self.solved_within > 0

    @property
    def needs_advantages(self) -> bool:
        """Whether the learner must tell its advantages."""
        return False


@dataclass(frozen=True)
class AxisSettings(CurriculumSettings):
    """The ends of what is turned."""

    easiest: float | None = None
    """Value at the beginning; where left out epsilon 1, a radius or distance of 3 (around fixed
    goals 0), one goal, the smallest maze, walls all open; of an arm 3 steps, one joint, hold 1,
    five times the tolerance."""
    hardest: float | None = None
    """Value in the end; the task's own if left out."""
    curriculum_mazes: str | None = None
    """Mazes from easy to hard, with commas, for maze-size and loops; the task's maze comes last by
    itself. Left out: its first rows, or itself with walls opened."""


Length = Annotated[float, rule(lambda value: 0 <= value < inf, "a length is finite and at least 0")]
Unit = Annotated[str, one_of(*UNITS)]
SolvedWithin = Annotated[
    float,
    rule(
        lambda value: value == 0 or 1 <= value < inf,
        "0, or a finite number from 1 (the optimum) on",
    ),
]


def check_unit(name: str, value: float, unit: str) -> None:
    """ValueError for what is meant in another unit: 500 shares of the budget, or half a frame."""
    check(
        unit != "share" or value <= 1.0,
        f"{name}={value:g} in shares of the budget never comes; give a share of at most 1, or "
        "schedule_unit frames, episodes or seconds",
    )
    check(
        unit not in ("frames", "episodes") or value == 0 or value >= 1.0,
        f"{name}={value:g} {unit} is over at once; give a number of {unit}, or schedule_unit share",
    )


@dataclass(frozen=True)
class ScheduleSettings(AxisSettings):
    """One value for all games, by a schedule."""

    schedule: Annotated[str, one_of(*SHAPES)] = "linear"
    """constant, linear, cosine, step (by 1 every schedule_every), exponential (times
    schedule_factor every schedule_every) or piecewise (schedule_points)."""
    schedule_unit: Unit = "share"
    """What progress is measured in: share (of the budget), frames, episodes or seconds."""
    schedule_length: Length = 0.5
    """Of linear and cosine, in that unit; afterwards the value is the hardest."""
    schedule_every: float = 500.0
    """Of step and exponential, in that unit."""
    schedule_factor: float = 0.99
    """Of exponential."""
    schedule_points: str = ""
    """Of piecewise: progress:value pairs, such as 0:1,0.3:0.5,0.6:0.2."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.schedule in ("linear", "cosine"):
            check_unit("schedule_length", self.schedule_length, self.schedule_unit)
        if self.schedule in ("step", "exponential"):
            check_unit("schedule_every", self.schedule_every, self.schedule_unit)
        self.build(1.0, 0.0)

    def points(self) -> tuple[tuple[float, float], ...]:
        """`schedule_points` as numbers."""
        try:
            pairs = [pair.split(":") for pair in self.schedule_points.split(",") if pair.strip()]
            return tuple((float(place), float(value)) for place, value in pairs)
        except ValueError:
            raise ValueError(
                f"schedule_points={self.schedule_points!r}; give progress:value pairs such as "
                "0:1,0.5:0.2"
            ) from None

    def build(self, easiest: float, hardest: float) -> Schedule:
        """The schedule between these ends."""
        return Schedule(
            self.schedule,
            easiest,
            hardest,
            self.schedule_unit,
            self.schedule_length,
            self.schedule_every,
            self.schedule_factor,
            self.points(),
        )


@dataclass(frozen=True)
class StagedSettings(AxisSettings):
    """Stages along one axis."""

    axis: Annotated[str, passes(AXIS_PARTS.check)] = "auto"
    """What is turned: opponent-epsilon, goal-spread-fixed, goal-spread-start, start-distance,
    num-goals, maze-size, loops; of an arm target-distance, free-joints, hold, tolerance; or
    package.module:Name of your own. auto: goal-spread-start where there are goals, else
    start-distance; of an arm target-distance."""
    num_stages: Annotated[int, at_least(2)] = 8
    """At most this many values from easiest to hardest."""


@dataclass(frozen=True)
class UniformSettings(StagedSettings):
    """A control: all stages from beginning to end, each game its own."""


@dataclass(frozen=True)
class TurnSettings(StagedSettings):
    """Controls: the same stages for the same time, in another order."""

    schedule_unit: Unit = "share"
    """What progress is measured in: share (of the budget), frames, episodes or seconds."""
    schedule_length: Length = 0.5
    """In that unit; afterwards all games are at the hardest."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_unit("schedule_length", self.schedule_length, self.schedule_unit)


@dataclass(frozen=True)
class ReversedSettings(TurnSettings):
    """A control: hard to easy in a straight line, then the hardest."""


@dataclass(frozen=True)
class ShuffledSettings(TurnSettings):
    """A control: the stages one after the other in a random order, then the hardest."""


@dataclass(frozen=True)
class SuccessGatedSettings(StagedSettings):
    """One stage for all games; the next one when this is mastered."""

    promote_at: Share = 0.9
    """Share of successes that leads to the next stage."""
    demote_at: Share = 0.0
    """Share of successes that leads back; 0 never does."""
    window: Annotated[int, at_least(1)] = 1024
    """Episodes that the share is of."""
    solved_within: SolvedWithin = 0.0
    """An episode is a success only within this many times the exact optimum of its start; 0 asks
    for what the task asks for (all goals collected, the evader caught, or survived)."""


@dataclass(frozen=True)
class LearningProgressSettings(StagedSettings):
    """A bandit over stages: those where the return changes most are played most."""

    average_fast: Share = 0.1
    """Share by which the fast moving average of the return moves at each update."""
    average_slow: Share = 0.02
    """The same of the slow one; their distance is the learning progress."""
    explore_share: Share = 0.2
    """Share of games in stages drawn uniformly."""


@dataclass(frozen=True)
class LevelReplaySettings(CurriculumSettings):
    """Prioritised level replay (Jiang et al., 2021): levels that teach are played again."""

    level_score: Annotated[str, one_of(*SCORES)] = "regret"
    """regret (to the exact optimum), value_loss, or learnability (p(1-p) of success)."""
    level_buffer: Annotated[int, at_least(2)] = 2048
    """Levels kept."""
    replay_share: Share = 0.5
    """Share of games that play a level again; the others play new ones."""
    level_temperature: Positive = 0.3
    """The lower, the more only the highest scores count."""
    staleness: Share = 0.1
    """Weight of levels that were not played for long."""
    solved_within: SolvedWithin = 0.0
    """An episode is a success only within this many times the exact optimum of its start; 0 asks
    for what the task asks for."""

    @property
    def needs_optimum(self) -> bool:
        """For regrets too."""
        return self.solved_within > 0 or self.level_score == "regret"

    @property
    def needs_advantages(self) -> bool:
        """Whether levels are scored by them."""
        return self.level_score == "value_loss"


@dataclass(frozen=True)
class LearnabilitySettings(LevelReplaySettings):
    """Level replay by learnability, p(1 - p) of success (Rutherford et al., 2024)."""

    level_score: Annotated[str, one_of(*SCORES)] = "learnability"
    """regret (to the exact optimum), value_loss, or learnability (p(1-p) of success)."""
    solved_within: SolvedWithin = 1.5
    """An episode is a success only within this many times the exact optimum of its start; 0 asks
    for what the task asks for."""


@dataclass(frozen=True)
class MazeReplaySettings(CurriculumSettings):
    """Mazes of a suite by their exact regret: those where the policy, as it is, falls short of the
    optimum most are played most; the other games are in mazes drawn uniformly."""

    SCORE: ClassVar[str] = "regret"
    replay_share: Share = 0.5
    """Share of games in mazes that were judged; the others are in mazes drawn uniformly."""
    level_temperature: Positive = 0.3
    """The lower, the more only the highest scores count."""
    staleness: Share = 0.1
    """Weight of mazes that were not judged for long."""
    judged: Annotated[int, at_least(1)] = 8
    """Mazes whose scores are computed at a time: from all starts, without playing."""
    judge_every: Annotated[int, at_least(1)] = 25_000
    """Frames from one time to the next."""


@dataclass(frozen=True)
class MazeLearnabilitySettings(MazeReplaySettings):
    """The same by exact learnability: the mean over starts of p(1 - p), p the chance to win."""

    SCORE: ClassVar[str] = "learnability"


CURRICULA: dict[str, type[CurriculumSettings]] = {
    "none": CurriculumSettings,
    **dict.fromkeys(AXES, ScheduleSettings),
    "success-gated": SuccessGatedSettings,
    "learning-progress": LearningProgressSettings,
    "level-replay": LevelReplaySettings,
    "learnability": LearnabilitySettings,
    "maze-replay": MazeReplaySettings,
    "maze-learnability": MazeLearnabilitySettings,
    "uniform": UniformSettings,
    "reversed": ReversedSettings,
    "shuffled": ShuffledSettings,
}


@dataclass(frozen=True)
class OwnCurriculum:
    """A curriculum of a user's own.

    Attributes:
        settings: the class of its settings; one of `StagedSettings` turns an axis, any other
            chooses levels.
        make: (settings, axis or None, seed) -> the curriculum, whose lessons are values of the axis
            or seeds of levels.
    """

    settings: type[CurriculumSettings]
    make: Callable[[Any, Any, int], Curriculum]


CURRICULUM_PARTS: Registry[Any] = Registry(
    "curriculum",
    "a train.settings.curricula.OwnCurriculum, or the Maker of an axis",
    lambda part: isinstance(part, OwnCurriculum) or is_axis(part),
    plural="curricula",
    ours=tuple(CURRICULA),
)
"""Curricula of users' own; an axis of his own is a schedule along it, as with ours."""


def curriculum_form(name: str) -> type[CurriculumSettings]:
    """The settings of a curriculum by its name; ValueError for an unknown one."""
    if name in CURRICULA:
        return CURRICULA[name]
    part = CURRICULUM_PARTS.get(name)
    return part.settings if isinstance(part, OwnCurriculum) else ScheduleSettings
