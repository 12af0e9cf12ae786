"""The axes of curricula: task parameters that a curriculum can vary from easy to hard.

`AXIS_MAKERS` holds the constructor and the requirements of each axis.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze, table_of_distances
from pursuit.reacher.task import LEAST_TOLERANCE
from pursuit.rules import UNREACHABLE
from pursuit.rules.arrays import Array
from pursuit.tasks.placements import check_placeable
from pursuit.tasks.task import Task
from pursuit.validation import check
from train.settings.axes import AXIS_PARTS, Apply
from train.settings.axes import Axis as Axis
from train.settings.curricula import AxisSettings
from train.teaching.context import NEEDS, ArmContext, Context, CurriculumContext
from train.teaching.mazes import training_mazes


@dataclass(frozen=True)
class Maker:
    """The constructor and the requirements of an axis.

    Attributes:
        make: (name, context, ends) -> the axis; ValueError for ends that are not allowed.
        goals: whether the task must have goals.
        random_starts: whether starts must be random.
        both: whether the task must have chasers and evaders.
        scripted: whether the task must have opponents, all of them scripted.
        mazes: whether the axis varies the maze (`curriculum_mazes`).
        arm: whether it is an axis of the arm, not of games in mazes.
        small_games: whether it is also an axis of small games, and of any other game whose batch
            sets the random moves of opponents.
    """

    make: Callable[[str, Any, AxisSettings], Axis]
    goals: bool = False
    random_starts: bool = False
    both: bool = False
    scripted: bool = False
    mazes: bool = False
    arm: bool = False
    small_games: bool = False

    def check(self, name: str, context: Context, ends: AxisSettings) -> None:
        """ValueError unless the task meets the requirements."""
        context.check_axis(name)
        outside = self.arm or (self.small_games and context.opponent_epsilon is not None)
        needed = {**vars(self), "in_mazes": not outside}
        for need, what in NEEDS.items():
            check(
                not needed[need] or context.offers.get(need, False),
                f"curriculum {name!r} needs {what}, which task {context.task.name!r} with these "
                "settings does not have; use another axis or task",
            )
        check(
            ends.curriculum_mazes is None or self.mazes,
            f"curriculum_mazes={ends.curriculum_mazes!r} with curriculum {name!r}; only maze-size "
            "and loops use a list of mazes: leave it out",
        )


def axis_of(name: str, context: Context, ends: AxisSettings) -> Axis:
    """The axis of this name for a task; "auto" is the default axis of the context.

    An end beyond the largest distance in the maze is clipped with a warning.

    Raises:
        ValueError: the task does not meet the requirements, or an end is not allowed.
    """
    name = context.default_axis if name == "auto" else name
    maker = maker_of(name)
    maker.check(name, context, ends)
    return maker.make(name, context, ends)


def maker_of(name: str) -> Maker:
    """The maker of an axis, built-in or user-defined; ValueError for an unknown name."""
    return AXIS_MAKERS.get(name) or AXIS_PARTS.get(name)


def ends_within(
    ends: AxisSettings,
    default: tuple[float, float],
    allowed: tuple[float, float],
    error: str,
    whole: bool = True,
) -> tuple[float, float]:
    """The ends of the settings, or `default`; ValueError for one that is infinite or not allowed.

    Args:
        default, allowed: (easiest, hardest) and (lowest, highest).
        error: message for a value that is not allowed, with "{:g}" for the value.
        whole: whether values must be whole numbers.
    """
    first = default[0] if ends.easiest is None else float(ends.easiest)
    last = default[1] if ends.hardest is None else float(ends.hardest)
    for value in (first, last):
        check(math.isfinite(value), f"easiest or hardest is {value}; give a finite number")
    for value in (first, last):
        inside = allowed[0] <= value <= allowed[1]
        check(inside and not (whole and value != int(value)), error.format(value))
    return first, last


def configure(setting: str, limit: float = math.inf, whole: bool = True, **constant: Any) -> Apply:
    """The `apply` of an axis that is one setting of the simulator.

    Args:
        setting: its name in `configure` of the simulator.
        limit: values of at least `limit` mean unlimited, which is -1 in the simulator.
        whole: whether the setting is a whole number.
        **constant: further settings with constant values.
    """

    def apply(simulator: Any, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        limited: Array = np.where(values >= limit, -1.0, values)
        limited = limited.astype(np.int64) if whole else limited
        simulator.configure(games, **{setting: limited}, **constant)

    return apply


# -- the axes --------------------------------------------------------------------------------------


def opponent_epsilon(name: str, context: Context, ends: AxisSettings) -> Axis:
    """Share of random moves of the opponents; 1 is the easiest."""
    learner = context.task.seat(context.agent)
    others = [seat for seat in range(context.task.num_agents) if seat != learner]
    error = "epsilon={}; give a share of random moves in [0, 1]"
    default = (1.0, context.opponent_epsilon or 0.0)
    first, last = ends_within(ends, default, (0.0, 1.0), error, whole=False)

    def apply(simulator: Any, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        for seat in others:
            simulator.configure(games, epsilon=values, seat=seat)

    return Axis(name, first, last, apply, whole=False)


def slip(name: str, context: CurriculumContext, ends: AxisSettings) -> Axis:
    """Largest probability of slips of the agents; 0 is the easiest. Others are scaled like it."""
    slips = np.array(context.task.slips)
    most = float(slips.max())
    check(
        most > 0.0,
        f"curriculum {name!r} needs slips, and task {context.task.name!r} has none; give a slip "
        "above 0",
    )
    error = "slip={}; give a probability of slips in [0, 1]"
    first, last = ends_within(ends, (0.0, most), (0.0, 1.0), error, whole=False)

    def apply(simulator: Any, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        simulator.configure(games, slip=values[:, None] * (slips / most))

    return Axis(name, first, last, apply, whole=False)


def goal_spread_fixed(name: str, context: CurriculumContext, ends: AxisSettings) -> Axis:
    """Largest distance in steps from the goal marks of the maze to the goals."""
    maze = context.task.mazes[0]
    check(
        bool(maze.goal_marks),
        f"curriculum {name!r} needs goal marks 'G' in the maze, and {maze.name} has none; add "
        "some, or use goal-spread-start",
    )
    marks = [maze.distances_from(mark) for mark in maze.goal_marks]
    farthest = int(np.min(marks, axis=0).max())
    first, last = _radius(name, ends, (0, farthest), 0, maze)
    return Axis(name, first, last, configure("goal_radius", farthest, goals_around="marks"))


def goal_spread_start(name: str, context: CurriculumContext, ends: AxisSettings) -> Axis:
    """Largest distance in steps from the learner's start to the goals."""
    maze, longest = context.task.mazes[0], longest_in(context.task)
    first, last = _radius(name, ends, (min(3, longest), longest), 1, maze)
    return Axis(name, first, last, configure("goal_radius", longest, goals_around="start"))


