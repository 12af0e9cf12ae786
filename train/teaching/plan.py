"""Construction and validation of the curriculum of a run."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

from curricula import Curriculum
from pursuit.validation import check
from train.settings.axes import Axis
from train.settings.curricula import (
    CURRICULA,
    CURRICULUM_PARTS,
    AxisSettings,
    CurriculumSettings,
    MazeReplaySettings,
    OwnCurriculum,
    ScheduleSettings,
    ShuffledSettings,
    StagedSettings,
)
from train.teaching.axes import axis_of, configure, maker_of
from train.teaching.context import Context
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
        """A new curriculum; ValueError for a schedule that does not match the ends of the axis."""
        custom = None if self.name in CURRICULA else CURRICULUM_PARTS.get(self.name)
        if isinstance(custom, OwnCurriculum):
            return custom.make(self.settings, self.axis, self.seed)
        return self.settings.build(self.axis, self.seed)


def plan_curriculum(
    name: str, settings: CurriculumSettings, context: Context, seed: int
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
    context.check(name)
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
    optimum = None
    training = training_task(name, settings, task)
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


def plan_pool(name: str, settings: MazeReplaySettings, context: Context, seed: int) -> Plan:
    """The plan of a curriculum over the mazes of a suite; ValueError as `plan_curriculum`."""
    task, scored, mazes = context.task, settings.num_scored, len(context.mazes)
    check(
        mazes > 1,
        f"curriculum={name!r} chooses among mazes, and task {task.name!r} has one; use a suite "
        "such as --maze suite:7x7-train",
    )
    check(
        scored <= max(mazes, MazeReplaySettings.num_scored),
        f"num_scored={scored}, but the suite has {mazes} mazes; give at most {mazes}",
    )
    scorer = RegretScorer(task, context.agent, context.opponents, settings.SCORE)

    # The values are indices of mazes.
    axis = Axis(
        f"{settings.SCORE}-of mazes",
        0.0,
        mazes - 1.0,
        configure("maze"),
        mazes=context.mazes,
        ordered=False,
    )
    return Plan(name, settings, axis, task, None, seed, scorer)


def axis_name(name: str, settings: AxisSettings) -> str:
    """The axis of a curriculum: that of its settings, or of its name."""
    return settings.axis if isinstance(settings, StagedSettings) else name


def training_task(name: str, settings: CurriculumSettings, task: Any) -> Any:
    """The task of the training games: the task of the run with the mazes of the curriculum, if it
    varies them.

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
