"""Where mazes come from by name: the shipped library, the frozen suites, and files."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.map_files import grids_of_map, looks_like_map
from pursuit.maze_sizes import text_in
from pursuit.suite_files import grids_of_row, is_suite, rows_of

LIBRARY = Path(__file__).with_name("mazes")


class Written(NamedTuple):
    """The text of a maze, and what it is called."""

    text: str
    name: str


class Drawn(NamedTuple):
    """The grids of a maze, its marks and its name, as `Maze` takes them."""

    walkable: NDArray[np.bool_]
    open_south: NDArray[np.bool_]
    open_east: NDArray[np.bool_]
    start: tuple[int, int] | None
    goals: tuple[tuple[int, int], ...]
    name: str


def library_names() -> list[str]:
    """The names of the shipped mazes, smallest first."""
    names = [path.stem for path in LIBRARY.glob("*.txt")]
    return sorted(names, key=lambda name: (int(name.split("x")[0]), name))


def source_of(maze: str | Path) -> Written | Drawn:
    """The maze of a name or path, not yet made.

    Raises:
        ValueError: as `load_maze`.
    """
    if isinstance(maze, str) and is_suite(maze):
        rows = rows_of(maze)
        if len(rows) > 1:
            raise ValueError(
                f"maze {maze!r} is {len(rows)} mazes, and one is needed here; one of them is "
                f"suite:{rows[0].name}"
            )
        return Drawn(*grids_of_row(rows[0]), None, (), rows[0].name)
    names = library_names()
    path = LIBRARY / f"{maze}.txt" if isinstance(maze, str) and maze in names else Path(maze)
    if "\n" in str(maze):
        raise ValueError("this is the text of a maze, not a name or path; use Maze.from_text")
    text = read_text(path)
    if looks_like_map(path):
        return Drawn(*grids_of_map(text, str(path)), None, (), str(path))
    return Written(text, path.stem if path.parent == LIBRARY else str(path))


def read_text(path: Path) -> str:
    """The text of a file that may be a maze.

    Raises:
        ValueError: there is none, or it is no text.
    """
    try:
        return text_in(path)
    except FileNotFoundError:
        raise ValueError(
            f"unknown maze {str(path)!r}; shipped mazes: {', '.join(library_names())}; or give a "
            "path to a maze file"
        ) from None
    except IsADirectoryError:
        raise ValueError(f"{path}: a directory; give a maze file inside it") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: line {path.read_bytes()[: error.start].count(10) + 1}: not a text file "
            "(UTF-8); a maze is drawn with '+', '-', '|', blanks, 'S', 'G' and '#'"
        ) from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