def start_distance(name: str, context: CurriculumContext, ends: AxisSettings) -> Axis:
    """Largest distance in steps between chasers and evaders at the start."""
    maze, least = context.task.mazes[0], context.task.min_start_distance
    longest = longest_in(context.task)
    near = min(max(3, least), longest)
    first, last = _radius(name, ends, (near, longest), least, maze)
    check_placeable(context.task.apart(0, -1, least, int(min(first, last))))
    return Axis(name, first, last, configure("max_start_distance", longest))


def num_goals(name: str, context: CurriculumContext, ends: AxisSettings) -> Axis:
    """Number of goals."""
    goals = context.task.num_goals
    check(goals > 1, f"curriculum {name!r} needs at least 2 goals; num_goals={goals}")
    error = f"{{:g}} goals; give a whole number from 1 to num_goals={goals}"
    first, last = ends_within(ends, (1, goals), (1, goals), error)
    return Axis(name, first, last, configure("num_goals"))


def maze_number(name: str, context: CurriculumContext, ends: AxisSettings) -> Axis:
    """Index of the maze in a list."""
    mazes = training_mazes(name, ends.curriculum_mazes, context.task)
    most, names = len(mazes) - 1, ", ".join(maze.name for maze in mazes)
    names = names.replace("{", "{{").replace("}", "}}")
    error = f"maze {{:g}}; give whole numbers from 0 to {most}, the indices of {names}"
    first, last = ends_within(ends, (0, most), (0, most), error)
    return Axis(name, first, last, configure("maze"), mazes=mazes)


