"""Settings of every curriculum: frozen dataclasses. No torch here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, ClassVar

from curricula import (
    Curriculum,
    LearningProgress,
    LevelReplay,
    PoolReplay,
    Schedule,
    Scheduled,
    Shuffled,
    SuccessGated,
    Uniform,
)
from curricula.levels import SCORES
from curricula.schedules import SHAPES, UNITS
from pursuit.plugins import Registry
from pursuit.validation import at_least, check, choice, passes, rule
from train.settings.axes import AXES, AXIS_PARTS, Axis, is_axis
from train.settings.checks import Positive, Settings, Share


@dataclass(frozen=True)
class CurriculumSettings(Settings):
    """No curriculum: the task itself from the start."""

    GROUP: ClassVar[str] = "Learner"
    """The group in help texts."""

    schedule_unit = "share"
    """Unit of the schedule, if there is one; without annotation it is no field."""
    solved_within = 0.0
    """An episode is a success within this many times the optimum; 0: as the task defines it."""

    def build(self, axis: Any, seed: int) -> Curriculum:
        """A new curriculum over the values of an `Axis`, or over levels if that is None."""
        raise ValueError(f"{type(self).__name__} builds no curriculum; give it build(axis, seed)")

    @property
    def curriculum_mazes(self) -> str | None:
        """The mazes that it names; None for one that names none."""
        return None

    @property
    def needs_optimum(self) -> bool:
        """Whether the exact optimum of every start is needed."""
        return self.solved_within > 0

    @property
    def needs_advantages(self) -> bool:
        """Whether the learner must report its advantages."""
        return False


@dataclass(frozen=True)
class AxisSettings(CurriculumSettings):
    """The range of the task parameter that a curriculum varies."""

    easiest: float | None = None
    """Value at the beginning. None: epsilon 1; a radius or distance of 3 (0 around fixed goals);
    one goal; the smallest maze; all walls open; for the arm 3 steps, one joint, hold 1, five times
    the tolerance."""
    hardest: float | None = None
    """Value at the end. None: that of the task."""
    curriculum_mazes: str | None = None
    """Mazes for maze-size and loops, from easy to hard, separated by commas. The maze of the task
    is appended. None: its first rows, or the maze with walls removed."""


Length = Annotated[float, rule(lambda value: 0 <= value < inf, "must be finite and at least 0")]
Unit = Annotated[str, choice(*UNITS)]
_WITHIN = rule(
    lambda value: value == 0 or 1 <= value < inf,
    "give 0, or a finite number of at least 1 (the optimum)",
)
SolvedWithin = Annotated[float, _WITHIN]


def check_unit(name: str, value: float, unit: str) -> None:
    """ValueError for a value that cannot be in this unit: 500 budgets, or half a frame."""
    check(
        unit != "share" or value <= 1.0,
        f"{name}={value:g} is more than the budget (schedule_unit=share); give at most 1, or set "
        "schedule_unit to frames, episodes or seconds",
    )
    check(
        unit not in ("frames", "episodes") or value == 0 or value >= 1.0,
        f"{name}={value:g} {unit} is less than 1; give a number of {unit}, or schedule_unit=share",
    )


@dataclass(frozen=True)
class ScheduleSettings(AxisSettings):
    """One value for all games, set by a schedule."""

    schedule: Annotated[str, choice(*SHAPES)] = "linear"
    """constant, linear, cosine, step (by 1 every schedule_every), exponential (multiplied by
    schedule_factor every schedule_every) or piecewise (schedule_points)."""
    schedule_unit: Unit = "share"
    """Unit of progress: share (of the budget), frames, episodes or seconds."""
    schedule_length: Length = 0.5
    """Duration of linear and cosine schedules in schedule_unit; afterwards the value is hardest."""
    schedule_every: float = 500.0
    """Interval of step and exponential schedules in schedule_unit."""
    schedule_factor: float = 0.99
    """Factor of exponential schedules."""
    schedule_points: str = ""
    """Points of piecewise schedules: progress:value pairs, such as 0:1,0.3:0.5,0.6:0.2."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.schedule in ("linear", "cosine"):
            check_unit("schedule_length", self.schedule_length, self.schedule_unit)
        if self.schedule in ("step", "exponential"):
            check_unit("schedule_every", self.schedule_every, self.schedule_unit)
        self.schedule_between(1.0, 0.0)

    def points(self) -> tuple[tuple[float, float], ...]:
        """`schedule_points` as pairs of numbers."""
        try:
            pairs = [pair.split(":") for pair in self.schedule_points.split(",") if pair.strip()]
            return tuple((float(place), float(value)) for place, value in pairs)
        except ValueError:
            raise ValueError(
                f"schedule_points={self.schedule_points!r}; give progress:value pairs such as "
                "0:1,0.5:0.2"
            ) from None

    def schedule_between(self, easiest: float, hardest: float) -> Schedule:
        """The schedule between these two values."""
        lasts = (self.schedule_unit, self.schedule_length)
        steps = (self.schedule_every, self.schedule_factor)
        return Schedule(self.schedule, easiest, hardest, *lasts, *steps, self.points())

    def build(self, axis: Axis, seed: int) -> Curriculum:
        """As in `CurriculumSettings`; ValueError for a schedule that does not match the ends."""
        return Scheduled(self.schedule_between(axis.easiest, axis.hardest), axis.whole)


