"""The plan of a curriculum, built and validated before a run starts."""

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
from train.settings.checks import check
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
        lessons: its settings.
        axis: the axis that it varies; None if it chooses levels.
        task: of the training games: the task of the run, with the mazes of the curriculum.
        optimum: the exact optimum of every start, if the curriculum needs it.
        seed: of the random numbers of the curriculum.
        scorer: scores the mazes of a suite, if the curriculum chooses among them.
    """

    name: str
    lessons: CurriculumSettings
    axis: Axis | None
    task: Any
    optimum: Optimum | None
    seed: int
    scorer: RegretScorer | None = None

    def curriculum(self) -> Curriculum:
        """A new curriculum."""
        return make_curriculum(self.name, self.lessons, self.axis, self.seed)


def plan_curriculum(
    name: str, lessons: CurriculumSettings, context: AnyContext, seed: int
) -> Plan | None:
    """The plan of a curriculum for a task; None for the curriculum "none".

    Args:
        name: of the curriculum.
        lessons: its settings.
        context: the task and the opponents.
        seed: of the random numbers of the curriculum.

    Raises:
        ValueError: the task does not meet the requirements of the curriculum.
    """
    if name == "none":
        return None
    if isinstance(lessons, MazeReplaySettings):
        return plan_pool(name, lessons, context, seed)
    axis, turned, task = None, None, context.task
    if isinstance(lessons, AxisSettings):
        turned = axis_name(name, lessons)
        axis = axis_of(turned, context, lessons)
        if axis.easiest == axis.hardest:
            warnings.warn(
                f"curriculum {name!r} goes from {axis.easiest:g} to {axis.hardest:g}, so it has no "
                "effect; give easiest and hardest, or a harder task",
                stacklevel=2,
            )
        if isinstance(lessons, ScheduleSettings):
            for _, value in lessons.points():  # each must be allowed
                axis_of(turned, context, replace(lessons, easiest=value))
    else:
        context.check_levels(name)
    optimum, played = None, training_task(name, lessons, task)
    if lessons.needs_optimum:
        steady = axis is None or turned == "auto" or not maker_of(str(turned)).scripted
        optimum = context.optimum(played) if steady else None
        check(
            optimum is not None,
            f"curriculum={name!r} with these settings needs the exact optimum of every start, "
            f"unknown for task {task.name!r} with these agents (or a changing opponent epsilon); "
            "set solved_within=0 and, for levels, level_score=learnability",
        )
    plan = Plan(name, lessons, axis, played, optimum, seed)
    plan.curriculum()  # ValueError for a schedule that does not match the ends
    return plan


def plan_pool(name: str, lessons: MazeReplaySettings, context: Any, seed: int) -> Plan:
    """The plan of a curriculum over the mazes of a suite; ValueError as `plan_curriculum`."""
    check(
        isinstance(context, CurriculumContext) and len(context.task.mazes) > 1,
        f"curriculum={name!r} chooses among mazes, and task {context.task.name!r} has one; use a "
        "suite such as --maze suite:7x7-train",
    )
    task = context.task
    scorer = RegretScorer(task, context.agent, context.opponents, lessons.SCORE)

    def apply(simulator: Any, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        simulator.configure(games, maze=values.astype(np.int64))

    last = float(len(task.mazes) - 1)
    axis = Axis(f"{lessons.SCORE}-of mazes", 0.0, last, apply, mazes=task.mazes, ordered=False)
    return Plan(name, lessons, axis, task, None, seed, scorer)


def axis_name(name: str, lessons: AxisSettings) -> str:
    """The axis of a curriculum: that of its settings, or of its name."""
    return lessons.axis if isinstance(lessons, StagedSettings) else name


def training_task(name: str, lessons: CurriculumSettings, task: Any) -> Any:
    """The task of the training games: that of the run, with the mazes of the curriculum.

    Raises:
        ValueError: mazes that the curriculum does not allow.
    """
    if not isinstance(lessons, AxisSettings):
        return task
    turned = axis_name(name, lessons)
    if turned == "auto" or not maker_of(turned).mazes:
        return task
    mazes = training_mazes(turned, lessons.curriculum_mazes, task)
    return replace(task, maze=mazes)


# -- curricula from their settings -----------------------------------------------------------------


def make_curriculum(
    name: str, lessons: CurriculumSettings, axis: Axis | None, seed: int
) -> Curriculum:
    """A new curriculum; ValueError for a schedule that does not match the ends of the axis."""
    own = None if name in CURRICULA else CURRICULUM_PARTS.get(name)
    if isinstance(own, OwnCurriculum):
        return own.make(lessons, axis, seed)
    return CURRICULUM_MAKERS[type(lessons)](lessons, axis, seed)


def _replay(given: LevelReplaySettings, axis: None, seed: int) -> Curriculum:
    return LevelReplay(
        given.level_score,
        given.level_buffer,
        given.replay_share,
        given.level_temperature,
        given.staleness,
    )


def _gated(given: SuccessGatedSettings, axis: Axis, seed: int) -> Curriculum:
    stages = axis.stages(given.num_stages)
    return SuccessGated(stages, given.promote_at, given.demote_at, given.window)


def _progress(given: LearningProgressSettings, axis: Axis, seed: int) -> Curriculum:
    stages = axis.stages(given.num_stages)
    return LearningProgress(stages, given.average_fast, given.average_slow, given.explore_share)


def _shuffled(given: ShuffledSettings, axis: Axis, seed: int) -> Curriculum:
    return Shuffled(axis.stages(given.num_stages), given.schedule_length, given.schedule_unit, seed)


def _reversed(given: ReversedSettings, axis: Axis, seed: int) -> Curriculum:
    # At the end of its length it jumps from the easiest back to the hardest.
    length, hardest = given.schedule_length, axis.hardest
    points = ((0.0, hardest), (0.999 * length, axis.easiest), (length, hardest)) if length else ()
    shape = "piecewise" if length else "constant"
    return Scheduled(
        Schedule(shape, hardest, hardest, given.schedule_unit, points=points), axis.whole
    )


def _scheduled(given: ScheduleSettings, axis: Axis, seed: int) -> Curriculum:
    return Scheduled(given.build(axis.easiest, axis.hardest), axis.whole)


def _pool(given: MazeReplaySettings, axis: Axis, seed: int) -> Curriculum:
    rest = (given.replay_share, given.level_temperature, given.staleness)
    return PoolReplay(len(axis.mazes), given.judged, *rest)


CURRICULUM_MAKERS: dict[type[CurriculumSettings], Callable[[Any, Any, int], Curriculum]] = {
    ScheduleSettings: _scheduled,
    SuccessGatedSettings: _gated,
    LearningProgressSettings: _progress,
    LevelReplaySettings: _replay,
    LearnabilitySettings: _replay,
    MazeReplaySettings: _pool,
    MazeLearnabilitySettings: _pool,
    UniformSettings: lambda given, axis, seed: Uniform(axis.stages(given.num_stages)),
    ReversedSettings: _reversed,
    ShuffledSettings: _shuffled,
}
"""(settings, axis, seed) -> a curriculum, by the class of the settings."""
