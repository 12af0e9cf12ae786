"""Graphs as mazes: reading networkx graphs.

A cell is a node. Action i of a cell leads to its i-th neighbor (successor, if edges are directed);
in a cell with fewer neighbors than the graph has moves, the others keep the place, as at a wall.
An edge of length n takes n steps: it has n - 1 cells of its own, on which agents are seen, meet and
can turn round. Opposite directed edges of one length share them.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.validation import is_int, shortened, whole

if TYPE_CHECKING:
    import networkx

MAX_MOVES = 31
"""Sets of moves, and stay, are bit masks of 32 bits."""
MAX_TABLE_CELLS = 4096
"""Larger mazes get no table of all distances, as its size is quadratic in the cells."""
MAX_GRAPH_CELLS = 200_000
"""Limit of the cells of a graph with those within edges; a wrong unit of lengths can need many."""
DIGITS = 10
"""Of positions, relative to the extent of the graph."""
MAX_LAYOUT_NODES = 500
"""Larger graphs without positions are drawn on a circle, as other layouts take long."""


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
    graph: networkx.Graph,
    name: str,
    positions: Mapping[Any, Any] | None = None,
    length: str | None = "length",
    num_moves: int | None = None,
    start: Hashable | None = None,
    goals: Iterable[Hashable] = (),
    decimals: int | None = None,
) -> GraphDrawing:
    """A networkx graph as cells; arguments and errors as of `Maze.from_graph`.

    Positions are rounded to `decimals`; by default relative to the extent of the graph.
    """
    needed = ("nodes", "edges", "adj", "is_directed")
    if isinstance(graph, type) or not all(hasattr(graph, each) for each in needed):
        raise ValueError(
            f"{name}: {shortened(graph)}; give a networkx graph, such as networkx.Graph"
        )
    if length is not None and not isinstance(length, str):
        raise ValueError(f"{name}: length={length!r}; give the name of an attribute, or None")
    if not (positions is None or isinstance(positions, Mapping)):
        raise ValueError(
            f"{name}: positions={shortened(positions)}; give a dict from nodes to (x, y)"
        )
    if isinstance(goals, str) or not isinstance(goals, Iterable):
        raise ValueError(f"{name}: goals={shortened(goals)}; give a list of nodes")
    nodes = list(graph.nodes)
    names = [str(node) for node in nodes]
    if not nodes:
        raise ValueError(f"{name}: a graph without nodes; give at least one")
    check_cell_names(names, name)
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
    check_cell_names(names, name)  # a node may have the name of a cell within an edge
    most = _most_moves(moves, names, name, num_moves)
    neighbors = np.repeat(np.arange(len(names), dtype=np.int32)[:, None], most + 1, axis=1)
    for cell, found in enumerate(moves):
        given = [action for action, _, _ in found if action >= 0]
        if len(set(given)) < len(given):
            raise ValueError(f"{name}: two edges from {names[cell]!r} have one action; change one")
        _assign(neighbors[cell], cell, found)
    check_connected(neighbors, names, name)
    marks = [_marked(mark, number, name) for mark in goals]
    rounded = _rounded(places, name, decimals)
    begin = None if start is None else _marked(start, number, name)
    return GraphDrawing(tuple(names), rounded, neighbors, begin, tuple(marks))


def check_cells(cells: int, name: str) -> None:
    """ValueError for more cells than are possible."""
    if cells > MAX_GRAPH_CELLS:
        raise ValueError(
            f"{name}: {cells:,} cells, with those within edges; at most {MAX_GRAPH_CELLS:,} are "
            "possible. Take a smaller graph, or divide the lengths"
        )


def check_cell_names(names: list[str], name: str) -> None:
    """ValueError if two cells have one name."""
    if len(set(names)) < len(names):
        ((twice, _),) = Counter(names).most_common(1)
        raise ValueError(f"{name}: two nodes are named {twice!r} as text; rename one of them")


def _streets(
    graph: networkx.Graph, name: str, length: str | None
) -> Iterable[tuple[Hashable, Hashable, int, tuple[int, ...]]]:
    """Each edge once: its ends, its steps, and its actions at the first end (-1 for any) and, if it
    can be used both ways, at the second. Opposite edges of one length are one."""
    shortest: dict[tuple[Hashable, Hashable], tuple[int, int]] = {}
    for a, b, data in graph.edges(data=True):
        if a == b:
            raise ValueError(
                f"{name}: an edge from {a!r} to itself; remove it, and give the task "
                "stay_action=True to let agents stay"
            )
        steps = _number_of(data.get(length, 1)) if length is not None else 1
        whole_float = isinstance(steps, float | np.floating) and steps.is_integer()
        if not (is_int(steps) or whole_float) or steps < 1:
            raise ValueError(
                f"{name}: the edge {a!r}, {b!r} has {length}={shortened(steps)}; a length is a "
                "whole number of steps, at least 1: round it, or use Maze.from_graph(graph, "
                "length=None) for edges of one step"
            )
        action = _number_of(data.get("action"))
        if action is not None and not (is_int(action) and 0 <= action < MAX_MOVES):
            raise ValueError(
                f"{name}: the edge {a!r}, {b!r} has action={shortened(action)}; an action is a "
                f"number from 0 to {MAX_MOVES - 1}"
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


def _number_of(value: Any) -> Any:
    """The number of a text, as programs write them to GraphML; anything else as it is."""
    if isinstance(value, str):
        for kind in (int, float):
            with contextlib.suppress(ValueError):
                return kind(value)
    return value


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


def check_connected(neighbors: NDArray[np.int32], names: list[str], name: str) -> None:
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


def _marked(mark: Hashable, number: Mapping[Hashable, int], name: str) -> int:
    if not isinstance(mark, Hashable) or mark not in number:
        raise ValueError(f"{name}: the mark {mark!r} is no node; give one of the graph")
    return number[mark]


def _positions_of(
    graph: networkx.Graph, nodes: list[Hashable], name: str, positions: Mapping[Any, Any] | None
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
        found = [placed[node].round(4) for node in nodes]
    try:
        array = np.array(found, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (len(nodes), 2):
        raise ValueError(f"{name}: positions are pairs of numbers (x, y), one for each node")
    return array


def _rounded(places: ArrayLike, name: str, decimals: int | None) -> NDArray[np.float64]:
    """[cells, 2] float64: positions without the rounding errors of cells within edges.

    Raises:
        ValueError: positions that are not finite, or so far apart that their distance is not.
    """
    array = np.asarray(places, dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        extent = float(np.ptp(array, axis=0).max())
    if not np.isfinite(extent):
        raise ValueError(f"{name}: positions are finite numbers (x, y), with finite distances")
    if decimals is None:
        decimals = DIGITS - 1 - math.floor(math.log10(max(extent, 1e-290)))
    return np.round(array, decimals) if abs(decimals) < 290 else array


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
