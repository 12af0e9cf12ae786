"""Maps of other projects as mazes: MovingAI's `.map` and `.scen`, and the grids of maze benchmarks.

In all of them a wall fills a whole square; it becomes a blocked cell, and two neighbouring floor
squares are joined.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

PASSABLE, IMPASSABLE = ".GS", "@OTW"
"""Terrain of MovingAI: ground and swamp; out of bounds, trees, and water, which cannot be entered
from land and so is taken as impassable."""

_HEADER = re.compile(r"type\s+(\S+)\s+height\s+(\d+)\s+width\s+(\d+)\s+map\s*")


def looks_like_map(path: Path) -> bool:
    """Whether a file is MovingAI's by its name."""
    return path.suffix.lower() == ".map"


def joined(
    walkable: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """`walkable`, `open_south`, `open_east`: no wall stands between squares of the floor."""
    return walkable, walkable[:-1] & walkable[1:], walkable[:, :-1] & walkable[:, 1:]


def grids_of_map(
    text: str, name: str
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """The grids of a map in MovingAI's format (Sturtevant, 2012): a header, then a row a line.

    Raises:
        ValueError: another header, rows of another number or length, or unknown terrain.
    """

    def fail(problem: str) -> NoReturn:
        raise ValueError(f"{name}: {problem}")

    header = _HEADER.match(text)
    if not header:
        fail(
            "no header; a MovingAI map begins with the lines 'type octile', 'height H', 'width W' "
            "and 'map'"
        )
    height, width = int(header.group(2)), int(header.group(3))
    rows = text[header.end() :].split()
    first = text[: header.end()].count("\n")
    if len(rows) != height:
        fail(f"{len(rows)} rows, and its header says height {height}")
    for number, row in enumerate(rows):
        unknown = set(row) - set(PASSABLE + IMPASSABLE)
        if unknown:
            fail(
                f"line {first + number + 1}: unknown terrain {min(unknown)!r}; passable is "
                f"{PASSABLE!r}, impassable {IMPASSABLE!r}"
            )
        if len(row) != width:
            fail(f"line {first + number + 1}: {len(row)} characters; its header says width {width}")
    if not height or not width:
        fail("a map without cells")
    return joined(np.isin(np.array([list(row) for row in rows]), list(PASSABLE)))


# -- grids of maze benchmarks ----------------------------------------------------------------------

AGENTS = "><^v"
"""An agent, by where it looks; our agents look nowhere."""


class DrawnGrid(NamedTuple):
    """What a grid of characters shows: the arguments of `Maze`, in their order."""

    walkable: NDArray[np.bool_]
    open_south: NDArray[np.bool_]
    open_east: NDArray[np.bool_]
    start: tuple[int, int] | None
    goals: tuple[tuple[int, int], ...]


def grid_of_text(text: str, name: str) -> DrawnGrid:
    """A grid in the manner of maze benchmarks (JaxUED, minimax): a character a square.

    `#` is a wall, `.` or a blank the floor, `G` a goal, and `>`, `<`, `^`, `v` (or `A`, `S`) the
    start of the agent.

    Raises:
        ValueError: rows of another length, another character, or a second agent.
    """
    rows = [line.rstrip("\r") for line in text.split("\n")]
    while rows and not rows[-1].strip():
        rows.pop()
    while rows and not rows[0].strip():
        rows.pop(0)
    if not rows:
        raise ValueError(f"{name}: an empty grid; draw '#' for walls and '.' for floor")
    if "." in text:  # then blanks around it are indentation
        rows = [row.strip() for row in rows]
    width = max(len(row) for row in rows)
    start: tuple[int, int] | None = None
    goals, walkable = [], np.zeros((len(rows), width), dtype=bool)
    for row, line in enumerate(rows):
        if len(line) != width:
            raise ValueError(
                f"{name}: line {row + 1}: {len(line)} characters where another has {width}; give "
                "every line the same number"
            )
        for column, character in enumerate(line):
            walkable[row, column] = character != "#"
            if character == "G":
                goals.append((row, column))
            elif character in f"{AGENTS}AS":
                if start is not None:
                    raise ValueError(f"{name}: line {row + 1}: a second agent; keep one")
                start = (row, column)
            elif character not in "#. ":
                raise ValueError(
                    f"{name}: line {row + 1}: unknown character {character!r}; a square is '#', "
                    f"'.', 'G', or one of {AGENTS!r} for the agent"
                )
    return DrawnGrid(*joined(walkable), start, tuple(goals))
