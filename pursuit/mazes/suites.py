"""Fixed suites of mazes for training, model selection, and tests on held-out mazes.

`python -m pursuit.mazes.suites` generates the files of `pursuit/mazes/files/suites/` again from
their seeds; `git diff` shows changes.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import count, product
from pathlib import Path
from typing import Any

import numpy as np

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze, load_maze
from pursuit.mazes.suite_files import (
    FIRST_SEEDS,
    SIZES,
    SPLITS,
    SUITES,
    SUMS,
    drawing_of_row,
    is_suite,
    rows_of,
    sums_text,
)
from pursuit.mazes.suite_files import suite_names as suite_names

KINDS = tuple(
    product(
        ("prim", "backtracker", "wilson"), ((0.0, False), (0.1, False), (0.3, False), (0.0, True))
    )
)
"""Maze number i of a suite is of kind i modulo 12: (generator, (loops, no_dead_ends))."""


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
    return tuple(Maze.from_drawing(drawing_of_row(row), row.name) for row in rows_of(name))


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


# -- generation ------------------------------------------------------------------------------------


def least_copy(maze: Maze) -> bytes:
    """A key that is equal for rotated and mirrored copies of a maze, and only for those."""
    grid = np.zeros((2 * maze.height - 1, 2 * maze.width - 1), dtype=bool)
    grid[::2, ::2] = maze.cell_numbers >= 0
    grid[1::2, ::2], grid[::2, 1::2] = maze.open_south, maze.open_east
    turned = [np.rot90(side, turns) for side in (grid, grid.T) for turns in range(4)]
    return min(repr(each.shape).encode() + np.packbits(each).tobytes() for each in turned)


def suite_rows(size: int) -> Iterator[tuple[str, list[list[Any]]]]:
    """Generate (split, rows) of the suites of one size, without duplicates or symmetric copies."""
    taken: set[bytes] = set()
    for split, number in SPLITS.items():
        seeds = count(FIRST_SEEDS[split])
        rows: list[list[Any]] = []
        while len(rows) < number:
            generator, (loops, braided) = KINDS[len(rows) % len(KINDS)]
            seed = next(seeds)
            maze = generate_maze(generator, size, loops=loops, no_dead_ends=braided, seed=seed)
            copy = least_copy(maze)
            if copy not in taken:
                taken.add(copy)
                openings = np.concatenate([maze.open_south.ravel(), maze.open_east.ravel()])
                digits = np.packbits(openings).tobytes().hex()
                no_dead_ends = "yes" if braided else "no"
                rows.append([len(rows), generator, loops, no_dead_ends, seed, digits])
        yield split, rows


def suite_tables() -> dict[str, bytes]:
    """Generate the files of the suites, by name."""
    tables = {}
    for size in SIZES:
        for split, rows in suite_rows(size):
            text = io.StringIO()
            writer = csv.writer(text, lineterminator="\n")
            writer.writerow(["number", "generator", "loops", "no_dead_ends", "seed", "openings"])
            writer.writerows(rows)
            tables[f"{size}x{size}-{split}.csv"] = text.getvalue().encode()
    return tables


if __name__ == "__main__":
    _made = suite_tables()
    for _name, _content in {**_made, SUMS: sums_text(_made).encode()}.items():
        (SUITES / _name).write_bytes(_content)
