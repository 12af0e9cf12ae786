"""Axes: what a curriculum turns, and how its numbers become settings of games."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pursuit.maze import Maze, load_maze
from pursuit.simulator import Simulator
from pursuit.task import Task
from train.settings.algorithms import check
from train.settings.curricula import AXES, AxisSettings
from train.settings.run import TaskSettings

OPENED = 8
"""Mazes of the axis `loops`, from no inner wall to all of them."""


@dataclass(frozen=True)
class Axis:
    """One quantity from easy to hard.

    Attributes:
        name: one of AXES.
        easiest, hardest: the ends.
        whole: whether only whole numbers make sense.
        anywhere: values from here on are no limit at all (radii and distances).
        mazes: of the training games, where these are what changes; the last is the task's.
        seats: of the opponents, where their epsilon is what changes.
    """

    name: str
    easiest: float
    hardest: float
    whole: bool = True
    anywhere: float = np.inf
    mazes: tuple[Maze, ...] = ()
    seats: tuple[int, ...] = ()

    def stages(self, count: int) -> list[float]:
        """At most `count` values from easy to hard, evenly spaced, all different."""
        values = np.linspace(self.easiest, self.hardest, count)
        return list(dict.fromkeys((np.round(values) if self.whole else values).tolist()))

    def apply(
        self, simulator: Simulator, games: NDArray[np.intp], values: NDArray[np.float64]
    ) -> None:
        """Have the next episode of each of `games` played with its value."""
        if self.name == "opponent-epsilon":
            for seat in self.seats:
                simulator.configure(games, epsilon=values, seat=seat)
            return
        numbers = np.where(values >= self.anywhere, -1, values).astype(np.int64)
        if self.name == "goal-spread-fixed":
            simulator.configure(games, goal_radius=numbers, goals_around="marks")
        elif self.name == "goal-spread-start":
            simulator.configure(games, goal_radius=numbers, goals_around="start")
        elif self.name == "start-distance":
            simulator.configure(games, max_start_distance=numbers)
        elif self.name == "num-goals":
            simulator.configure(games, num_goals=numbers)
        else:
            simulator.configure(games, maze=numbers)


def default_axis(task: Task) -> str:
    """What `axis="auto"` means; ValueError where there is nothing to turn."""
    if task.num_goals:
        return "goal-spread-start"
    check(
        task.num_chasers > 0 and task.num_evaders > 0,
        f"task {task.name!r} has neither goals nor chasers with evaders; name an axis",
    )
    return "start-distance"


def axis_of(name: str, settings: TaskSettings, ends: AxisSettings) -> Axis:
    """The axis of that name for a task.

    Warns where an end lies beyond what the maze has, and is clipped.

    Raises:
        ValueError: the task has not what the axis turns, or ends that are not allowed.
    """
    task = settings.build()
    name = default_axis(task) if name == "auto" else name
    check(name in AXES, f"unknown axis {name!r}; one of {', '.join(AXES)}")
    maze = task.mazes[0]
    if name in ("goal-spread-fixed", "goal-spread-start", "num-goals"):
        check(
            task.num_goals > 0,
            f"curriculum {name!r} moves goals, and task {task.name!r} has none; take "
            "opponent-epsilon or start-distance, or a task with goals",
        )
    if name in ("goal-spread-fixed", "goal-spread-start", "start-distance"):
        check(
            task.start == "random",
            f"curriculum {name!r} needs random starts; leave out start='marks'",
        )
    check(
        ends.curriculum_mazes is None or name in ("maze-size", "loops"),
        f"curriculum_mazes={ends.curriculum_mazes!r} with curriculum {name!r}; only maze-size and "
        "loops have a list of mazes",
    )
    if name == "opponent-epsilon":
        own = task.seat(settings.agent)
        seats = tuple(seat for seat in range(task.num_agents) if seat != own)
        check(
            bool(seats),
            f"curriculum 'opponent-epsilon' needs opponents, and task {task.name!r} has none; "
            "take goal-spread-start, or task chase",
        )
        check(
            settings.opponent is None,
            f"curriculum 'opponent-epsilon' turns scripted opponents, and opponent="
            f"{settings.opponent!r} is a learned one; leave out one of the two",
        )
        ends_ = _ends(ends, 1.0, settings.opponent_epsilon)
        for value in ends_:
            check(0.0 <= value <= 1.0, f"epsilon={value}; a share of random moves lies in [0, 1]")
        return Axis(name, *ends_, whole=False, seats=seats)
    if name == "goal-spread-fixed":
        check(
            bool(maze.goal_marks),
            f"curriculum 'goal-spread-fixed' begins at the goal marks 'G' of the maze, and "
            f"{maze.name} has none; mark some, or take goal-spread-start",
        )
        farthest = max(int(maze.distances_from(mark).max()) for mark in maze.goal_marks)
        if len(maze.goal_marks) > 1:
            marks = [maze.distances_from(mark) for mark in maze.goal_marks]
            farthest = int(np.min(marks, axis=0).max())
        return _radius(name, ends, 0, farthest, 0, maze)
    if name == "goal-spread-start":
        return _radius(name, ends, min(3, maze.longest_distance), maze.longest_distance, 1, maze)
    if name == "start-distance":
        check(
            task.num_chasers > 0 and task.num_evaders > 0,
            f"curriculum 'start-distance' needs chasers and evaders, and task {task.name!r} has "
            "not both; take goal-spread-start",
        )
        least = task.min_start_distance
        near = min(max(3, least), maze.longest_distance)
        return _radius(name, ends, near, maze.longest_distance, least, maze)
    if name == "num-goals":
        check(
            task.num_goals > 1,
            f"curriculum 'num-goals' needs at least 2 goals; num_goals={task.num_goals}",
        )
        few, many = _ends(ends, 1, task.num_goals)
        for value in (few, many):
            check(
                1 <= value <= task.num_goals and value == int(value),
                f"{value:g} goals; a whole number from 1 to num_goals={task.num_goals}",
            )
        return Axis(name, few, many)
    mazes = training_mazes(name, ends.curriculum_mazes, task)
    first, last = _ends(ends, 0, len(mazes) - 1)
    for value in (first, last):
        check(
            0 <= value < len(mazes) and value == int(value),
            f"maze {value:g}; whole numbers from 0 to {len(mazes) - 1}, which count "
            f"{', '.join(maze.name for maze in mazes)}",
        )
    return Axis(name, first, last, mazes=mazes)


def _ends(ends: AxisSettings, easiest: float, hardest: float) -> tuple[float, float]:
    given = (ends.easiest, ends.hardest)
    first, last = (
        default if end is None else float(end)
        for end, default in zip(given, (easiest, hardest), strict=True)
    )
    for value in (first, last):
        check(bool(np.isfinite(value)), f"{value} as the easiest or hardest; a finite number")
    return first, last


def _radius(
    name: str, ends: AxisSettings, easiest: int, longest: int, least: int, maze: Maze
) -> Axis:
    values = []
    for value in _ends(ends, easiest, longest):
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
    return Axis(name, values[0], values[1], anywhere=longest)


def training_mazes(name: str, given: str | None, task: Task) -> tuple[Maze, ...]:
    """The mazes of the axes `maze-size` and `loops`, from easy to hard; the task's is the last.

    Where none are given: for `maze-size` the first rows of the maze, more and more of them, whose
    cells keep their numbers, so that what is learned in one holds in the next; for `loops` the maze
    with all, then fewer and fewer of its inner walls opened.

    Raises:
        ValueError: no such maze, one that is too small or larger than the task's, or no part of
            the task's maze to begin with.
    """
    final, needed = task.mazes[0], task.num_agents + task.num_goals
    if given is not None:
        names = [name.strip() for name in given.split(",") if name.strip()]
        check(bool(names), f"curriculum_mazes={given!r}; give names or files, with commas")
        mazes = [maze for maze in map(load_maze, names) if maze != final]
        for maze in mazes:
            check(
                maze.height <= final.height
                and maze.width <= final.width
                and maze.num_cells <= final.num_cells,
                f"curriculum_mazes: {maze.name} is larger than the task's maze {final.name}; the "
                "task's maze is the last and largest",
            )
            check(
                needed <= maze.num_cells,
                f"curriculum_mazes: {maze.name} has {maze.num_cells} cells, and the agents and "
                f"goals need {needed}; leave it out",
            )
    elif name == "maze-size":
        mazes = [band for k in range(1, final.height) if (band := first_rows(final, k, needed))]
    else:
        mazes = [opened(final, 1.0 - k / (OPENED - 1)) for k in range(OPENED - 1)]
        mazes = list(dict.fromkeys(maze for maze in mazes if maze != final))
    check(
        bool(mazes),
        f"curriculum {name!r} finds no easier maze within {final.name}; give curriculum_mazes",
    )
    return (*mazes, final)


def first_rows(maze: Maze, rows: int, needed: int) -> Maze | None:
    """The first rows of `maze`; None where they are not connected or hold too few cells."""
    walkable = maze.cell_numbers[:rows] >= 0
    if walkable.sum() < max(needed, 2):
        return None
    part = Maze(
        walkable,
        maze.joined_south[: rows - 1],
        maze.joined_east[:rows],
        name=f"{maze.name}, {rows} rows",
    )
    return part if part.is_connected else None


def opened(maze: Maze, share: float) -> Maze:
    """`maze` with this share of its inner walls opened: always the same ones first."""
    south, east = maze.joined_south.copy(), maze.joined_east.copy()
    walkable = maze.cell_numbers >= 0
    walls_south = np.argwhere(~south & walkable[:-1] & walkable[1:])
    walls_east = np.argwhere(~east & walkable[:, :-1] & walkable[:, 1:])
    walls = [(south, tuple(w)) for w in walls_south] + [(east, tuple(w)) for w in walls_east]
    order = np.random.default_rng(0).permutation(len(walls))
    for number in order[: round(share * len(walls))]:
        table, place = walls[number]
        table[place] = True
    marks = {
        "start": None if maze.start_mark is None else _place(maze, maze.start_mark),
        "goals": tuple(_place(maze, mark) for mark in maze.goal_marks),
    }
    return Maze(walkable, south, east, **marks, name=f"{maze.name}, {100 * share:.0f} % open")  # type: ignore[arg-type]


def _place(maze: Maze, cell: int) -> tuple[int, int]:
    return int(maze.rows[cell]), int(maze.columns[cell])
