"""The frozen suites as files: which there are, their rows, and the sums that they are held against.

A suite is a table `pursuit/mazes/files/suites/SIZE-SPLIT.csv`, a maze a row: its number, how it was
generated, and the hexadecimal digits of its open walls (first those south of the cells, row by row,
then those east of the cells; the first wall is the highest bit). `SHA256SUMS` beside them is what
`sha256sum` writes, so `sha256sum --check SHA256SUMS` in that folder checks them, too.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SUITES = Path(__file__).parent / "files" / "suites"
SUMS = "SHA256SUMS"
SIZES = (5, 7, 9, 15)
SPLITS = {"train": 1000, "validation": 100, "test": 200}
"""Mazes of each split: to learn in, to choose by, and to report on."""

PREFIX = "suite:"
_PART = re.compile(r"(?:suite:)?([^/]+)(?:/(\d+)(?:-(\d+))?)?")


class Row(NamedTuple):
    """A maze of a suite.

    Attributes:
        name: `"7x7-test/017"`.
        generator, loops, no_dead_ends, seed: as `generate_maze` takes them.
        openings: hexadecimal digits.
    """

    name: str
    generator: str
    loops: float
    no_dead_ends: bool
    seed: int
    openings: str

    @property
    def kind(self) -> str:
        """The generator and how it was told to make loops, in words."""
        if self.no_dead_ends:
            return f"{self.generator}, no dead ends"
        return f"{self.generator}, loops {self.loops:g}"


def suite_names() -> list[str]:
    """The names of the suites, smallest mazes first: `"5x5-train"`, ..., `"15x15-test"`."""
    return [f"{size}x{size}-{split}" for size in SIZES for split in SPLITS]


def maze_name(suite: str, number: int) -> str:
    """The name of a maze of a suite."""
    return f"{suite}/{number:03}"


def is_suite(maze: object) -> bool:
    """Whether this is written as the name of a suite, or of a part of one."""
    return isinstance(maze, str) and maze.startswith(PREFIX)


def rows_of(given: str) -> tuple[Row, ...]:
    """The rows of a suite (`"7x7-test"`), of one of its mazes (`"7x7-test/017"`) or of some of them
    (`"7x7-train/0-99"`), with `suite:` before it or without.

    Raises:
        ValueError: no such suite or mazes.
    """
    found = _PART.fullmatch(given)
    suite = found.group(1) if found else given
    if not found or suite not in suite_names():
        raise ValueError(
            f"unknown suite {given!r}; suites: {', '.join(suite_names())}; one maze of it is "
            "NAME/017, some are NAME/0-99"
        )
    rows = read_rows(suite)
    if found.group(2) is None:
        return rows
    first = int(found.group(2))
    last = first if found.group(3) is None else int(found.group(3))
    if not first <= last < len(rows):
        raise ValueError(
            f"{given!r}: the mazes of suite {suite} are 0 to {len(rows) - 1}; some of them are "
            "FIRST-LAST, counting upwards"
        )
    return rows[first : last + 1]


@cache
def read_rows(suite: str) -> tuple[Row, ...]:
    """All rows of a suite."""
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


def grids_of_row(
    row: Row,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """`walkable`, `open_south` and `open_east`, as `Maze` takes them."""
    height, width = (int(side) for side in row.name.split("-")[0].split("x"))
    num_south = (height - 1) * width
    digits = np.frombuffer(bytes.fromhex(row.openings), dtype=np.uint8)
    bits = np.unpackbits(digits, count=num_south + height * (width - 1)).astype(bool)
    return (
        np.ones((height, width), dtype=bool),
        bits[:num_south].reshape(height - 1, width),
        bits[num_south:].reshape(height, width - 1),
    )


# -- sums ------------------------------------------------------------------------------------------


def sums_text(files: dict[str, bytes]) -> str:
    """The content of SHA256SUMS for files by name."""
    return "".join(f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files))
