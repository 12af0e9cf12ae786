"""Cells and moves of the games on a grid, their pictures, and one-hot vectors."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Place = TypeVar("Place")
Transitions: TypeAlias = list[tuple[float, Place, tuple[float, float], bool]]
"""Probability, next state, rewards, and whether the game has ended, of each outcome."""
Cell: TypeAlias = tuple[int, int]
"""Row, from the north, and column, from the west; from 0."""

MOVES = {"north": (-1, 0), "south": (1, 0), "east": (0, 1), "west": (0, -1), "stand": (0, 0)}
"""By name, the change of the row and of the column."""
DIAGONALS = {
    "north-east": (-1, 1),
    "south-east": (1, 1),
    "south-west": (1, -1),
    "north-west": (-1, -1),
}


def moved(cell: Cell, change: tuple[int, int]) -> Cell:
    """The cell that a move leads to, on the grid or not."""
    return cell[0] + change[0], cell[1] + change[1]


def cells_of(rows: int, columns: int) -> list[Cell]:
    """All cells of a grid, row by row."""
    return [(row, column) for row in range(rows) for column in range(columns)]


def picture(
    rows: int, columns: int, marks: Mapping[Cell, str], sides: Mapping[int, tuple[str, str]]
) -> str:
    """The grid as text with a frame.

    Args:
        rows: of the grid.
        columns: of the grid.
        marks: what stands in a cell; "." in all others.
        sides: by row, what replaces the frame at its west and east end.
    """
    width = max(map(len, marks.values()), default=1)
    frame = "+" + "-" * (columns * (width + 1) + 1) + "+"
    lines = [frame]
    for row in range(rows):
        west, east = sides.get(row, ("|", "|"))
        cells = (marks.get((row, column), ".").ljust(width) for column in range(columns))
        lines.append(f"{west} {' '.join(cells)} {east}".rstrip())
    return "\n".join([*lines, frame])


def one_hot(present: Hashable, known: Sequence[Hashable]) -> NDArray[np.float32]:
    """[known] float32: 1 at the place of `present`, if it is there, else 0."""
    return np.array([value == present for value in known], dtype=np.float32)
