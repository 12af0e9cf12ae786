"""What mazes are made of, a text or grids, if they are that and memory can hold the maze."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.declared import as_array
from pursuit.memory import check_memory

BYTES_PER_CELL, BYTES_PER_CHARACTER = 70, 26
"""The memory that it takes to make a maze, and to read its text: measured on 1000x1000 cells."""

MAX_STREAM = 2**26
"""Bytes read of what is no file, and so has no size."""


def text_in(path: Path) -> str:
    """The text in a file.

    Raises:
        ValueError: it is longer than memory holds, or is no file and does not end.
        OSError, UnicodeDecodeError: it cannot be read, or is no text.
    """
    with path.open("rb") as file:
        needed = BYTES_PER_CHARACTER * path.stat().st_size
        check_memory(str(path), needed, "give a smaller maze")
        found = file.read(-1 if path.is_file() else MAX_STREAM)
    if len(found) == MAX_STREAM and not path.is_file():
        raise ValueError(f"{path}: no end in its first {MAX_STREAM} bytes; give a maze file")
    return found.decode("utf-8-sig")


def grids_of(name: str, *grids: Any) -> tuple[NDArray[np.bool_], ...]:
    """The grids [rows, columns] of a maze of that name, as arrays of their own.

    Raises:
        ValueError: they are not of two dimensions, hold no bools, or need more than memory holds.
    """
    rule = "walkable, open_south and open_east are arrays [rows, columns] of bools"
    found = [as_array(f"{name}: grid", grid, "b", rule) for grid in grids]
    if any(grid.ndim != 2 for grid in found):
        raise ValueError(f"{name}: {rule}; these have shapes {[grid.shape for grid in found]}")
    height, width = found[0].shape
    needed = BYTES_PER_CELL * found[0].size
    check_memory(f"{name} of {height}x{width} cells", needed, "make it smaller")
    return tuple(np.array(grid, dtype=bool) for grid in found)
