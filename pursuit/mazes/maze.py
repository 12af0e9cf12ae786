"""The class `Maze`: cells with walls, or a graph; a text format, and shortest distances."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.mazes.formats import Drawing, read_walls
from pursuit.mazes.graph_files import graph_text, is_graph_text, read_graph_text
from pursuit.mazes.graphs import MAX_TABLE_CELLS as MAX_TABLE_CELLS
from pursuit.mazes.graphs import GraphDrawing, read_graph, to_networkx
from pursuit.mazes.sources import LIBRARY as LIBRARY
from pursuit.mazes.sources import drawing_of
from pursuit.mazes.sources import library_names as library_names
from pursuit.memory import check_memory
from pursuit.rules import (
    EAST,
    NORTH,
    SOUTH,
    UNREACHABLE,
    WEST,
    all_distances,
    breadth_first,
    longest_distance,
)
from pursuit.validation import as_array, is_int

if TYPE_CHECKING:
    import networkx

BYTES_PER_CELL = 70
"""Memory per cell to create a maze, measured with 1000x1000 cells."""
GRID_ONLY = ("height", "width", "cell_numbers", "rows", "columns", "open_south", "open_east")


class GraphHasNoGridError(AttributeError, ValueError):
    """An attribute of rows and columns was read of a graph."""


class Maze:
    """Cells in rows and columns with thin walls between them; a cell may be blocked.

    `Maze.from_graph` makes a maze of any graph. It has no rows and columns, but `cell_names`.

    Walkable cells are numbered row by row from 0. Mazes are immutable: their arrays are read-only.
    Mazes with the same cells, walls and marks are equal; names are not compared.

    Args:
        walkable: [height, width] bool, False where the cell is blocked.
        open_south: [height - 1, width] bool, True where there is no wall between (r, c) and
            (r + 1, c).
        open_east: [height, width - 1] bool, True where there is no wall between (r, c) and
            (r, c + 1).
        start: the (row, column) of the start mark, or None.
        goals: the (row, column) of every goal mark.
        name: name of the maze in messages and results.
        exits: the (row, column) of every exit mark.

    Raises:
        ValueError: no walkable cell; a mark on a blocked cell; a goal that is unreachable from the
            start or another goal; inconsistent shapes; not enough memory.

    Attributes:
        height, width: rows and columns of cells.
        num_cells: number of walkable cells.
        cell_numbers: [height, width] int32, the number of each cell; -1 if blocked.
        rows, columns: [num_cells] int32, the row and column of each cell.
        neighbors: [num_cells, 5] int32, the cell after north, south, east, west and stay; the same
            cell if a wall blocks the move. Of a graph [num_cells, num_moves + 1]: the neighbors of
            the cell, the cell itself where it has fewer, and for stay.
        is_grid: False for a graph; then `height`, `width`, `cell_numbers`, `rows` and `columns`
            raise a ValueError.
        start_mark: the number of the cell marked `S`, or None.
        goal_marks: the numbers of the cells marked `G`, in order.
        exit_marks: the numbers of the cells marked `E`, in order; none in a graph.
    """

    exit_marks: tuple[int, ...] = ()

    def __init__(
        self,
        walkable: NDArray[np.bool_],
        open_south: NDArray[np.bool_],
        open_east: NDArray[np.bool_],
        start: tuple[int, int] | None = None,
        goals: tuple[tuple[int, int], ...] = (),
        name: str = "maze",
        exits: tuple[tuple[int, int], ...] = (),
    ) -> None:
        walkable, open_south, open_east = _own_grids(name, walkable, open_south, open_east)
        height, width = walkable.shape
        if open_south.shape != (height - 1, width) or open_east.shape != (height, width - 1):
            raise ValueError(
                f"{name}: open_south has shape {open_south.shape} and open_east {open_east.shape}; "
                f"{height}x{width} cells need {(height - 1, width)} and {(height, width - 1)}"
            )
        if not walkable.any():
            raise ValueError(f"{name}: no walkable cell; at least one must be walkable")
        self.name, self.is_grid = name, True
        self.height, self.width = height, width
        self.num_cells = int(walkable.sum())
        self.cell_numbers = np.full((height, width), -1, dtype=np.int32)
        self.cell_numbers[walkable] = np.arange(self.num_cells, dtype=np.int32)
        rows, columns = np.nonzero(walkable)
        self.rows, self.columns = rows.astype(np.int32), columns.astype(np.int32)
        self.neighbors = self._neighbor_table(open_south, open_east)
        self.start_mark = None if start is None else self._marked(start, "S")
        for what, marks in (("goals", goals), ("exits", exits)):
            if not isinstance(marks, Iterable):
                raise ValueError(f"{name}: {what}={marks!r}; give the (row, column) of each")
        self.goal_marks = tuple(sorted({self._marked(goal, "G") for goal in goals}))
        self.exit_marks = tuple(sorted({self._marked(place, "E") for place in exits}))
        if {self.start_mark, *self.goal_marks} & set(self.exit_marks):
            raise ValueError(f"{name}: an exit is on the start or a goal; move one of the marks")
        if self.start_mark in self.goal_marks:
            raise ValueError(f"{name}: start and goal are both at {start}; move one of the marks")
        for array in (self.cell_numbers, self.rows, self.columns, self.neighbors):
            array.flags.writeable = False
        self._check_marks_reachable()

    def _neighbor_table(
        self, open_south: NDArray[np.bool_], open_east: NDArray[np.bool_]
    ) -> NDArray[np.int32]:
        numbers = self.cell_numbers
        table = np.repeat(np.arange(self.num_cells, dtype=np.int32)[:, None], 5, axis=1)
        open_south = open_south & (numbers[:-1] >= 0) & (numbers[1:] >= 0)
        open_east = open_east & (numbers[:, :-1] >= 0) & (numbers[:, 1:] >= 0)
        upper, lower = numbers[:-1][open_south], numbers[1:][open_south]
        left, right = numbers[:, :-1][open_east], numbers[:, 1:][open_east]
        table[upper, SOUTH], table[lower, NORTH] = lower, upper
        table[left, EAST], table[right, WEST] = right, left
        return table

    def _marked(self, place: tuple[int, int], mark: str) -> int:
        if np.shape(place) != (2,) or np.asarray(place).dtype.kind not in "iu":
            raise ValueError(f"{self.name}: the mark {mark!r} is at {place!r}; give (row, column)")
        inside = 0 <= place[0] < self.height and 0 <= place[1] < self.width
        cell = int(self.cell_numbers[place]) if inside else -1
        if cell < 0:
            where = "on a blocked cell" if inside else "outside the maze"
            raise ValueError(
                f"{self.name}: the mark {mark!r} at {place} is {where}; put it on a walkable cell"
            )
        return cell

    def _check_marks_reachable(self) -> None:
        if not self.goal_marks:
            return
        origin = self.goal_marks[0] if self.start_mark is None else self.start_mark
        reached = set(self._reached_from(origin))
        for goal in self.goal_marks:
            if goal not in reached:
                row, column = int(self.rows[goal]), int(self.columns[goal])
                raise ValueError(
                    f"{self.name}: line {2 * row + 2}: the goal in row {row}, column {column} is "
                    f"unreachable from {'the other goals' if self.start_mark is None else 'S'}; "
                    "open a wall or move the mark"
                )

    def __getattr__(self, name: str) -> Any:  # only called for attributes that are missing
        if name in GRID_ONLY:
            raise GraphHasNoGridError(
                f"{self.name}: a graph has no {name}, as its cells are not in rows and columns; "
                "use a maze, or neighbors, distances and positions"
            )
        raise AttributeError(f"'Maze' object has no attribute {name!r}")

    # -- graphs ----------------------------------------------------------------------------------

    @classmethod
    def from_graph(
        cls,
        graph: networkx.Graph,
        positions: Mapping[Any, Any] | None = None,
        length: str | None = "length",
        num_moves: int | None = None,
        start: Hashable | None = None,
        goals: Iterable[Hashable] = (),
        name: str = "graph",
    ) -> Maze:
        """A maze with the nodes of a networkx graph, directed or not, as cells.

        Action i leads along the edge to the i-th of `graph.neighbors(node)` (directed graphs:
        `graph.successors(node)`); with fewer neighbors the agent keeps its place. Edges may have an
        attribute `action`, the action that takes them. Of parallel edges only the shortest counts.

        Args:
            graph: connected (directed graphs: strongly), without edges from a node to itself.
            positions: (x, y) of each node for pictures; by default the attributes `pos` or `x` and
                `y` of the nodes, or a layout by springs (on a circle above 500 nodes).
            length: the attribute of edges with their length in steps, 1 if it is missing; None for
                1. An edge of length n gets n - 1 cells, on which agents are seen and, if it is not
                one-way, can turn. Opposite directed edges of one length share them.
            num_moves: the number of moves, at most 31; by default the largest degree. Graphs in one
                task need the same number.
            start, goals: the nodes that are marked.
            name: of the maze in messages and results.

        Raises:
            ValueError: an empty or unconnected graph, an edge from a node to itself, two nodes with
                the same name as text, more than 31 neighbors, or a length that is no whole number;
                a graph of more than 200,000 cells, or MAX_TABLE_CELLS if it is directed.
        """
        drawing = read_graph(graph, name, positions, length, num_moves, start, goals)
        return cls.from_drawing(drawing, name)

    def to_graph(self) -> networkx.DiGraph[str]:
        """A networkx graph of the cells, from which `from_graph` makes a maze with equal actions.

        Nodes are the `cell_names` with the attributes `x` and `y`; each move that changes the cell
        is an edge with the attribute `action`.
        """
        return to_networkx(self)

    @classmethod
    def from_drawing(cls, drawing: Drawing | GraphDrawing, name: str) -> Maze:
        """The maze of the content of a file."""
        if isinstance(drawing, Drawing):
            return cls(*drawing[:-1], name, drawing.exits)
        maze = cls.__new__(cls)
        maze.name, maze.is_grid = name, False
        maze.num_cells, maze.neighbors = len(drawing.names), drawing.neighbors
        maze.neighbors.flags.writeable = False
        maze.start_mark, maze.goal_marks = drawing.start, tuple(sorted(set(drawing.goals)))
        maze.__dict__.update(cell_names=drawing.names, positions=drawing.positions)
        if maze.start_mark in maze.goal_marks:
            raise ValueError(f"{name}: start and goal are at one node; move one of the marks")
        if maze.is_directed and maze.num_cells > MAX_TABLE_CELLS:
            raise ValueError(
                f"{name}: a directed graph of {maze.num_cells} cells; at most {MAX_TABLE_CELLS} "
                "are possible. Make its edges undirected, or take a smaller part"
            )
        return maze

    @cached_property
    def cell_names(self) -> tuple[str, ...]:
        """The names of the nodes of a graph, or "row,column" of the cells of a grid."""
        return tuple(f"{r},{c}" for r, c in zip(self.rows, self.columns, strict=True))

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """[num_cells, 2] float64, x to the right and y upwards; used in pictures only."""
        return np.stack([self.columns, -self.rows.astype(np.float64)], axis=1)

    @cached_property
    def picture(self) -> NDArray[np.float64]:
        """[num_cells, 2] float64, row and column of each cell in a picture.

        A graph is scaled so that the median distance between neighbors is 1.5.
        """
        if self.is_grid:
            return np.stack([self.rows, self.columns], axis=1).astype(np.float64)
        x, y = self.positions.T
        places = np.stack([y.max() - y, x - x.min()], axis=1)
        a, b = np.nonzero(self.neighbors != np.arange(self.num_cells)[:, None])
        away = np.linalg.norm(places[a] - places[self.neighbors[a, b]], axis=1)
        away = away[away > 0.0]
        return np.asarray(places * (1.5 / np.median(away) if len(away) else 1.0))

    @property
    def picture_size(self) -> tuple[float, float]:
        """The rows and columns of a picture of all cells."""
        if self.is_grid:
            return self.height, self.width
        height, width = (self.picture.max(axis=0) + 1.0).tolist()
        return height, width

    @property
    def num_moves(self) -> int:
        """The number of moves of an agent without stay: 4, or of a graph its largest degree."""
        return self.neighbors.shape[1] - 1

    @cached_property
    def is_directed(self) -> bool:
        """Whether some move between two cells has no move back."""
        cells = np.repeat(np.arange(self.num_cells, dtype=np.int64), self.num_moves)
        there = self.neighbors[:, :-1].ravel().astype(np.int64)
        back = np.isin(there * self.num_cells + cells, cells * self.num_cells + there)
        return not bool(back.all())

    # -- text ------------------------------------------------------------------------------------

    @classmethod
    def from_text(cls, text: str, name: str = "maze text") -> Maze:
        """Read a maze of H×W cells from 2H+1 lines of 2W+1 characters.

        The character at (2r+1, 2c+1) is the cell: blank, `S` (start), `G` (goal), `E` (exit) or `#`
        (blocked).
        A blank between two cells connects them; any other character is a wall. The border is always
        closed. Leading and trailing blank lines, carriage returns, a missing last newline and
        missing trailing blanks are accepted.

        The text that `to_text` writes of a graph is read as well.

        Raises:
            ValueError: invalid text; the message names the maze, the line and the remedy.
        """
        read = read_graph_text if is_graph_text(text) else read_walls
        return cls.from_drawing(read(text, name), name)

    def to_text(self) -> str:
        """The maze in the text format, which `Maze.from_text` reads."""
        if not self.is_grid:
            return graph_text(self)
        grid = np.full((2 * self.height + 1, 2 * self.width + 1), " ", dtype="<U1")
        grid[::2, ::2] = "+"
        grid[::2, 1::2] = "-"
        grid[1::2, ::2] = "|"
        cells = grid[1::2, 1::2]
        cells[self.cell_numbers < 0] = "#"
        grid[2:-1:2, 1::2][self.open_south] = " "
        grid[1::2, 2:-1:2][self.open_east] = " "
        start = () if self.start_mark is None else (self.start_mark,)
        for mark, marked in (("S", start), ("G", self.goal_marks), ("E", self.exit_marks)):
            for cell in marked:
                cells[self.rows[cell], self.columns[cell]] = mark
        return "\n".join("".join(line) for line in grid) + "\n"

    @property
    def open_south(self) -> NDArray[np.bool_]:
        """[height - 1, width] bool, True where (r, c) and (r + 1, c) are neighbours."""
        numbers, south = self.cell_numbers[:-1], self.neighbors[:, SOUTH]
        return (numbers >= 0) & (south[numbers] != numbers)

    @property
    def open_east(self) -> NDArray[np.bool_]:
        """[height, width - 1] bool, True where (r, c) and (r, c + 1) are neighbours."""
        numbers, east = self.cell_numbers[:, :-1], self.neighbors[:, EAST]
        return (numbers >= 0) & (east[numbers] != numbers)

    # -- graph -----------------------------------------------------------------------------------

    @cached_property
    def degrees(self) -> NDArray[np.int32]:
        """[num_cells] int32, the number of moves that change the cell."""
        own = np.arange(self.num_cells, dtype=np.int32)[:, None]
        return (self.neighbors[:, :-1] != own).sum(axis=1, dtype=np.int32)

    @cached_property
    def dead_ends(self) -> NDArray[np.int32]:
        """The numbers of the cells with exactly one neighbour, in order."""
        return np.flatnonzero(self.degrees == 1).astype(np.int32)

    def _reached_from(self, cell: int) -> list[int]:
        """The cells that can be reached from `cell`, without the kernel of `distances_from`: all
        commands read mazes, also to print their options."""
        neighbors, known, queue = self.neighbors.tolist(), {cell}, [cell]
        for each in queue:
            more = set(neighbors[each]) - known
            known |= more
            queue += more
        return queue

    @cached_property
    def num_components(self) -> int:
        """The number of connected components."""
        unseen, parts = np.ones(self.num_cells, dtype=bool), 0
        while unseen.any():
            unseen[self._reached_from(int(unseen.argmax()))] = False
            parts += 1
        return parts

    @property
    def is_connected(self) -> bool:
        """Whether every walkable cell can be reached from every other."""
        return self.num_components == 1

    @property
    def num_loops(self) -> int:
        """The number of independent cycles: passages - cells + components; 0 for a tree."""
        return int(self.degrees.sum()) // 2 - self.num_cells + self.num_components

    @cached_property
    def distances(self) -> NDArray[np.int32]:
        """[num_cells, num_cells] int32, steps of shortest paths from the first cell to the second.

        UNREACHABLE without a path. The table is symmetric unless the graph `is_directed`.
        Computed on first use and read-only.

        Raises:
            ValueError: the maze has more than MAX_TABLE_CELLS cells. Use `distances_from`, or
                `scripted_agents.shortest_path`, which need no table.
        """
        if self.num_cells > MAX_TABLE_CELLS:
            raise ValueError(
                f"{self.name}: {self.num_cells} cells; a table of all distances is built up to "
                f"{MAX_TABLE_CELLS}. Use maze.distances_from(cell) or scripted_agents.shortest_path"
            )
        table = table_of_distances(self)
        table.flags.writeable = False
        return table

    def distances_from(self, cell: int) -> NDArray[np.int32]:
        """[num_cells] int32, distances from `cell` to all cells, by breadth-first search.

        UNREACHABLE without a path. It needs no table, so it works for mazes of any size.
        """
        self.check_cell(cell)
        if "distances" in self.__dict__:
            return self.distances[cell]
        distances = np.empty(self.num_cells, dtype=np.int32)
        queue = np.empty(self.num_cells, dtype=np.int32)
        distances.fill(UNREACHABLE)
        breadth_first(self.neighbors, cell, distances, queue)
        return distances

    def distances_to(self, cell: int) -> NDArray[np.int32]:
        """[num_cells] int32, distances from all cells to `cell`, as `distances_from`."""
        self.check_cell(cell)
        return self.distances[:, cell] if self.is_directed else self.distances_from(cell)

    @cached_property
    def longest_distance(self) -> int:
        """The largest finite distance between two cells, in time quadratic in their number."""
        if self.num_cells <= MAX_TABLE_CELLS:
            table = self.distances
            return int(table[table != UNREACHABLE].max())
        return int(longest_distance(self.neighbors))

    def check_cell(self, cell: int) -> int:
        """`cell` as an int; ValueError if it is not the number of a cell."""
        if not is_int(cell):
            raise ValueError(f"{self.name}: cell {cell!r}; a cell is a whole number")
        if not 0 <= cell < self.num_cells:
            raise ValueError(f"{self.name}: cell {cell}; the cells are 0 to {self.num_cells - 1}")
        return int(cell)

    @cached_property
    def _content(self) -> bytes:
        """A digest of the maze without its name; equal mazes have equal digests."""
        exits = (self.exit_marks,) if self.exit_marks else ()  # without them as before
        digest = hashlib.sha256(repr((self.start_mark, self.goal_marks, *exits)).encode())
        for array in (self.cell_numbers, self.neighbors) if self.is_grid else (self.neighbors,):
            digest.update(repr(array.shape).encode())
            digest.update(array.tobytes())
        return digest.digest()

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, Maze) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    def __getstate__(self) -> dict[str, Any]:
        """All attributes except the distance table, which is large and fast to compute."""
        return {name: kept for name, kept in vars(self).items() if name != "distances"}

    def __repr__(self) -> str:
        shape = f"{self.height}x{self.width}" if self.is_grid else "graph"
        return f"<Maze {self.name}: {shape}, {self.num_cells} cells>"


def _own_grids(name: str, *grids: ArrayLike) -> tuple[NDArray[np.bool_], ...]:
    """Copies of the grids [rows, columns] of a maze, as bool arrays.

    Raises:
        ValueError: not two dimensions, no bools, or not enough memory.
    """
    rule = "walkable, open_south and open_east are arrays [rows, columns] of bools"
    found = [as_array(f"{name}: grid", grid, "b", rule) for grid in grids]
    if any(grid.ndim != 2 for grid in found):
        raise ValueError(f"{name}: {rule}; the shapes are {[grid.shape for grid in found]}")
    height, width = found[0].shape
    needed = BYTES_PER_CELL * found[0].size
    check_memory(f"{name} of {height}x{width} cells", needed, "make it smaller")
    return tuple(np.array(grid, dtype=bool) for grid in found)


def table_of_distances(maze: Maze) -> NDArray[np.int32]:
    """`maze.distances`, computed without caching it in the maze; for large sets of mazes."""
    if "distances" in vars(maze):
        return maze.distances
    table = np.empty((maze.num_cells, maze.num_cells), dtype=np.int32)
    all_distances(maze.neighbors, table)
    return table


def load_maze(maze: str | Path | Maze) -> Maze:
    """Load a maze: an included one by name (`"5x5"`), one of a suite, or a file by path.

    A `Maze` is returned unchanged. One maze of a suite is `"suite:7x7-test/017"`; for all of them
    see `pursuit.load_suite`. Files with the suffix `.map` are read as MovingAI maps (Sturtevant,
    2012): passable squares (`.`, `G`, and swamp `S`) are cells connected to their neighbours; all
    others are blocked. Files with the suffix `.graphml` are read as GraphML, and with `.edgelist`
    or `.edges` as lines of two nodes and, if it is not 1, the length of the edge in steps; these
    edges have no direction.

    Raises:
        ValueError: an unknown name, a missing file, a directory, or an invalid file. The message
            names the file, the line and the remedy.
    """
    if isinstance(maze, Maze):
        return maze
    if not isinstance(maze, (str, Path)):
        raise ValueError(f"maze={maze!r}; give the name of a maze, a path, or a Maze")
    drawing, name = drawing_of(maze)
    return Maze.from_drawing(drawing, name)
