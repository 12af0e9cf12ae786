"""Construction and validation of the curriculum of a run."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from curricula import (
    Curriculum,
    LearningProgress,
    LevelReplay,
    PoolReplay,
    Scheduled,
    Shuffled,
    SuccessGated,
    Uniform,
)
from curricula.schedules import Schedule
from pursuit.validation import check
from train.settings.curricula import (
    CURRICULA,
    CURRICULUM_PARTS,
    AxisSettings,
    CurriculumSettings,
    LearnabilitySettings,
    LearningProgressSettings,
    LevelReplaySettings,
    MazeLearnabilitySettings,
    MazeReplaySettings,
    OwnCurriculum,
    ReversedSettings,
    ScheduleSettings,
    ShuffledSettings,
    StagedSettings,
    SuccessGatedSettings,
    UniformSettings,
)
from train.teaching.axes import Axis, axis_of, maker_of
from train.teaching.context import AnyContext, CurriculumContext
from train.teaching.mazes import training_mazes
from train.teaching.optimum import Optimum
from train.teaching.regret import RegretScorer


@dataclass(frozen=True)
class Plan:
    """A curriculum for a run.

    Attributes:
        name: of the curriculum.
        settings: its settings.
        axis: the axis that it varies; None if it chooses levels.
        task: the task of the training games, which has the mazes of the curriculum.
        optimum: computes the exact optimum of any start, if the curriculum needs it.
        seed: of the random numbers of the curriculum.
        scorer: scores the mazes of a suite, for a curriculum over mazes.
    """

    name: str
    settings: CurriculumSettings
    axis: Axis | None
    task: Any
    optimum: Optimum | None
    seed: int
    scorer: RegretScorer | None = None

    def curriculum(self) -> Curriculum:
        """A new curriculum."""
        return make_curriculum(self.name, self.settings, self.axis, self.seed)


def plan_curriculum(
    name: str, settings: CurriculumSettings, context: AnyContext, seed: int
) -> Plan | None:
    """The plan of a curriculum for a task; None for the curriculum "none".

    Args:
        name: of the curriculum.
        settings: its settings.
        context: the task and the opponents.
        seed: of the random numbers of the curriculum.

    Raises:
        ValueError: the task does not meet the requirements of the curriculum.
    """
    if name == "none":
        return None
    if isinstance(settings, MazeReplaySettings):
        return plan_pool(name, settings, context, seed)
    axis, varied, task = None, None, context.task
    if isinstance(settings, AxisSettings):
        varied = axis_name(name, settings)
        axis = axis_of(varied, context, settings)
        if axis.easiest == axis.hardest:
            warnings.warn(
                f"curriculum {name!r} goes from {axis.easiest:g} to {axis.hardest:g}, so it has no "
                "effect; give easiest and hardest, or a harder task",
                stacklevel=2,
            )
        if isinstance(settings, ShuffledSettings) and len(axis.stages(settings.num_stages)) == 2:
            warnings.warn(
                f"curriculum {name!r} has two stages, so half of the seeds have the order of a "
                "curriculum from easy to hard, and the same run; give an axis or ends with at "
                "least three values",
                stacklevel=2,
            )
        if isinstance(settings, ScheduleSettings):
            for _, value in settings.points():  # raises for values that are not allowed
                axis_of(varied, context, replace(settings, easiest=value))
    else:
        context.check_levels(name)
    optimum, training = None, training_task(name, settings, task)
    if settings.needs_optimum:
        steady = axis is None or varied == "auto" or not maker_of(str(varied)).scripted
        optimum = context.optimum(training) if steady else None
        check(
            optimum is not None,
            f"curriculum={name!r} with these settings needs the exact optimum of every start, "
            f"unknown for task {task.name!r} with these agents (or a changing opponent epsilon); "
            "set solved_within=0, and for level replay level_score=learnability",
        )
    plan = Plan(name, settings, axis, training, optimum, seed)
    plan.curriculum()  # raises for a schedule that does not match the ends
    return plan


def plan_pool(name: str, settings: MazeReplaySettings, context: Any, seed: int) -> Plan:
    """The plan of a curriculum over the mazes of a suite; ValueError as `plan_curriculum`."""
    check(
        isinstance(context, CurriculumContext) and len(context.task.mazes) > 1,
        f"curriculum={name!r} chooses among mazes, and task {context.task.name!r} has one; use a "
        "suite such as --maze suite:7x7-train",
    )
    task, scored = context.task, settings.num_scored
    mazes = len(task.mazes)
    check(
        scored <= max(mazes, MazeReplaySettings.num_scored),
        f"num_scored={scored}, but the suite has {mazes} mazes; give at most {mazes}",
    )
    scorer = RegretScorer(task, context.agent, context.opponents, settings.SCORE)

    def apply(simulator: Any, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        simulator.configure(games, maze=values.astype(np.int64))

    axis = Axis(
        f"{settings.SCORE}-of mazes", 0.0, mazes - 1.0, apply, mazes=task.mazes, ordered=False
    )
    return Plan(name, settings, axis, task, None, seed, scorer)


def axis_name(name: str, settings: AxisSettings) -> str:
    """The axis of a curriculum: that of its settings, or of its name."""
    return settings.axis if isinstance(settings, StagedSettings) else name


def training_task(name: str, settings: CurriculumSettings, task: Any) -> Any:
    """The task of the training games: the task of the run with the mazes of the curriculum.

    Raises:
        ValueError: mazes that the curriculum does not allow.
    """
    if not isinstance(settings, AxisSettings):
        return task
    varied = axis_name(name, settings)
    if varied == "auto" or not maker_of(varied).mazes:
        return task
    mazes = training_mazes(varied, settings.curriculum_mazes, task)
    return replace(task, maze=mazes)


# -- curricula from their settings -----------------------------------------------------------------


def make_curriculum(
    name: str, settings: CurriculumSettings, axis: Axis | None, seed: int
) -> Curriculum:
    """A new curriculum; ValueError for a schedule that does not match the ends of the axis."""
    own = None if name in CURRICULA else CURRICULUM_PARTS.get(name)
    if isinstance(own, OwnCurriculum):
        return own.make(settings, axis, seed)
    return CURRICULUM_MAKERS[type(settings)](settings, axis, seed)


def _replay(settings: LevelReplaySettings, axis: None, seed: int) -> Curriculum:
    return LevelReplay(
        settings.level_score,
        settings.level_buffer,
        settings.replay_share,
        settings.level_temperature,
        settings.staleness,
    )


def _gated(settings: SuccessGatedSettings, axis: Axis, seed: int) -> Curriculum:
    stages = axis.stages(settings.num_stages)
    return SuccessGated(stages, settings.promote_at, settings.demote_at, settings.window)


def _progress(settings: LearningProgressSettings, axis: Axis, seed: int) -> Curriculum:
    rates = settings.average_fast, settings.average_slow
    return LearningProgress(axis.stages(settings.num_stages), *rates, settings.explore_share)


def _shuffled(settings: ShuffledSettings, axis: Axis, seed: int) -> Curriculum:
    when = settings.schedule_length, settings.schedule_unit
    return Shuffled(axis.stages(settings.num_stages), *when, seed)


def _reversed(settings: ReversedSettings, axis: Axis, seed: int) -> Curriculum:
    # At the end of `schedule_length` it jumps from the easiest value back to the hardest.
    length, hardest = settings.schedule_length, axis.hardest
    points = ((0.0, hardest), (0.999 * length, axis.easiest), (length, hardest)) if length else ()
    shape = "piecewise" if length else "constant"
    return Scheduled(
        Schedule(shape, hardest, hardest, settings.schedule_unit, points=points), axis.whole
    )


def _scheduled(settings: ScheduleSettings, axis: Axis, seed: int) -> Curriculum:
    return Scheduled(settings.build(axis.easiest, axis.hardest), axis.whole)


def _pool(settings: MazeReplaySettings, axis: Axis, seed: int) -> Curriculum:
    rest = (settings.replay_share, settings.level_temperature, settings.staleness)
    return PoolReplay(len(axis.mazes), settings.num_scored, *rest)


CURRICULUM_MAKERS: dict[type[CurriculumSettings], Callable[[Any, Any, int], Curriculum]] = {
    ScheduleSettings: _scheduled,
    SuccessGatedSettings: _gated,
    LearningProgressSettings: _progress,
    LevelReplaySettings: _replay,
    LearnabilitySettings: _replay,
    MazeReplaySettings: _pool,
    MazeLearnabilitySettings: _pool,
    UniformSettings: lambda settings, axis, seed: Uniform(axis.stages(settings.num_stages)),
    ReversedSettings: _reversed,
    ShuffledSettings: _shuffled,
}
"""(settings, axis, seed) -> a curriculum, by the class of the settings."""
