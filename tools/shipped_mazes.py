"""Generate the mazes and suites that Pursuit contains again, from their seeds.

    PYTHONPATH=. python tools/shipped_mazes.py

It writes the files of `pursuit/mazes/files/`; `git diff` shows changes.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator
from itertools import count, product
from typing import Any

import numpy as np

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.graph_generation import graph_drawing
from pursuit.mazes.maze import LIBRARY, Maze
from pursuit.mazes.suite_files import FIRST_SEEDS, SIZES, SPLITS, SUITES, SUMS
from pursuit.mazes.suites import least_copy

# Size -> seeds of the maze without dead ends and of the tree. They were selected among the first
# thousand for long shortest paths from S to G, and for few open squares and loops (first seed).
LIBRARY_SEEDS = {
    2: (0, 0),
    3: (0, 506),
    4: (0, 313),
    5: (88, 557),
    6: (150, 622),
    7: (513, 739),
    8: (144, 575),
    9: (635, 676),
    15: (83, 928),
}


KINDS = tuple(
    product(
        ("prim", "backtracker", "wilson"), ((0.0, False), (0.1, False), (0.3, False), (0.0, True))
    )
)
"""Maze number i of a suite is of kind i modulo 12: (generator, (loops, no_dead_ends))."""


def library_mazes() -> dict[str, Maze]:
    """Generate the included mazes and graphs, by name.

    S and G mark opposite corners. `"5x5"` has no dead ends, `"5x5-tree"` no loops, `"5x5-open"` no
    inner walls.
    """
    mazes = {}
    for size, (seed, tree_seed) in LIBRARY_SEEDS.items():
        name = f"{size}x{size}"
        mazes[name] = generate_maze("prim", size, loops=0.05, no_dead_ends=True, seed=seed)
        mazes[f"{name}-tree"] = generate_maze("prim", size, seed=tree_seed)
        mazes[f"{name}-open"] = generate_maze("open", size)
    found = {name: with_corner_marks(maze, name) for name, maze in mazes.items()}
    name = "roads-8x8"
    marks = {"start": "0,0", "goals": ["7,7"]}
    found[name] = Maze.from_drawing(graph_drawing("roads", 8, 8, 0, name, **marks), name)
    found["pursuit_v5"] = with_corner_marks(pursuit_v5_map(), "pursuit_v5")
    return found


def pursuit_v5_map() -> Maze:
    """The default map of PettingZoo's `pursuit_v5`: 16x16 cells with an obstacle."""
    row, column = np.mgrid[:16, :16] / 16
    walkable = ~((column > 0.3) & (column < 0.7) & (row > 0.2) & (row < 0.8))
    return Maze(walkable, np.ones((15, 16), dtype=bool), np.ones((16, 15), dtype=bool))


def with_corner_marks(maze: Maze, name: str) -> Maze:
    """The same maze with S in the first cell and G in the last."""
    corner = (maze.height - 1, maze.width - 1)
    walkable = maze.cell_numbers >= 0
    return Maze(walkable, maze.open_south, maze.open_east, (0, 0), (corner,), name)


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


def sums_text(files: dict[str, bytes]) -> str:
    """The content of SHA256SUMS for files by name."""
    return "".join(f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files))


if __name__ == "__main__":
    for _name, _maze in library_mazes().items():
        (LIBRARY / f"{_name}.txt").write_text(_maze.to_text())
    _made = suite_tables()
    for _name, _content in {**_made, SUMS: sums_text(_made).encode()}.items():
        (SUITES / _name).write_bytes(_content)
