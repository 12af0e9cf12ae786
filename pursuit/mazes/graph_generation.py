"""Generators of graphs: grids with eight or six neighbors, a torus, random points, and roads."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from pursuit.mazes.graphs import MAX_TABLE_CELLS, GraphDrawing, check_cells, read_graph
from pursuit.memory import check_memory
from pursuit.validation import one_of, whole

if TYPE_CHECKING:
    import networkx

GRAPHS = ("eight", "hexagonal", "torus", "geometric", "roads")
_FOUR = ((-1, 0), (1, 0), (0, 1), (0, -1))
_STEPS = {
    "torus": _FOUR,
    "eight": (*_FOUR, (-1, 1), (-1, -1), (1, 1), (1, -1)),
    # Odd rows lie half a cell to the right, so steps between even rows lead one column less far.
    "hexagonal": (*_FOUR, (-1, 1), (1, 1)),
}
ONE_WAY, DIAGONAL, REMOVED = 0.15, 0.1, 0.25
"""Shares of the streets of `roads`."""


def graph_drawing(
    kind: str, height: int, width: int, seed: int, name: str, **marks: Any
) -> GraphDrawing:
    """The content of a graph, with arguments and errors as of `pursuit.generate_graph`; `marks` are
    `start`, `goals` and `num_moves` of `Maze.from_graph`."""
    import networkx  # slow to import

    one_of("kind", kind, GRAPHS)
    height, width = whole("height", height, 3, 1000), whole("width", width, 3, 1000)
    check_cells(height * width, name)
    if kind == "roads" and height * width > MAX_TABLE_CELLS:
        raise ValueError(
            f"{name}: a directed graph of at least {height * width:,} cells; at most "
            f"{MAX_TABLE_CELLS} are possible. Give a smaller height or width"
        )
    random = np.random.default_rng(whole("seed", seed, 0, 2**63 - 1))
    graph = networkx.DiGraph()
    if kind == "geometric":
        graph = _points(height * width, random)
    elif kind == "roads":
        graph = _roads(height, width, random)
    else:
        for r, c in product(range(height), range(width)):
            shift = 0.5 * (r % 2) if kind == "hexagonal" else 0.0
            graph.add_node(f"{r},{c}", x=c + shift, y=-float(r))
        for r, c in product(range(height), range(width)):
            for action, (down, right) in enumerate(_STEPS[kind]):
                row, column = r + down, c + right
                if kind == "hexagonal" and down and r % 2 == 0:
                    column -= 1
                if kind == "torus":
                    row, column = row % height, column % width
                if 0 <= row < height and 0 <= column < width:
                    graph.add_edge(f"{r},{c}", f"{row},{column}", action=action)
    return read_graph(graph, name, decimals=4, **marks)


def _points(count: int, random: np.random.Generator) -> networkx.Graph:
    """A random geometric graph (Penrose, 2003) with the least radius that connects it."""
    import networkx  # slow to import
    from scipy.sparse.csgraph import minimum_spanning_tree

    check_memory(f"a table of {count:,} x {count:,} distances", 40 * count**2, "take fewer points")
    places = random.random((count, 2)).round(4)
    away = np.linalg.norm(places[:, None] - places[None], axis=2)
    # The least radius is the longest edge of a minimum spanning tree.
    radius = minimum_spanning_tree(away + 1e-12).max()
    graph = networkx.Graph()
    graph.add_nodes_from((str(i), {"x": x, "y": y}) for i, (x, y) in enumerate(places.tolist()))
    near = np.argwhere(np.triu(away <= radius, 1)).tolist()
    graph.add_edges_from((str(a), str(b)) for a, b in near)
    return graph


def _roads(height: int, width: int, random: np.random.Generator) -> networkx.Graph:
    """Streets between the crossings of a grid; every crossing can be reached from every other."""
    import networkx  # slow to import

    graph = networkx.DiGraph()
    cells = list(product(range(height), range(width)))
    moved = random.uniform(-0.25, 0.25, (len(cells), 2))
    for (r, c), (x, y) in zip(cells, moved.tolist(), strict=True):
        graph.add_node(f"{r},{c}", x=c + x, y=y - r)
    for r, c in cells:
        for down, right in ((0, 1), (1, 0), (1, 1)):
            if r + down >= height or c + right >= width:
                continue
            a, b = f"{r},{c}", f"{r + down},{c + right}"
            if down + right < 2 or random.random() < DIAGONAL:
                steps = 2 if random.random() < DIAGONAL else 1
                graph.add_edge(a, b, length=steps)
                graph.add_edge(b, a, length=steps)
    streets = [edge for edge in graph.edges if edge[0] < edge[1]]
    for index in random.permutation(len(streets)).tolist():
        a, b = streets[index]
        draw = random.random()
        gone = [(a, b), (b, a)] if draw < REMOVED else [(a, b)] if draw < REMOVED + ONE_WAY else []
        kept = [(*edge, graph.edges[edge]) for edge in gone]
        graph.remove_edges_from(gone)
        if not all(networkx.has_path(graph, *edge) for edge in gone):  # a short search
            graph.add_edges_from(kept)
    return graph
