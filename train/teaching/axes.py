"""Axes: what a curriculum turns, and how its numbers become settings of games.

`AXIS_MAKERS` says of each axis what the task must have, and makes it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.maze import Maze, table_of_distances
from pursuit.placements import check_placeable
from pursuit.policy import Policy
from pursuit.rules import UNREACHABLE
from pursuit.simulator import Simulator
from pursuit.task import Task
from train.settings.checks import check
from train.settings.curricula import AXIS_PARTS, AxisSettings
from train.teaching.arm_axes import ARM_AXIS_MAKERS, ArmMaker
from train.teaching.axis import Axis as Axis
from train.teaching.axis import ends_of
from train.teaching.mazes import training_mazes
from train.teaching.optimum import Optimum, optimum_of


@dataclass(frozen=True)
class Ground:
    """The game in a maze that axes are laid over.

    Attributes:
        task: the task itself, to which every axis leads.
        agent: who learns, by name or role.
        opponents: the policy of every other role.
        opponent_epsilon: share of random moves of the scripted opponents.
        learned_opponent: the name of an opponent that is not scripted; None where all are.
    """

    task: Task
    agent: str
    opponents: Mapping[str, Policy] = field(default_factory=dict)
    opponent_epsilon: float = 0.0
    learned_opponent: str | None = None

    @property
    def default_axis(self) -> str:
        """What `axis="auto"` means; ValueError where there is nothing to turn."""
        task = self.task
        if task.num_goals:
            return "goal-spread-start"
        check(
            task.num_chasers > 0 and task.num_evaders > 0,
            f"task {task.name!r} has neither goals nor chasers with evaders; name an axis",
        )
        return "start-distance"

    def check_levels(self, name: str) -> None:
        """ValueError where there are no starts to be replayed."""
        check(
            self.task.start == "random",
            f"curriculum={name!r} replays random starts; leave out start='marks'",
        )

    def optimum(self, task: Task) -> Optimum | None:
        """The exact optimum of every start of `task`, this one in other mazes; None if unknown."""
        return optimum_of(task, self.agent, self.opponents)


@dataclass(frozen=True)
class Maker:
    """How one axis is made, and what it needs.

    Attributes:
        make: (name, ground, ends) -> the axis; ValueError for ends that are not allowed.
        goals: whether the task must have goals.
        random_starts: whether starts must be random.
        both: whether there must be chasers and evaders.
        scripted: whether there must be opponents, all of them scripted.
        mazes: whether it has a list of mazes.
    """

    make: Callable[[str, Ground, AxisSettings], Axis]
    goals: bool = False
    random_starts: bool = False
    both: bool = False
    scripted: bool = False
    mazes: bool = False

    def check(self, name: str, ground: Any, ends: AxisSettings) -> None:
        """Raise ValueError for what the task has not."""
        task = ground.task
        check(
            isinstance(ground, Ground),
            f"curriculum {name!r} turns games in mazes, and task {task.name!r} is none; take "
            "target-distance, free-joints, hold or tolerance",
        )
        check(
            not self.goals or task.num_goals > 0,
            f"curriculum {name!r} moves goals, and task {task.name!r} has none; take "
            "opponent-epsilon or start-distance, or a task with goals",
        )
        check(
            not self.random_starts or task.start == "random",
            f"curriculum {name!r} needs random starts; leave out start='marks'",
        )
        check(
            ends.curriculum_mazes is None or self.mazes,
            f"curriculum_mazes={ends.curriculum_mazes!r} with curriculum {name!r}; only maze-size "
            "and loops have a list of mazes",
        )
        check(
            not self.scripted or task.num_agents > 1,
            f"curriculum {name!r} needs opponents, and task {task.name!r} has none; take "
            "goal-spread-start, or task chase",
        )
        check(
            not self.scripted or ground.learned_opponent is None,
            f"curriculum {name!r} turns scripted opponents, and opponent="
            f"{ground.learned_opponent!r} is a learned one; leave out one of the two",
        )
        check(
            not self.both or (task.num_chasers > 0 and task.num_evaders > 0),
            f"curriculum {name!r} needs chasers and evaders, and task {task.name!r} has not both; "
            "take goal-spread-start",
        )


def axis_of(name: str, ground: Any, ends: AxisSettings) -> Axis:
    """The axis of that name, or of "auto", over a task.

    Warns where an end lies beyond what the maze has, and is clipped.

    Raises:
        ValueError: the task has not what the axis turns, or ends that are not allowed.
    """
    name = ground.default_axis if name == "auto" else name
    maker = maker_of(name)
    maker.check(name, ground, ends)
    return maker.make(name, ground, ends)


def maker_of(name: str) -> Maker | ArmMaker:
    """What makes the axis of that name, one of ours or a user's; ValueError for an unknown one."""
    for makers in (AXIS_MAKERS, ARM_AXIS_MAKERS):
        if name in makers:
            return makers[name]
    maker: Maker | ArmMaker = AXIS_PARTS.get(name)
    return maker


# -- what turns -----------------------------------------------------------------------------------


