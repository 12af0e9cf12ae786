"""Fixed suites of mazes for training, model selection, and tests on held-out mazes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from pursuit.mazes.maze import Maze, load_maze
from pursuit.mazes.suite_files import (
    drawing_of_row,
    is_suite,
    suite_rows,
)
from pursuit.mazes.suite_files import suite_names as suite_names


def load_suite(name: str) -> tuple[Maze, ...]:
    """The mazes of a suite, in order. The name of a maze is NAME/NUMBER, as in `"7x7-test/017"`.

    Args:
        name: `"7x7-train"`, `"7x7-validation"`, `"7x7-test"`, or another size of 5, 9 and 15;
            `"7x7-train/0-99"` is its first hundred mazes, which include all kinds. Of graphs:
            `"roads-5x5-train"`, and 7x7, all with six moves.

    Raises:
        ValueError: an unknown suite.
    """
    if not isinstance(name, str):
        raise ValueError(f"suite={name!r}; give the name of a suite: {', '.join(suite_names())}")
    return _suite(name)


@lru_cache(maxsize=64)
def _suite(name: str) -> tuple[Maze, ...]:
    return tuple(Maze.from_drawing(drawing_of_row(row), row.name) for row in suite_rows(name))


def load_mazes(given: str | Path | Maze | Sequence[str | Path | Maze]) -> tuple[Maze, ...]:
    """Load one or several mazes. Each is a name, a path, a `Maze`, or the name of a suite.

    Raises:
        ValueError: as `load_maze` and `load_suite`.
    """
    if isinstance(given, str) and is_suite(given):
        return load_suite(given)
    if isinstance(given, (str, Path, Maze)):
        return (load_maze(given),)
    if not isinstance(given, Iterable):
        raise ValueError(f"maze={given!r}; give the name of a maze, a path, a Maze, or a list")
    return tuple(maze for each in given for maze in load_mazes(each))


def least_copy(maze: Maze) -> bytes:
    """A key that is equal for rotated and mirrored copies of a maze, and only for those."""
    grid = np.zeros((2 * maze.height - 1, 2 * maze.width - 1), dtype=bool)
    grid[::2, ::2] = maze.cell_numbers >= 0
    grid[1::2, ::2], grid[::2, 1::2] = maze.open_south, maze.open_east
    turned = [np.rot90(side, turns) for side in (grid, grid.T) for turns in range(4)]
    return min(repr(each.shape).encode() + np.packbits(each).tobytes() for each in turned)
