"""Graphs as mazes: reading networkx graphs, GraphML and edge lists, and the text format of graphs.

A cell is a node. Action i of a cell leads to its i-th neighbor (successor, if edges are directed);
in a cell with fewer neighbors than the graph has moves, the others keep the place, as at a wall.
An edge of length n takes n steps: it has n - 1 cells of its own, on which agents are seen, meet and
can turn round. Opposite directed edges of one length share them.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Hashable, Iterable, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import is_int, whole

if TYPE_CHECKING:
    import networkx

MAX_MOVES = 31
"""Sets of moves, and stay, are bit masks of 32 bits."""
HEADER = "graph"
"""The first word of the text format."""
SUFFIXES = (".graphml", ".edgelist", ".edges")
MAX_GRAPH_CELLS = 200_000
"""Limit of the cells of a graph with those within edges; a wrong unit of lengths can need many."""
MAX_LAYOUT_NODES = 500
"""Larger graphs without positions are drawn on a circle, as other layouts take long."""

_LINE = re.compile(r'(\d+) ("(?:[^"\\]|\\.)*") (\S+) (\S+)((?: [SG])?): ([\d ]*)')


class GraphDrawing(NamedTuple):
    """The content of a graph.

    Attributes:
        names: the name of each cell.
        positions: [cells, 2] float64, x to the right and y upwards; for pictures only.
        neighbors: [cells, moves + 1] int32, as `Maze.neighbors`.
        start: the marked start cell, or None.
        goals: the marked goal cells.
    """

    names: tuple[str, ...]
    positions: NDArray[np.float64]
    neighbors: NDArray[np.int32]
    start: int | None = None
    goals: tuple[int, ...] = ()


def read_graph(
    graph: Any,
    name: str,
    positions: Mapping[Any, Any] | None = None,
    length: str | None = "length",
    num_moves: int | None = None,
    start: Hashable | None = None,
    goals: Iterable[Hashable] = (),
) -> GraphDrawing:
    """A networkx graph as cells; arguments and errors as of `Maze.from_graph`."""
    if not all(hasattr(graph, needed) for needed in ("nodes", "edges", "is_directed")):
        raise ValueError(f"{name}: {graph!r}; give a networkx graph, such as networkx.Graph")
    if isinstance(goals, str) or not isinstance(goals, Iterable):
        raise ValueError(f"{name}: goals={goals!r}; give a list of nodes")
    nodes = list(graph.nodes)
    names = [str(node) for node in nodes]
    if not nodes:
        raise ValueError(f"{name}: a graph without nodes; give at least one")
    _check_names(names, name)
    number = {node: index for index, node in enumerate(nodes)}
    streets = list(_streets(graph, name, length))
    cells = len(nodes) + sum(steps - 1 for _, _, steps, _ in streets)
    check_cells(cells, name)
    places = list(_positions_of(graph, nodes, name, positions))
    rank = {node: {there: i for i, there in enumerate(graph.adj[node])} for node in nodes}
    # (action or -1, place among the neighbors, neighbor)
    moves: list[list[tuple[int, int, int]]] = [[] for _ in range(cells)]
    for a, b, steps, actions in streets:
        path = [number[a]]
        for between in range(1, steps):
            names.append(f"{a}-{b}:{between}" if steps > 2 else f"{a}-{b}")
            share = between / steps
            places.append((1 - share) * places[number[a]] + share * places[number[b]])
            path.append(len(names) - 1)
        path.append(number[b])
        ends = (path, rank[a].get(b, 0)), (path[::-1], rank[b].get(a, 0))
        for (way, order), action in zip(ends, actions, strict=False):
            for here, there in pairwise(way):
                first = here == way[0]
                moves[here].append((action if first else -1, order if first else 0, there))
    _check_names(names, name)  # a node may have the name of a cell within an edge
    most = _most_moves(moves, names, name, num_moves)
    neighbors = np.repeat(np.arange(len(names), dtype=np.int32)[:, None], most + 1, axis=1)
    for cell, found in enumerate(moves):
        given = [action for action, _, _ in found if action >= 0]
        if len(set(given)) < len(given):
            raise ValueError(f"{name}: two edges from {names[cell]!r} have one action; change one")
        _assign(neighbors[cell], cell, found)
    _check_connected(neighbors, names, name)
    marks = [_marked(mark, number, name) for mark in goals]
    return GraphDrawing(
        tuple(names),
        np.asarray(np.round(places, 4), dtype=np.float64),
        neighbors,
        None if start is None else _marked(start, number, name),
        tuple(marks),
    )


def check_cells(cells: int, name: str) -> None:
    """ValueError for more cells than are possible."""
    if cells > MAX_GRAPH_CELLS:
        raise ValueError(
            f"{name}: {cells:,} cells, with those within edges; at most {MAX_GRAPH_CELLS:,} are "
            "possible. Take a smaller graph, or divide the lengths"
        )


def _check_names(names: list[str], name: str) -> None:
    """ValueError if two cells have one name."""
    if len(set(names)) < len(names):
        twice = next(each for each in names if names.count(each) > 1)
        raise ValueError(f"{name}: two nodes are named {twice!r} as text; rename one of them")


def _streets(
    graph: Any, name: str, length: str | None
) -> Iterable[tuple[Hashable, Hashable, int, tuple[int, ...]]]:
    """Each edge once: its ends, its steps, and its actions at the first end (-1 for any) and, if it
    can be used both ways, at the second. Opposite edges of one length are one."""
    shortest: dict[tuple[Any, Any], tuple[int, int]] = {}
    for a, b, data in graph.edges(data=True):
        if a == b:
            raise ValueError(
                f"{name}: an edge from {a!r} to itself; remove it, and give the task "
                "stay_action=True to let agents stay"
            )
        steps = data.get(length, 1) if length is not None else 1
        whole_float = isinstance(steps, float | np.floating) and steps.is_integer()
        if not (is_int(steps) or whole_float) or steps < 1:
            raise ValueError(
                f"{name}: the edge {a!r}, {b!r} has {length}={steps!r}; a length is a whole number "
                "of steps, at least 1: round it, or use Maze.from_graph(graph, length=None) for "
                "edges of one step"
            )
        action = data.get("action")
        if action is not None and not (is_int(action) and 0 <= action < MAX_MOVES):
            raise ValueError(
                f"{name}: the edge {a!r}, {b!r} has action={action!r}; an action is a number from "
                f"0 to {MAX_MOVES - 1}"
            )
        pair = (a, b) if graph.is_directed() or (b, a) not in shortest else (b, a)
        if pair not in shortest or steps < shortest[pair][0]:
            shortest[pair] = int(steps), -1 if action is None else int(action)
    done = set()
    for (a, b), (steps, action) in shortest.items():
        back = shortest.get((b, a)) if graph.is_directed() else (steps, -1)
        if back is None or back[0] != steps:
            yield a, b, steps, (action,)
        elif (a, b) not in done:
            done.add((b, a))
            yield a, b, steps, (action, back[1])


def _most_moves(
    moves: list[list[tuple[int, int, int]]], names: list[str], name: str, num_moves: int | None
) -> int:
    """The number of moves: the largest degree, unless more are wanted."""
    degrees = [len(found) for found in moves]
    needed = max(max(degrees), 1 + max((a for found in moves for a, _, _ in found), default=-1), 1)
    if needed > MAX_MOVES:
        node = names[int(np.argmax(degrees))]
        raise ValueError(
            f"{name}: the node {node!r} has {needed} neighbors; at most {MAX_MOVES} are possible"
        )
    if num_moves is None:
        return needed
    if whole("num_moves", num_moves, 1, MAX_MOVES) < needed:
        raise ValueError(f"{name}: num_moves={num_moves}; a node has {needed} neighbors")
    return num_moves


def _assign(row: NDArray[np.int32], cell: int, found: list[tuple[int, int, int]]) -> None:
    """Write the neighbors of a cell: those with an action there, the others in order."""
    for action, _, there in found:
        if action >= 0:
            row[action] = there
    free = [action for action in range(len(row) - 1) if row[action] == cell]
    others = sorted((each for each in found if each[0] < 0), key=lambda each: each[1])
    for (_, _, there), action in zip(others, free, strict=False):
        row[action] = there


def _check_connected(neighbors: NDArray[np.int32], names: list[str], name: str) -> None:
    """ValueError unless every cell can be reached from every other."""
    forth: list[list[int]] = neighbors.tolist()
    back: list[list[int]] = [[] for _ in forth]
    for cell, row in enumerate(forth):
        for there in row:
            back[there].append(cell)
    for links in (forth, back):
        reached, waiting = {0}, [0]
        while waiting:
            new = [cell for cell in links[waiting.pop()] if cell not in reached]
            reached.update(new)
            waiting += new
        if len(reached) < len(names):
            there = next(cell for cell in range(len(names)) if cell not in reached)
            a, b = (0, there) if links is forth else (there, 0)
            raise ValueError(
                f"{name}: there is no path from {names[a]!r} to {names[b]!r}; connect them, or "
                "take one part (networkx.strongly_connected_components, connected_components)"
            )


def _marked(mark: Hashable, number: Mapping[Any, int], name: str) -> int:
    if mark not in number:
        raise ValueError(f"{name}: the mark {mark!r} is no node; give one of the graph")
    return number[mark]


def _positions_of(
    graph: Any, nodes: list[Any], name: str, positions: Mapping[Any, Any] | None
) -> NDArray[np.float64]:
    """[nodes, 2] float64: as given, of the attributes `pos` or `x` and `y`, or of a layout."""
    data = graph.nodes
    if positions is not None:
        missing = [node for node in nodes if node not in positions]
        if missing:
            raise ValueError(f"{name}: positions has no entry for the node {missing[0]!r}")
        found = [positions[node] for node in nodes]
    elif all("pos" in data[node] for node in nodes):
        found = [data[node]["pos"] for node in nodes]
    elif all("x" in data[node] and "y" in data[node] for node in nodes):
        found = [(data[node]["x"], data[node]["y"]) for node in nodes]
    else:
        import networkx  # slow to import

        links: networkx.Graph[Any] = networkx.Graph()
        links.add_nodes_from(nodes)
        links.add_edges_from((a, b) for a, b, *_ in graph.edges)
        few = len(nodes) <= MAX_LAYOUT_NODES
        placed = networkx.spring_layout(links, seed=0) if few else networkx.circular_layout(links)
        found = [placed[node] for node in nodes]
    try:
        array = np.array(found, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (len(nodes), 2) or not np.isfinite(array).all():
        raise ValueError(f"{name}: positions are pairs of finite numbers (x, y), one for each node")
    return array


def to_networkx(maze: Any) -> networkx.DiGraph[str]:
    """See `Maze.to_graph`; the maze has the attributes of `Maze`, which imports this file."""
    import networkx  # slow to import

    graph: networkx.DiGraph[str] = networkx.DiGraph(name=maze.name)
    for name, (x, y) in zip(maze.cell_names, maze.positions.tolist(), strict=True):
        graph.add_node(name, x=x, y=y)
    for cell, action in np.argwhere(maze.neighbors != np.arange(maze.num_cells)[:, None]).tolist():
        there = maze.cell_names[maze.neighbors[cell, action]]
        graph.add_edge(maze.cell_names[cell], there, action=action)
    return graph


# -- text ------------------------------------------------------------------------------------------


def text_of(maze: Any) -> str:
    """A graph in the text format: a line for each cell with its number, name, position, mark, and
    the cell after each move."""
    lines = [f"{HEADER} of {maze.num_cells} cells and {maze.num_moves} moves"]
    for cell, name in enumerate(maze.cell_names):
        x, y = maze.positions[cell].tolist()
        mark = " S" if cell == maze.start_mark else " G" if cell in maze.goal_marks else ""
        moves = " ".join(map(str, maze.neighbors[cell, :-1].tolist()))
        lines.append(f"{cell} {json.dumps(name)} {x:g} {y:g}{mark}: {moves}")
    return "\n".join(lines) + "\n"


def is_graph_text(text: Any) -> bool:
    """Whether this is the text of a graph."""
    return isinstance(text, str) and text.lstrip().startswith(f"{HEADER} of ")


def read_graph_text(text: str, name: str) -> GraphDrawing:
    """Read the text format of graphs.

    Raises:
        ValueError: invalid text; the message names the line and the remedy.
    """
    lines = text.strip().splitlines()[1:]
    if not lines:
        raise ValueError(f"{name}: a graph without cells; give a line for each")
    names, places, rows, start, goals = [], [], [], None, []
    for cell, line in enumerate(lines):
        found = _LINE.fullmatch(line.strip())
        if not found or int(found[1]) != cell:
            _fail(name, cell, f'{line!r}; line {cell + 2} is: {cell} "name" x y: neighbors')
        try:
            places.append((float(found[3]), float(found[4])))
            names.append(json.loads(found[2]))
        except ValueError:
            _fail(name, cell, f"{line!r}; a name is in quotes, x and y are numbers")
        row = [int(word) for word in found[6].split()]
        if any(there >= len(lines) for there in row) or len(row) > MAX_MOVES:
            _fail(name, cell, f"neighbors {row}; at most {MAX_MOVES}, each below {len(lines)}")
        rows.append([*row, cell])
        start = cell if found[5] == " S" else start
        goals += [cell] if found[5] == " G" else []
    widths = [len(row) for row in rows]
    if len(set(widths)) > 1:
        _fail(name, widths.index(min(widths)), "all cells need the same number of moves")
    neighbors = np.array(rows, dtype=np.int32)
    _check_names(names, name)
    _check_connected(neighbors, names, name)
    return GraphDrawing(tuple(names), np.array(places), neighbors, start, tuple(goals))


def _fail(name: str, cell: int, problem: str) -> NoReturn:
    raise ValueError(f"{name}: line {cell + 2}: {problem}")


def read_graph_file(text: str, suffix: str, name: str) -> GraphDrawing:
    """Read GraphML, or an edge list as networkx writes them, without directions.

    Raises:
        ValueError: invalid text, or a graph that `Maze.from_graph` refuses.
    """
    import networkx  # slow to import

    if suffix != ".graphml":
        return read_graph(_edges_of(text, name), name)
    try:
        graph = networkx.parse_graphml(text)
    except Exception as error:  # its reader raises many kinds
        raise ValueError(f"{name}: not a valid {suffix} file ({error})") from None
    return read_graph(graph, name)


def _edges_of(text: str, name: str) -> Any:
    """The edges of lines `node node`, `node node length` or `node node {'length': 2}`."""
    import networkx  # slow to import

    graph: Any = networkx.MultiGraph()
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].split(maxsplit=2)
        if not words:
            continue
        try:
            data = ast.literal_eval(words[2]) if len(words) == 3 else {}
        except (ValueError, SyntaxError):
            data = None
        if isinstance(data, int | float):
            data = {"length": data}
        if len(words) == 1 or not isinstance(data, dict):
            raise ValueError(
                f"{name}: line {number}: {line!r}; a line of an edge list is `node node`, or "
                "`node node length` with a number of steps. The names of nodes have no blanks"
            )
        graph.add_edge(*words[:2], **{str(key): value for key, value in data.items()})
    return graph
