"""Readers for the text formats of mazes: Pursuit's format and MovingAI's `.map`.

Each reader returns a `Drawing`, the arguments of `Maze`. In a `.map` a wall fills a whole square,
which becomes a blocked cell; neighbouring passable squares are connected.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

PASSABLE, IMPASSABLE = ".GS", "@OTW"
"""Terrain of MovingAI: ground and swamp; out of bounds, trees and water. Water cannot be entered
from land, so it counts as impassable."""

_SIZES = r"(height|width)\s+(\d{1,9})\s+(?!\1)(height|width)\s+(\d{1,9})"
_HEADER = re.compile(rf"type\s+\S+\s+{_SIZES}\s+map\s*")


class Drawing(NamedTuple):
    """The content of a maze file: the arguments of `Maze`, in their order."""

    walkable: NDArray[np.bool_]
    open_south: NDArray[np.bool_]
    open_east: NDArray[np.bool_]
    start: tuple[int, int] | None = None
    goals: tuple[tuple[int, int], ...] = ()
    exits: tuple[tuple[int, int], ...] = ()


def fail_at_line(name: str, line: int, problem: str) -> NoReturn:
    """ValueError for a line of a file, from 1."""
    raise ValueError(f"{name}: line {line}: {problem}")


def _lines_of(text: str) -> tuple[list[str], int]:
    """The lines without leading and trailing blank lines, and the number of the first, from 1."""
    lines = text.splitlines()
    filled = [number for number, line in enumerate(lines) if line.strip()]
    return (lines[filled[0] : filled[-1] + 1], filled[0] + 1) if filled else ([], 1)


def _grid_of(lines: Sequence[str]) -> NDArray[np.str_]:
    """[rows, columns] the characters of lines of equal length."""
    return np.array([list(line) for line in lines])


# -- Pursuit's format ------------------------------------------------------------------------------


def read_walls(text: str, name: str) -> Drawing:
    """Read a maze in Pursuit's format; see `Maze.from_text`.

    Raises:
        ValueError: invalid text; the message names the line and the remedy.
    """
    if not isinstance(text, str):
        raise ValueError(f"{name}: {text!r} is not a string; give the text of a maze")
    lines, first = _lines_of(text)
    lines = [line.rstrip(" ") for line in lines]
    _check_rectangular(lines, first, name)
    length = max(len(line) for line in lines)
    grid = _grid_of([line.ljust(length) for line in lines])
    cells, blank = grid[1::2, 1::2], grid == " "
    start = None
    for row, column in np.argwhere(_are_odd(grid)).tolist():
        character, where = str(grid[row, column]), f"character {column + 1}"
        is_cell = row % 2 == 1 and column % 2 == 1
        if not character.isprintable():
            problem = f"unknown character {character!r}; a maze is plain text"
        elif not is_cell:
            problem = f"the mark {character!r} is between cells; put it in a cell"
        elif character == "S" and start is not None:
            problem = "a second start mark 'S'; keep one"
        elif character == "S":
            start = (row // 2, column // 2)
            continue
        else:
            problem = f"unknown character {character!r}; a cell is ' ', 'S', 'G', 'E' or '#'"
        fail_at_line(name, row + first, f"{where}: {problem}")
    south, east = blank[2:-1:2, 1::2], blank[1::2, 2:-1:2]
    goals, exits = (
        tuple((row, column) for row, column in np.argwhere(cells == mark).tolist())
        for mark in ("G", "E")
    )
    return Drawing(cells != "#", south, east, start, goals, exits)


def _are_odd(grid: NDArray[np.str_]) -> NDArray[np.bool_]:
    """[rows, columns] True for start marks and invalid characters."""
    unprintable = [each for each in {*grid.ravel().tolist()} if not each.isprintable()]
    odd = np.isin(grid, ["S", "G", "E", *unprintable])
    odd[1::2, 1::2] = ~np.isin(grid[1::2, 1::2], [" ", "#", "G", "E"])
    return odd


def _check_rectangular(lines: Sequence[str], first: int, name: str) -> None:
    """Raise ValueError unless there are 2H+1 lines of 2W+1 characters, without trailing blanks."""
    if not lines:
        raise ValueError(
            f"{name}: the file is empty; a maze of one cell is '+-+', '| |', '+-+' on three lines"
        )
    length = max(len(line) for line in lines)
    # A line that ends with a wall character in a wall column is complete and too short. Other
    # short lines have lost trailing blanks in an editor.
    short = [
        number
        for number, line in enumerate(lines)
        if len(line) < length and len(line) % 2 == 1 and line[-1] in "+|-"
    ]
    if length % 2 == 0 or length < 3 or 2 * len(short) > len(lines):
        widest = next(number for number, line in enumerate(lines) if len(line) == length)
        fail_at_line(
            name,
            widest + first,
            f"{length} characters: the maze is not rectangular; give every line the same odd "
            "number, 2W+1 for W cells",
        )
    if short:
        fail_at_line(
            name,
            short[0] + first,
            f"{len(lines[short[0]])} characters where another line has {length}: the maze is not "
            "rectangular; give every line the same length",
        )
    if len(lines) % 2 == 0 or len(lines) < 3:
        fail_at_line(
            name,
            len(lines) - 1 + first,
            f"the maze ends after {len(lines)} lines; H cells need an odd number, 2H+1: is the "
            "lower border missing?",
        )


# -- MovingAI's format -----------------------------------------------------------------------------


def read_movingai(text: str, name: str) -> Drawing:
    """Read a map in MovingAI's format (Sturtevant, 2012): a header, then one line per row.

    Raises:
        ValueError: an invalid header, a wrong number or length of rows, or unknown terrain.
    """
    header = _HEADER.match(text)
    if not header:
        raise ValueError(
            f"{name}: no header; a MovingAI map begins with the lines 'type octile', 'height H', "
            "'width W' and 'map'"
        )
    sizes = {header[1]: int(header[2]), header[3]: int(header[4])}
    height, width = sizes["height"], sizes["width"]
    rows = text[header.end() :].split()
    if len(rows) != height:
        raise ValueError(f"{name}: {len(rows)} rows, but the header says height {height}")
    for line, row in enumerate(rows, text[: header.end()].count("\n") + 1):
        unknown = set(row) - set(PASSABLE + IMPASSABLE)
        if unknown:
            fail_at_line(
                name,
                line,
                f"unknown terrain {min(unknown)!r}; passable is {PASSABLE!r}, impassable "
                f"{IMPASSABLE!r}",
            )
        if len(row) != width:
            fail_at_line(name, line, f"{len(row)} characters, but the header says width {width}")
    if not height or not width:
        raise ValueError(f"{name}: the map has no cells; give a height and width of 1 or more")
    walkable = np.isin(_grid_of(rows), list(PASSABLE))
    south, east = walkable[:-1] & walkable[1:], walkable[:, :-1] & walkable[:, 1:]
    return Drawing(walkable, south, east)
