"""Plans: what is to be taught, made of parts and checked before a run begins."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
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
from pursuit.mazes.maze import Maze
from train.algorithms.registry import Algorithm
from train.settings.checks import check
from train.settings.curricula import (
    CURRICULA,
    CURRICULUM_PARTS,
    AxisSettings,
    CurriculumSettings,
    LearnabilitySettings,
    LearningProgressSettings,
    LevelReplaySettings,
    MazeEditingSettings,
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
from train.teaching.axes import axis_of, maker_of
from train.teaching.edits import BASE, with_edits
from train.teaching.exams import Exam
from train.teaching.grounds import AnyGround, Axis, Ground
from train.teaching.mazes import training_mazes
from train.teaching.optimum import Optimum


@dataclass(frozen=True)
class Plan:
    """What is to be taught.

    Attributes:
        name: of the curriculum.
        lessons: its settings.
        axis: what it turns; None where it chooses levels.
        task: of the training games: the task itself, with the mazes of the curriculum.
        optimum: the exact optimum of every start, where the lessons need it.
        seed: of what the curriculum draws.
        parents: of the mazes of a pool, by number: see `curricula.PoolReplay`; None without one.
        exam: what judges those mazes.
    """

    name: str
    lessons: CurriculumSettings
    axis: Axis | None
    task: Any
    optimum: Optimum | None
    seed: int
    parents: tuple[int, ...] | None = None
    exam: Exam | None = None

    def curriculum(self) -> Curriculum:
        """A fresh curriculum."""
        if self.parents is not None and isinstance(self.lessons, MazeReplaySettings):
            return make_pool(self.lessons, self.parents)
        return make_curriculum(self.name, self.lessons, self.axis, self.seed)


def plan_lessons(
    name: str, lessons: CurriculumSettings, ground: AnyGround, seed: int
) -> Plan | None:
    """What is to be taught in a task; None for the curriculum "none".

    Args:
        name: of the curriculum.
        lessons: its settings.
        ground: the task, with whoever plays in it.
        seed: of what the curriculum draws.

    Raises:
        ValueError: it asks for what the task has not.
    """
    if name == "none":
        return None
    if isinstance(lessons, MazeReplaySettings):
        return plan_pool(name, lessons, ground, seed)
    axis, turned, task = None, None, ground.task
    if isinstance(lessons, AxisSettings):
        turned = axis_name(name, lessons)
        axis = axis_of(turned, ground, lessons)
        if axis.easiest == axis.hardest:
            warnings.warn(
                f"curriculum {name!r} goes from {axis.easiest:g} to {axis.hardest:g}: it teaches "
                "nothing; give easiest and hardest, or a task that is harder",
                stacklevel=2,
            )
        if isinstance(lessons, ScheduleSettings):
            for _, value in lessons.points():  # each must be possible, as the ends must
                axis_of(turned, ground, replace(lessons, easiest=value))
    else:
        ground.check_levels(name)
    optimum, played = None, training_task(name, lessons, task)
    if lessons.needs_optimum:
        steady = axis is None or turned == "auto" or not maker_of(str(turned)).scripted
        optimum = ground.optimum(played) if steady else None
        check(
            optimum is not None,
            f"curriculum={name!r} as set needs the exact optimum of every start, which is not "
            f"known for task {task.name!r} with these agents (or while the opponent's epsilon "
            "changes); set solved_within=0 and, for levels, level_score='learnability'",
        )
    plan = Plan(name, lessons, axis, played, optimum, seed)
    plan.curriculum()  # ValueError for a schedule that does not fit the ends
    return plan


def plan_pool(name: str, lessons: MazeReplaySettings, ground: Any, seed: int) -> Plan:
    """What is to be taught in many mazes, judged exactly; ValueError as `plan_lessons`."""
    check(
        isinstance(ground, Ground) and len(ground.task.mazes) > 1,
        f"curriculum={name!r} chooses among mazes, and task {ground.task.name!r} has one; take "
        "--maze suite:7x7-train",
    )
    mazes, parents = pool_of(lessons, ground.task)
    played = replace(ground.task, maze=mazes)
    exam = Exam(played, ground.agent, ground.opponents, lessons.SCORE)

    def apply(simulator: Any, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        simulator.configure(games, maze=values.astype(np.int64))

    last = float(len(mazes) - 1)
    axis = Axis(f"{lessons.SCORE}-of mazes", 0.0, last, apply, mazes=mazes, ordered=False)
    return Plan(name, lessons, axis, played, None, seed, tuple(parents), exam)


@lru_cache(maxsize=4)
def pool_of(lessons: MazeReplaySettings, task: Any) -> tuple[tuple[Maze, ...], tuple[int, ...]]:
    """The mazes of a pool, edits among them, and the parent of each by number."""
    if not isinstance(lessons, MazeEditingSettings):
        return task.mazes, (BASE,) * len(task.mazes)
    shape = (lessons.edit_children, lessons.edit_depth, lessons.edit_walls)
    mazes, parents = with_edits(task.mazes, *shape, lessons.edit_seed)
    return mazes, tuple(parents)


def make_pool(given: MazeReplaySettings, parents: Sequence[int]) -> PoolReplay:
    """A fresh curriculum over a pool."""
    edit_share = given.edit_share if isinstance(given, MazeEditingSettings) else 0.0
    rest = (given.replay_share, given.level_temperature, given.staleness, edit_share)
    return PoolReplay(parents, given.judged, *rest)


def axis_name(name: str, lessons: AxisSettings) -> str:
    """What a curriculum turns: what its settings say, or what it is called after."""
    return lessons.axis if isinstance(lessons, StagedSettings) else name


def training_task(name: str, lessons: CurriculumSettings, task: Any) -> Any:
    """The task of the training games: that of the run, with the mazes of the curriculum in it.

    Raises:
        ValueError: mazes that the curriculum cannot have.
    """
    if isinstance(lessons, MazeEditingSettings) and len(task.mazes) > 1:
        return replace(task, maze=pool_of(lessons, task)[0])
    if not isinstance(lessons, AxisSettings):
        return task
    turned = axis_name(name, lessons)
    if turned == "auto" or not maker_of(turned).mazes:
        return task
    mazes = training_mazes(turned, lessons.curriculum_mazes, task)
    return replace(task, maze=mazes)


def check_learner(plan: Plan, algorithm: Algorithm) -> None:
    """Raise ValueError where an algorithm cannot be taught so."""
    check(
        plan.axis is None or not plan.axis.mazes or not algorithm.one_maze,
        f"curriculum={plan.name!r} plays several mazes, and {algorithm.name} has a table for one; "
        "take a learner with a network",
    )
    check(
        not plan.lessons.needs_advantages or algorithm.has_advantages,
        f"level_score='value_loss' needs advantages, which algorithm={algorithm.name!r} has not; "
        "take regret or learnability, or ppo or a2c",
    )


# -- curricula of their settings -------------------------------------------------------------------


def make_curriculum(
    name: str, lessons: CurriculumSettings, axis: Axis | None, seed: int
) -> Curriculum:
    """A fresh curriculum; ValueError for a schedule that does not fit the axis' ends."""
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
    # In the last moment of its length it jumps from the easiest back to the hardest.
    length, hardest = given.schedule_length, axis.hardest
    points = ((0.0, hardest), (0.999 * length, axis.easiest), (length, hardest)) if length else ()
    shape = "piecewise" if length else "constant"
    return Scheduled(
        Schedule(shape, hardest, hardest, given.schedule_unit, points=points), axis.whole
    )


def _scheduled(given: ScheduleSettings, axis: Axis, seed: int) -> Curriculum:
    return Scheduled(given.build(axis.easiest, axis.hardest), axis.whole)


def _pool_of_axis(given: MazeReplaySettings, axis: Axis, seed: int) -> Curriculum:
    return make_pool(given, [BASE] * len(axis.mazes))


CURRICULUM_MAKERS: dict[type[CurriculumSettings], Callable[[Any, Any, int], Curriculum]] = {
    ScheduleSettings: _scheduled,
    SuccessGatedSettings: _gated,
    LearningProgressSettings: _progress,
    LevelReplaySettings: _replay,
    LearnabilitySettings: _replay,
    **dict.fromkeys(
        (MazeReplaySettings, MazeLearnabilitySettings, MazeEditingSettings), _pool_of_axis
    ),
    UniformSettings: lambda given, axis, seed: Uniform(axis.stages(given.num_stages)),
    ReversedSettings: _reversed,
    ShuffledSettings: _shuffled,
}
"""What makes a curriculum of its settings, its axis and a seed."""
