"""The frozen suites as files: which there are, their rows, and the sums that they are held against.

A suite is a table `pursuit/mazes/files/suites/SIZE-SPLIT.csv`, a maze a row: its number, how it was
generated, and the hexadecimal digits of its open walls (first those south of the cells, row by row,
then those east of the cells; the first wall is the highest bit). `SHA256SUMS` beside them is what
`sha256sum` writes, so `sha256sum --check SHA256SUMS` in that folder checks them, too.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import re
import sys
from collections.abc import Iterable
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
        ValueError: no such suite or mazes, or a file that is not as it was shipped.
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
    """All rows of a suite; ValueError for a file that is not as it was shipped."""
    return tuple(
        Row(
            maze_name(suite, int(row["number"])),
            row["generator"],
            float(row["loops"]),
            row["no_dead_ends"] == "yes",
            int(row["seed"]),
            row["openings"],
        )
        for row in csv.DictReader(io.StringIO(read_checked(f"{suite}.csv")))
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


def read_checked(name: str) -> str:
    """The text of a file of the suites.

    Raises:
        ValueError: it cannot be read, or is not the one that was shipped.
    """
    remedy = "install Pursuit anew, or `git checkout pursuit/mazes/files/suites`"
    try:
        content, sums = (SUITES / name).read_bytes(), (SUITES / SUMS).read_text()
    except OSError as error:
        raise ValueError(f"{SUITES / name}: cannot be read ({error.strerror}); {remedy}") from None
    wanted = dict(line.split()[::-1] for line in sums.splitlines())
    if hashlib.sha256(content).hexdigest() != wanted.get(name):
        raise ValueError(
            f"{SUITES / name}: its checksum is not that in {SUMS}: it is not the frozen suite; "
            f"{remedy}"
        )
    return content.decode()


# -- made anew -------------------------------------------------------------------------------------


def renew(folder: Path, made: dict[str, bytes], shipped: Iterable[Path], check: bool) -> int:
    """Write the files that were made into a folder, in place of those that were shipped.

    Args:
        folder: is made where there is none.
        made: contents by name.
        shipped: the files that these replace: one that is not made any more is deleted.
        check: compare only, and name what differs.

    Returns:
        The exit status: 1 if `check` found a difference.
    """
    before = {path.name: path.read_bytes() for path in shipped if path.is_file()}
    different = sorted(name for name in made | before if made.get(name) != before.get(name))
    if check:
        for name in different:
            print(f"{folder / name}: differs from what is made now", file=sys.stderr)
        return 1 if different else 0
    folder.mkdir(exist_ok=True)
    for name in different:
        if name in made:
            (folder / name).write_bytes(made[name])
        else:
            (folder / name).unlink()
    print(f"{len(made)} files in {folder}, {len(different)} changed")
    return 0


def check_option(prog: str, description: str) -> argparse.ArgumentParser:
    """A parser with the option --check, for the modules that make shipped files."""
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit 1 on a difference"
    )
    return parser