def target_distance(name: str, context: ArmContext, ends: AxisSettings) -> Axis:
    """Largest distance in steps to the target; at most half a turn of the joints."""
    longest = math.ceil(math.pi / context.task.max_turn)
    error = f"{name} of {{:g}}; give a number of steps above 0"
    above_0 = (math.nextafter(0.0, 1.0), math.inf)
    first, last = ends_within(ends, (min(3, longest), longest), above_0, error, whole=False)
    apply = configure("target_distance", longest, whole=False)
    return Axis(name, first, last, apply, whole=False)


def free_joints(name: str, context: ArmContext, ends: AxisSettings) -> Axis:
    """Number of joints that turn; the other joints are locked at angle 0."""
    joints = context.task.joints
    error = f"{{:g}} free joints; give a whole number from 1 to joints={joints}"
    first, last = ends_within(ends, (1, joints), (1, joints), error)
    return Axis(name, first, last, configure("free_joints"))


def hold(name: str, context: ArmContext, ends: AxisSettings) -> Axis:
    """Consecutive steps within the tolerance that end an episode."""
    most = context.task.max_steps
    error = f"{name} of {{:g}}; give a whole number from 1 to max_steps={most}"
    first, last = ends_within(ends, (1, context.task.hold), (1, most), error)
    return Axis(name, first, last, configure("hold"))


def tolerance(name: str, context: ArmContext, ends: AxisSettings) -> Axis:
    """Distance from the target within which it is reached."""
    final, most = context.task.tolerance, 2.0 * context.task.joints
    error = (
        f"{name} of {{:g}}; give values from {LEAST_TOLERANCE:g} to {most:g} (twice the joints) "
        "for the task's tolerance, easiest and hardest"
    )
    default = (min(5.0 * final, most), final)
    first, last = ends_within(ends, default, (LEAST_TOLERANCE, most), error, whole=False)
    return Axis(name, first, last, configure("tolerance", whole=False), whole=False)


def _radius(
    name: str, ends: AxisSettings, default: tuple[int, int], least: int, maze: Maze
) -> tuple[float, float]:
    """Ends in steps, clipped to `default[1]`, the largest distance in the maze."""
    error = f"{name} of {{:g}}; give a whole number of steps, at least {least}"
    first, last = ends_within(ends, default, (least, math.inf), error)
    longest = float(default[1])
    for value in (first, last):
        if value > longest:
            warnings.warn(
                f"{name} of {value:g} steps is more than the largest distance in maze {maze.name}; "
                f"it is clipped to {longest:g}, which is unlimited",
                stacklevel=2,
            )
    return min(first, longest), min(last, longest)


def longest_in(task: Task) -> int:
    """The longest of all shortest paths in the mazes of a task, in steps."""
    if len(task.mazes) == 1:
        return task.mazes[0].longest_distance
    tables = (table_of_distances(maze) for maze in task.mazes)
    return max(int(table[table != UNREACHABLE].max()) for table in tables)


AXIS_MAKERS: dict[str, Maker] = {
    "opponent-epsilon": Maker(opponent_epsilon, scripted=True, small_games=True),
    "slip": Maker(slip),
    "goal-spread-fixed": Maker(goal_spread_fixed, goals=True, random_starts=True),
    "goal-spread-start": Maker(goal_spread_start, goals=True, random_starts=True),
    "start-distance": Maker(start_distance, random_starts=True, both=True),
    "num-goals": Maker(num_goals, goals=True),
    "maze-size": Maker(maze_number, mazes=True),
    "loops": Maker(maze_number, mazes=True),
    "target-distance": Maker(target_distance, arm=True),
    "free-joints": Maker(free_joints, arm=True),
    "hold": Maker(hold, arm=True),
    "tolerance": Maker(tolerance, arm=True),
}
