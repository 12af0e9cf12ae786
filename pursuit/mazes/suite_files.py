"""The files of the maze suites: names, rows and checksums.

A suite is a table `pursuit/mazes/files/suites/SIZE-SPLIT.csv` with one row per maze: its number,
the arguments of its generator, and its open walls in hexadecimal (first the walls south of the
cells, row by row, then the walls east of the cells; the first wall is the highest bit). The file
`SHA256SUMS` has the format of `sha256sum`; `sha256sum --check SHA256SUMS` verifies the tables.
"""

from __future__ import annotations

import csv
import io
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pursuit.mazes.formats import Drawing
from pursuit.mazes.graph_generation import graph_drawing
from pursuit.mazes.graphs import GraphDrawing
from pursuit.validation import unknown

SUITES = Path(__file__).parent / "files" / "suites"
SUMS = "SHA256SUMS"
SIZES = (5, 7, 9, 15)
GRAPH_SIZES = (5, 7)
"""Of the suites of graphs, `roads-5x5-train` and so on: generated from their seeds when loaded."""
ROADS, ROAD_MOVES = "roads", 6
SPLITS = {"train": 1000, "validation": 100, "test": 200}
"""Number of mazes of each split: for training, model selection, and reported results."""
FIRST_SEEDS = {"train": 0, "validation": 10**6, "test": 2 * 10**6}
"""First seed of each split. Seeds that give a maze of an earlier split or row are skipped."""

PREFIX = "suite:"
_PART = re.compile(r"(?:suite:)?([^/]+)(?:/(\d+)(?:-(\d+))?)?")


class Row(NamedTuple):
    """One maze of a suite.

    Attributes:
        name: for example `"7x7-test/017"`.
        generator, loops, no_dead_ends, seed: arguments of `generate_maze`.
        openings: the open walls in hexadecimal; empty for a graph.
    """

    name: str
    generator: str
    loops: float
    no_dead_ends: bool
    seed: int
    openings: str

    @property
    def kind(self) -> str:
        """The generator and its loop setting, for tables."""
        if self.generator == ROADS:
            return ROADS
        if self.no_dead_ends:
            return f"{self.generator}, no dead ends"
        return f"{self.generator}, loops {self.loops:g}"


def suite_names() -> list[str]:
    """The names of the suites, smallest mazes first: `"5x5-train"`, ..., `"15x15-test"`; then those
    of graphs, `"roads-5x5-train"`, ..."""
    mazes = [f"{size}x{size}-{split}" for size in SIZES for split in SPLITS]
    return mazes + [f"{ROADS}-{size}x{size}-{split}" for size in GRAPH_SIZES for split in SPLITS]


def maze_name(suite: str, number: int) -> str:
    """The name of a maze of a suite."""
    return f"{suite}/{number:03}"


def is_suite(maze: object) -> bool:
    """Whether this names a suite or a part of one: a string that starts with `suite:`."""
    return isinstance(maze, str) and maze.startswith(PREFIX)


def suite_rows(given: str) -> tuple[Row, ...]:
    """The rows of a suite (`"7x7-test"`), of one maze (`"7x7-test/017"`) or of a range of mazes
    (`"7x7-train/0-99"`). The prefix `suite:` is optional.

    Raises:
        ValueError: an unknown suite, or maze numbers out of range.
    """
    found = _PART.fullmatch(given)
    suite = found.group(1) if found else given
    if not found or suite not in suite_names():
        raise ValueError(
            unknown("suite", given, suite_names(), "suites:")
            + "; one maze is NAME/017, a range is NAME/0-99"
        )
    rows = read_rows(suite)
    if found.group(2) is None:
        return rows
    first = int(found.group(2))
    last = first if found.group(3) is None else int(found.group(3))
    if not first <= last < len(rows):
        raise ValueError(
            f"{given!r}: the mazes of suite {suite} are 0 to {len(rows) - 1}; a range is "
            "FIRST-LAST with FIRST <= LAST"
        )
    return rows[first : last + 1]


@cache
def read_rows(suite: str) -> tuple[Row, ...]:
    """All rows of a suite."""
    if suite.startswith(ROADS):
        split = suite.rpartition("-")[2]
        return tuple(
            Row(maze_name(suite, number), ROADS, 0.0, False, FIRST_SEEDS[split] + number, "")
            for number in range(SPLITS[split])
        )
    return tuple(
        Row(
            maze_name(suite, int(row["number"])),
            row["generator"],
            float(row["loops"]),
            row["no_dead_ends"] == "yes",
            int(row["seed"]),
            row["openings"],
        )
        for row in csv.DictReader(io.StringIO((SUITES / f"{suite}.csv").read_text()))
    )


def drawing_of_row(row: Row) -> Drawing | GraphDrawing:
    """The content of a maze or graph of a suite."""
    height, width = (int(side) for side in row.name.split("-")[-2].split("x"))
    if row.generator == ROADS:
        return graph_drawing(ROADS, height, width, row.seed, row.name, num_moves=ROAD_MOVES)
    num_south = (height - 1) * width
    digits = np.frombuffer(bytes.fromhex(row.openings), dtype=np.uint8)
    bits = np.unpackbits(digits, count=num_south + height * (width - 1)).astype(bool)
    return Drawing(
        np.ones((height, width), dtype=bool),
        bits[:num_south].reshape(height - 1, width),
        bits[num_south:].reshape(height, width - 1),
    )
