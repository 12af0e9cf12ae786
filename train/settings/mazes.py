"""Mazes in settings: by name, file, or text."""

from __future__ import annotations

from pursuit.mazes.maze import Maze, library_names, load_maze
from pursuit.mazes.suite_files import PREFIX, is_suite
from pursuit.tasks.task import Task
from pursuit.validation import check

TITLE = "maze "
"""Begins the line with the name before the text of a maze in settings."""


def names_in(given: str) -> list[str]:
    """The names, files or texts of mazes in `curriculum_mazes`; ValueError if there are none."""
    names = [name.strip() for name in given.split(",") if name.strip()]
    check(bool(names), f"curriculum_mazes={given!r}; give names or files, separated by commas")
    return names


def named_maze(name: str) -> Maze:
    """A maze from a name, a file, or its text, with or without the title of `titled`."""
    if "\n" not in name:
        return load_maze(name)
    if not name.startswith(TITLE):
        return Maze.from_text(name, "given as text")
    title, _, text = name.removeprefix(TITLE).partition("\n")
    return Maze.from_text(text, title)


def maze_or_suite(name: str) -> Maze | str:
    """As `named_maze`; the name of a suite as it is."""
    return name if is_suite(name) else named_maze(name)


def titled(name: str, text: str) -> str:
    """The text of a maze after a line with its name, for settings."""
    return f"{TITLE}{name}\n{text}"


def as_text(name: str) -> str:
    """The name, for a maze or suite of the library; the titled text of any other maze."""
    if name in library_names() or is_suite(name):
        return name
    maze = named_maze(name)
    return titled(maze.name, maze.to_text())


def check_one_maze(task: Task, what: str) -> None:
    """ValueError if a task has several mazes; `what` is the subject of the message."""
    name = task.mazes[0].name
    check(
        len(task.mazes) == 1,
        f"{what} needs one maze, but the task has {len(task.mazes)}; use one of them, such as "
        f"{PREFIX if '/' in name else ''}{name}",
    )