@dataclass(frozen=True)
class StagedSettings(AxisSettings):
    """Stages at equal distances along one axis."""

    axis: Annotated[str, passes(AXIS_PARTS.check)] = "auto"
    """Task parameter that is varied: opponent-epsilon, slip, goal-spread-fixed, goal-spread-start,
    start-distance, num-goals, maze-size, loops; for the arm target-distance, free-joints, hold,
    tolerance; or package.module:Name of a user-defined axis. auto: goal-spread-start in tasks with
    goals, target-distance for the arm, else start-distance."""
    num_stages: Annotated[int, rule(lambda value: 2 <= value <= 1000, "give 2 to 1000")] = 8
    """Largest number of stages from easiest to hardest."""


@dataclass(frozen=True)
class UniformSettings(StagedSettings):
    """A control: stages are drawn uniformly during the whole run."""

    def build(self, axis: Axis, seed: int) -> Curriculum:
        """As in `CurriculumSettings`."""
        return Uniform(axis.stages(self.num_stages))


@dataclass(frozen=True)
class TurnSettings(StagedSettings):
    """Controls: the same stages for the same total time, in another order."""

    schedule_unit: Unit = "share"
    """Unit of progress: share (of the budget), frames, episodes or seconds."""
    schedule_length: Length = 0.5
    """Duration in schedule_unit; afterwards all games are in the hardest stage."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_unit("schedule_length", self.schedule_length, self.schedule_unit)


@dataclass(frozen=True)
class ReversedSettings(TurnSettings):
    """A control: linearly from hard to easy, then the hardest stage."""

    def build(self, axis: Axis, seed: int) -> Curriculum:
        """As in `CurriculumSettings`."""
        # At the end of `schedule_length` it jumps from the easiest value back to the hardest.
        length, hard, easy = self.schedule_length, axis.hardest, axis.easiest
        points = ((0.0, hard), (0.999 * length, easy), (length, hard)) if length else ()
        shape = "piecewise" if length else "constant"
        return Scheduled(Schedule(shape, hard, hard, self.schedule_unit, points=points), axis.whole)


@dataclass(frozen=True)
class ShuffledSettings(TurnSettings):
    """A control: the stages in random order, then the hardest stage."""

    def build(self, axis: Axis, seed: int) -> Curriculum:
        """As in `CurriculumSettings`."""
        stages = axis.stages(self.num_stages)
        return Shuffled(stages, self.schedule_length, self.schedule_unit, seed)


@dataclass(frozen=True)
class SuccessGatedSettings(StagedSettings):
    """One stage for all games; promotion to the next one by the success rate."""

    promote_at: Share = 0.9
    """Success rate that promotes to the next stage."""
    demote_at: Share = 0.0
    """Success rate below which games return to the previous stage; 0 disables it."""
    window: Annotated[int, at_least(1)] = 1024
    """Number of latest episodes of which the success rate is computed."""
    solved_within: SolvedWithin = 0.0
    """An episode is a success only within this many times the exact optimum of its start. 0: as the
    task defines success."""

    def build(self, axis: Axis, seed: int) -> Curriculum:
        """As in `CurriculumSettings`."""
        stages = axis.stages(self.num_stages)
        return SuccessGated(stages, self.promote_at, self.demote_at, self.window)


@dataclass(frozen=True)
class LearningProgressSettings(StagedSettings):
    """A bandit over stages that prefers those where the return changes most."""

    average_fast: Share = 0.1
    """Step size of the fast moving average of the return."""
    average_slow: Share = 0.02
    """Step size of the slow moving average. The difference of the two is the learning progress."""
    explore_share: Share = 0.2
    """Fraction of games in stages drawn uniformly."""

    def build(self, axis: Axis, seed: int) -> Curriculum:
        """As in `CurriculumSettings`."""
        stages = axis.stages(self.num_stages)
        return LearningProgress(stages, self.average_fast, self.average_slow, self.explore_share)


@dataclass(frozen=True)
class LevelReplaySettings(CurriculumSettings):
    """Prioritised level replay (Jiang et al., 2021): levels with a high score are replayed."""

    level_score: Annotated[str, choice(*SCORES)] = "regret"
    """Score of levels: regret (to the exact optimum), value_loss, or learnability (p(1 - p), with p
    the success rate)."""
    level_buffer: Annotated[int, at_least(2)] = 2048
    """Number of levels in the buffer."""
    replay_share: Share = 0.5
    """Fraction of games that replay a level; the others play new ones."""
    level_temperature: Positive = 0.3
    """Temperature of the prioritisation. A low one replays only the highest scores."""
    staleness: Share = 0.1
    """Weight of levels that were not replayed recently."""
    solved_within: SolvedWithin = 0.0
    """An episode is a success only within this many times the exact optimum of its start. 0: as the
    task defines success."""

    @property
    def needs_optimum(self) -> bool:
        """Also for the score regret."""
        return self.solved_within > 0 or self.level_score == "regret"

    @property
    def needs_advantages(self) -> bool:
        """Whether the score is value_loss."""
        return self.level_score == "value_loss"

    def build(self, axis: None, seed: int) -> Curriculum:
        """As in `CurriculumSettings`."""
        how_replayed = (self.replay_share, self.level_temperature, self.staleness)
        return LevelReplay(self.level_score, self.level_buffer, *how_replayed)


@dataclass(frozen=True)
class LearnabilitySettings(LevelReplaySettings):
    """Level replay by learnability p(1 - p), with p the success rate (Rutherford et al., 2024)."""

    level_score: Annotated[str, choice(*SCORES)] = "learnability"
    """Score of levels: regret (to the exact optimum), value_loss, or learnability (p(1 - p), with p
    the success rate)."""
    solved_within: SolvedWithin = 1.5
    """An episode is a success only within this many times the exact optimum of its start. 0: as the
    task defines success."""


@dataclass(frozen=True)
class MazeReplaySettings(CurriculumSettings):
    """Replay of the mazes of a suite in which the current policy has the largest exact regret."""

    SCORE: ClassVar[str] = "regret"
    replay_share: Share = 0.5
    """Fraction of games in scored mazes; the others are in mazes drawn uniformly."""
    level_temperature: Positive = 0.3
    """Temperature of the prioritisation. A low one replays only the highest scores."""
    staleness: Share = 0.1
    """Weight of mazes that were not scored recently."""
    num_scored: Annotated[int, at_least(1)] = 8
    """Number of mazes in each exact scoring, at most those of the suite."""
    score_every: Annotated[int, at_least(1)] = 25_000
    """Frames between two scorings."""

    def build(self, axis: Axis, seed: int) -> Curriculum:
        """As in `CurriculumSettings`."""
        how_replayed = (self.replay_share, self.level_temperature, self.staleness)
        return PoolReplay(len(axis.mazes), self.num_scored, *how_replayed)


@dataclass(frozen=True)
class MazeLearnabilitySettings(MazeReplaySettings):
    """Replay of mazes by their exact learnability: the mean over starts of p(1 - p), with p the
    success probability."""

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
    """A user-defined curriculum.

    Attributes:
        settings: the class of its settings; a `StagedSettings` varies an axis, any other chooses
            levels.
        make: (settings, axis or None, seed) -> the curriculum, which samples values of the axis or
            seeds of levels.
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
"""User-defined curricula; a user-defined axis is a schedule along it, as with built-in axes."""


def curriculum_form(name: str) -> type[CurriculumSettings]:
    """The settings of a curriculum by its name; ValueError for an unknown one."""
    if isinstance(name, str) and name in CURRICULA:
        return CURRICULA[name]
    part = CURRICULUM_PARTS.get(name)
    return part.settings if isinstance(part, OwnCurriculum) else ScheduleSettings
