"""The task that settings name, and who learns in it."""

from __future__ import annotations

from dataclasses import fields

from pursuit.maze import Maze, load_maze
from pursuit.task import Task, make_task
from train.settings.checks import check
from train.settings.task import TaskSettings


def task_of(settings: TaskSettings) -> Task:
    """The task that these settings name, its maze opened.

    Raises:
        ValueError: no such maze, or settings that make no game.
    """
    given = {
        field.name: getattr(settings, field.name)
        for field in fields(settings)
        if field.name.startswith("num_") and getattr(settings, field.name) is not None
    }
    if settings.rewards != "default":
        given["rewards"] = settings.rewards
    return make_task(
        settings.task,
        maze=maze_of(settings.maze),
        max_steps=settings.max_steps,
        stay_action=settings.stay_action,
        move_order=settings.move_order,
        min_start_distance=settings.min_start_distance,
        start=settings.start,
        **given,
    )


def maze_of(maze: str) -> Maze:
    """The maze of settings: the text of one, a name, or a path; ValueError for none."""
    return Maze.from_text(maze) if "\n" in maze else load_maze(maze)


def agent_of(settings: TaskSettings, task: Task) -> str:
    """Who learns; ValueError where that agent does not play in the task."""
    known = {*task.agent_names, *task.seat_roles}
    check(
        settings.agent in known,
        f"role {settings.agent!r} does not play in task {settings.task!r}; one of "
        f"{', '.join(sorted(known))}",
    )
    return settings.agent
