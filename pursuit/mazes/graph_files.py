"""The text format of graphs, and reading GraphML and edge lists."""

from __future__ import annotations

import ast
import json
import re
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from pursuit.mazes.formats import fail_at_line
from pursuit.mazes.graphs import (
    MAX_MOVES,
    GraphDrawing,
    check_cell_names,
    check_connected,
    read_graph,
)
from pursuit.validation import shortened

if TYPE_CHECKING:
    import networkx

HEADER = "graph"
"""The first word of the text format."""
GRAPHML = ".graphml"
SUFFIXES = (GRAPHML, ".edgelist", ".edges")

_HEAD = re.compile(rf"{HEADER} of (\d{{1,9}}) cells and (\d{{1,9}}) moves")
_LINE = re.compile(r'(\d+) ("(?:[^"\\]|\\.)*") (\S+) (\S+)((?: [SG])?): ([\d ]*)')


def graph_text(maze: Any) -> str:
    """A graph in the text format: a line for each cell with its number, name, position, mark, and
    the cell after each move."""
    lines = [f"{HEADER} of {maze.num_cells} cells and {maze.num_moves} moves"]
    for cell, name in enumerate(maze.cell_names):
        mark = " S" if cell == maze.start_mark else " G" if cell in maze.goal_marks else ""
        moves = " ".join(map(str, maze.neighbors[cell, :-1].tolist()))
        x, y = (repr(side).removesuffix(".0") for side in maze.positions[cell].tolist())
        lines.append(f"{cell} {json.dumps(name)} {x} {y}{mark}: {moves}")
    return "\n".join(lines) + "\n"


def is_graph_text(text: object) -> bool:
    """Whether this is the text of a graph."""
    return isinstance(text, str) and text.lstrip().startswith(f"{HEADER} of ")


def read_graph_text(text: str, name: str) -> GraphDrawing:
    """Read the text format of graphs.

    Raises:
        ValueError: invalid text; the message names the line and the remedy.
    """
    head, *lines = text.strip().splitlines()
    if not lines:
        raise ValueError(f"{name}: a graph without cells; give a line for each")
    counts = _HEAD.fullmatch(head.strip())
    if not counts:
        raise ValueError(
            f"{name}: line 1: {shortened(head)}; it is: {HEADER} of {len(lines)} cells and M moves"
        )
    cells, most = int(counts[1]), int(counts[2])
    if cells != len(lines):
        raise ValueError(f"{name}: line 1 says {cells} cells, but {len(lines)} lines follow")
    if not 1 <= most <= MAX_MOVES:
        raise ValueError(f"{name}: line 1: {most} moves; 1 to {MAX_MOVES} are possible")
    names, places, rows, starts, goals = [], [], [], [], []
    for cell, line in enumerate(lines):
        fail = partial(fail_at_line, name, cell + 2)
        found = _LINE.fullmatch(line.strip())
        if not found or found[1] != str(cell):
            fail(f'{shortened(line)}; line {cell + 2} is: {cell} "name" x y: neighbors')
        try:
            places.append((float(found[3]), float(found[4])))
            names.append(json.loads(found[2]))
            row = [int(word) for word in found[6].split()]
        except ValueError:
            fail(f"{shortened(line)}; a name is in quotes, x and y are numbers")
        if not np.isfinite(places[-1]).all():
            fail(f"the position {found[3]} {found[4]}; x and y are finite numbers")
        if len(row) != most or any(there >= cells for there in row):
            fail(f"neighbors {shortened(row)}; give {most}, each below {cells}")
        rows.append([*row, cell])
        starts += [cell] if found[5] == " S" else []
        goals += [cell] if found[5] == " G" else []
        if len(starts) > 1:
            fail(f"a second start mark S, after that of line {starts[0] + 2}; keep one")
    neighbors = np.array(rows, dtype=np.int32)
    check_cell_names(names, name)
    check_connected(neighbors, names, name)
    start = starts[0] if starts else None
    return GraphDrawing(tuple(names), np.array(places), neighbors, start, tuple(goals))


def read_graphml(content: bytes, name: str) -> GraphDrawing:
    """Read GraphML in the encoding that it declares.

    Raises:
        ValueError: invalid content, or a graph that `Maze.from_graph` refuses.
    """
    import networkx  # slow to import

    try:
        graph = networkx.read_graphml(BytesIO(content))
    except Exception as error:  # its reader raises many kinds
        raise ValueError(f"{name}: not a valid {GRAPHML} file ({error})") from None
    return read_graph(graph, name)


def edges_of(text: str, name: str) -> networkx.Graph:
    """The edges of lines `node node`, `node node length` or `node node {'length': 2}`."""
    import networkx  # slow to import

    graph = networkx.MultiGraph()
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].split(maxsplit=2)
        if not words:
            continue
        try:
            data = ast.literal_eval(words[2]) if len(words) == 3 else {}
        except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
            data = None  # what is too long or too deep is a MemoryError
        if isinstance(data, int | float):
            data = {"length": data}
        if len(words) == 1 or not isinstance(data, dict):
            raise ValueError(
                f"{name}: line {number}: {shortened(line)}; a line of an edge list is `node "
                "node`, or `node node length` with a number of steps. The names of nodes have no "
                "blanks"
            )
        graph.add_edge(*words[:2], **{str(key): value for key, value in data.items()})
    return graph