def opponent_epsilon(name: str, ground: Ground, ends: AxisSettings) -> Axis:
    """Share of random moves of the opponents, from 1 down."""
    own = ground.task.seat(ground.agent)
    others = [seat for seat in range(ground.task.num_agents) if seat != own]
    first, last = ends_of(ends, 1.0, ground.opponent_epsilon)
    for value in (first, last):
        check(0.0 <= value <= 1.0, f"epsilon={value}; a share of random moves lies in [0, 1]")

    def apply(simulator: Simulator, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        for seat in others:
            simulator.configure(games, epsilon=values, seat=seat)

    return Axis(name, first, last, apply, whole=False)


def goal_spread_fixed(name: str, ground: Ground, ends: AxisSettings) -> Axis:
    """Steps from the goal marks of the maze to the goals."""
    maze = ground.task.mazes[0]
    check(
        bool(maze.goal_marks),
        f"curriculum {name!r} begins at the goal marks 'G' of the maze, and {maze.name} has none; "
        "mark some, or take goal-spread-start",
    )
    marks = [maze.distances_from(mark) for mark in maze.goal_marks]
    farthest = np.min(marks, axis=0).max()
    first, last = _radius(name, ends, (0, int(farthest)), 0, maze)

    def apply(simulator: Simulator, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        radius = _limit(values, farthest)
        simulator.configure(games, goal_radius=radius, goals_around="marks")

    return Axis(name, first, last, apply)


def goal_spread_start(name: str, ground: Ground, ends: AxisSettings) -> Axis:
    """Steps from the learner's start to the goals."""
    maze, longest = ground.task.mazes[0], longest_in(ground.task)
    first, last = _radius(name, ends, (min(3, longest), longest), 1, maze)

    def apply(simulator: Simulator, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        radius = _limit(values, longest)
        simulator.configure(games, goal_radius=radius, goals_around="start")

    return Axis(name, first, last, apply)


def start_distance(name: str, ground: Ground, ends: AxisSettings) -> Axis:
    """Steps between chasers and evaders at the start, at most."""
    maze, least = ground.task.mazes[0], ground.task.min_start_distance
    longest = longest_in(ground.task)
    near = min(max(3, least), longest)
    first, last = _radius(name, ends, (near, longest), least, maze)
    check_placeable(ground.task.apart(0, -1, least, int(min(first, last))))

    def apply(simulator: Simulator, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        simulator.configure(games, max_start_distance=_limit(values, longest))

    return Axis(name, first, last, apply)


def num_goals(name: str, ground: Ground, ends: AxisSettings) -> Axis:
    """How many goals there are."""
    goals = ground.task.num_goals
    check(goals > 1, f"curriculum {name!r} needs at least 2 goals; num_goals={goals}")
    first, last = ends_of(ends, 1, goals)
    for value in (first, last):
        check(
            1 <= value <= goals and value == int(value),
            f"{value:g} goals; a whole number from 1 to num_goals={goals}",
        )

    def apply(simulator: Simulator, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        simulator.configure(games, num_goals=values.astype(np.int64))

    return Axis(name, first, last, apply)


def maze_number(name: str, ground: Ground, ends: AxisSettings) -> Axis:
    """Which of several mazes is played in."""
    mazes = training_mazes(name, ends.curriculum_mazes, ground.task)
    first, last = ends_of(ends, 0, len(mazes) - 1)
    for value in (first, last):
        check(
            0 <= value < len(mazes) and value == int(value),
            f"maze {value:g}; whole numbers from 0 to {len(mazes) - 1}, which count "
            f"{', '.join(maze.name for maze in mazes)}",
        )

    def apply(simulator: Simulator, games: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        simulator.configure(games, maze=values.astype(np.int64))

    return Axis(name, first, last, apply, mazes=mazes)


def _radius(
    name: str, ends: AxisSettings, own: tuple[int, int], least: int, maze: Maze
) -> tuple[float, float]:
    """Ends in steps; `own` are those of the maze, which none may exceed."""
    values, longest = [], own[1]
    for value in ends_of(ends, *own):
        check(
            value >= least and value == int(value),
            f"{name} of {value:g}; a whole number of steps of at least {least}",
        )
        if value > longest:
            warnings.warn(
                f"{name} of {value:g} steps is more than maze {maze.name} has; clipped to "
                f"{longest}, which is everywhere",
                stacklevel=2,
            )
        values.append(min(value, float(longest)))
    return values[0], values[1]


def longest_in(task: Task) -> int:
    """The longest of all shortest paths in the mazes of a task, in steps."""
    if len(task.mazes) == 1:
        return task.mazes[0].longest_distance
    tables = (table_of_distances(maze) for maze in task.mazes)
    return max(int(table[table != UNREACHABLE].max()) for table in tables)


def _limit(values: NDArray[np.float64], anywhere: float) -> NDArray[np.int64]:
    """Whole numbers for the simulator, to which -1 is no limit: so are values from `anywhere`."""
    return np.where(values >= anywhere, -1, values).astype(np.int64)


AXIS_MAKERS: dict[str, Maker] = {
    "opponent-epsilon": Maker(opponent_epsilon, scripted=True),
    "goal-spread-fixed": Maker(goal_spread_fixed, goals=True, random_starts=True),
    "goal-spread-start": Maker(goal_spread_start, goals=True, random_starts=True),
    "start-distance": Maker(start_distance, random_starts=True, both=True),
    "num-goals": Maker(num_goals, goals=True),
    "maze-size": Maker(maze_number, mazes=True),
    "loops": Maker(maze_number, mazes=True),
}
