"""Loading mazes by name: included mazes, suites, and files."""

from __future__ import annotations

import re
from io import StringIO
from pathlib import Path

from pursuit.mazes.formats import Drawing, read_movingai, read_walls
from pursuit.mazes.graph_files import (
    GRAPHML,
    SUFFIXES,
    edges_of,
    is_graph_text,
    read_graph_text,
    read_graphml,
)
from pursuit.mazes.graphs import GraphDrawing, read_graph
from pursuit.mazes.suite_files import drawing_of_row, is_suite, suite_rows
from pursuit.memory import check_memory
from pursuit.validation import unknown

LIBRARY = Path(__file__).with_name("files")
MOVINGAI = ".map"
OTHER_GRAPHS = (".gml", ".adjlist", ".gexf", ".pickle", ".gpickle", ".net")
BYTES_PER_CHARACTER = 26
"""Memory per character to read the text of a maze, measured with 1000x1000 cells."""


def library_names() -> list[str]:
    """The names of the included mazes, smallest first."""
    names = [path.stem for path in LIBRARY.glob("*.txt")]
    return sorted(names, key=lambda name: (not name[0].isdigit(), first_number(name), name))


def first_number(name: str) -> int:
    """The first number in a name, 0 if there is none."""
    found = re.search(r"\d+", name)
    return int(found[0]) if found else 0


def drawing_of(maze: str | Path) -> tuple[Drawing | GraphDrawing, str]:
    """The content of a maze by name or path, and the name of the maze.

    Raises:
        ValueError: as `load_maze`.
    """
    if isinstance(maze, str) and is_suite(maze):
        rows = suite_rows(maze)
        if len(rows) > 1:
            raise ValueError(
                f"maze {maze!r} is {len(rows)} mazes, but one is needed; give one of them, such "
                f"as suite:{rows[0].name}"
            )
        return drawing_of_row(rows[0]), rows[0].name
    names = library_names()
    path = LIBRARY / f"{maze}.txt" if isinstance(maze, str) and maze in names else Path(maze)
    if "\n" in str(maze):
        raise ValueError("this is the text of a maze, not a name or path; use Maze.from_text")
    if path.suffix.lower() in OTHER_GRAPHS and path.is_file():
        raise ValueError(
            f"{path}: graphs are read from {', '.join(SUFFIXES)}; convert it with "
            "networkx.write_graphml"
        )
    name = path.stem if path.parent == LIBRARY else str(path)
    suffix = path.suffix.lower()
    content = read_bytes(path)
    if suffix == GRAPHML:
        return read_graphml(content, name), name
    text = decoded(content, path)
    if suffix in SUFFIXES:
        return read_graph(edges_of(text, name), name), name
    if is_graph_text(text):
        return read_graph_text(text, name), name
    return (read_movingai if suffix == MOVINGAI else read_walls)(text, name), name


def reads_as_text(path: Path) -> bool:
    """Whether `load_maze(str(path))` reads the file as Pursuit's own text format."""
    other = path.suffix.lower() in (*SUFFIXES, *OTHER_GRAPHS, MOVINGAI)
    return not (other or is_suite(str(path)) or str(path) in library_names() or "\n" in str(path))


def read_bytes(path: Path) -> bytes:
    """The content of a maze file.

    Raises:
        ValueError: the file does not exist, or is too large for the memory.
    """
    try:
        if not path.exists():
            if path.suffix or path.name != str(path):
                raise ValueError(f"{path}: no such file; give the path to a maze file")
            raise ValueError(
                unknown("maze", str(path), library_names(), "shipped mazes:")
                + "; or give a path to a maze file"
            )
        if not path.is_file():
            raise ValueError(f"{path}: a directory or device; give a maze file")
        needed = BYTES_PER_CHARACTER * path.stat().st_size
        check_memory(str(path), needed, "give a smaller maze")
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None


def decoded(content: bytes, path: Path) -> str:
    """The content of a maze file as text, with lines that end with a newline; ValueError if it is
    not UTF-8."""
    try:
        return StringIO(content.decode("utf-8-sig"), None).read()
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: line {content[: error.start].count(10) + 1}: not a text file (UTF-8); give "
            "the text of a maze or of a graph"
        ) from None
