"""Where mazes come from by name: the shipped library, the frozen suites, and files."""

from __future__ import annotations

from pathlib import Path

from pursuit.mazes.formats import Drawing, read_movingai, read_walls
from pursuit.mazes.suite_files import grids_of_row, is_suite, rows_of
from pursuit.memory import check_memory

LIBRARY = Path(__file__).with_name("files")


BYTES_PER_CHARACTER = 26
"""The memory that it takes to read the text of a maze: measured on 1000x1000 cells."""
MAX_STREAM = 2**26
"""Bytes read of what is no file, and so has no size."""


def library_names() -> list[str]:
    """The names of the shipped mazes, smallest first."""
    names = [path.stem for path in LIBRARY.glob("*.txt")]
    return sorted(names, key=lambda name: (int(name.split("x")[0]), name))


def drawing_of(maze: str | Path) -> tuple[Drawing, str]:
    """What `Maze` takes of the maze of a name or path, and what it is called.

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
        return Drawing(*grids_of_row(rows[0])), rows[0].name
    names = library_names()
    path = LIBRARY / f"{maze}.txt" if isinstance(maze, str) and maze in names else Path(maze)
    if "\n" in str(maze):
        raise ValueError("this is the text of a maze, not a name or path; use Maze.from_text")
    text = read_text(path)
    name = path.stem if path.parent == LIBRARY else str(path)
    is_map = path.suffix.lower() == ".map"
    return (read_movingai if is_map else read_walls)(text, name), name


def read_text(path: Path) -> str:
    """The text of a file that may be a maze.

    Raises:
        ValueError: there is none, or it is no text.
    """
    try:
        return _content_of(path)
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


def _content_of(path: Path) -> str:
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
