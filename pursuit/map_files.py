"""Maps of other projects as mazes: MovingAI's `.map` and `.scen`, and the grids of maze benchmarks.

In all of them a wall fills a whole square; it becomes a blocked cell, and two neighbouring floor
squares are joined.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

PASSABLE, IMPASSABLE = ".G", "@OTWS"
"""Terrain of MovingAI: ground; out of bounds, trees, water, and swamp, which is passable from swamp
only: it is taken as impassable, so no path is shorter than the map allows."""

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
