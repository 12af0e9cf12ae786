"""Mazes: their text, their graph, their generators and the shipped library."""

import tracemalloc
from itertools import product
from pathlib import Path

import networkx
import numpy as np
import pytest
from diagonals import diagonal
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import chisquare
from shipped_mazes import library_mazes

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import LIBRARY, MAX_TABLE_CELLS, Maze, library_names, load_maze
from pursuit.rules import EAST, NORTH, SOUTH, STAY, UNREACHABLE, WEST

CORRIDOR = Maze.from_text("+-+-+-+\n|S   G|\n+-+-+-+")
TREES = ("prim", "backtracker", "wilson")
SIZES = [(1, 1), (1, 6), (6, 1), (2, 2), (3, 8), (9, 9)]


@st.composite
def mazes(draw: st.DrawFn) -> Maze:
    """Any small maze: walls and blocked cells anywhere, with or without marks."""
    height, width = draw(st.integers(1, 6)), draw(st.integers(1, 6))
    walkable = draw(arrays(bool, (height, width)))
    assume(walkable.any())
    walls = [draw(arrays(bool, shape)) for shape in ((height - 1, width), (height, width - 1))]
    maze = Maze(walkable, *walls)
    places = list(zip(maze.rows.tolist(), maze.columns.tolist(), strict=True))
    start = draw(st.none() | st.integers(0, maze.num_cells - 1))
    origin = start if start is not None else draw(st.integers(0, maze.num_cells - 1))
    reachable = np.flatnonzero(maze.distances_from(origin) != UNREACHABLE).tolist()
    goals = draw(st.sets(st.sampled_from(reachable), max_size=4)) - {start}
    mark = None if start is None else places[start]
    return Maze(walkable, *walls, mark, tuple(places[goal] for goal in goals))


def graph_of(text: str) -> networkx.Graph:
    """The graph that the text draws, read without `Maze`; nodes are (row, column)."""
    lines, graph = text.splitlines(), networkx.Graph()
    height, width = len(lines) // 2, len(lines[0]) // 2
    graph.add_nodes_from(
        (r, c) for r in range(height) for c in range(width) if lines[2 * r + 1][2 * c + 1] != "#"
    )
    for r, c in graph.nodes:
        for i, j in ((1, 0), (0, 1)):
            if (r + i, c + j) in graph and lines[2 * r + 1 + i][2 * c + 1 + j] == " ":
                graph.add_edge((r, c), (r + i, c + j))
    return graph


def num_passages(maze: Maze) -> int:
    return int(maze.degrees.sum()) // 2


# -- text ------------------------------------------------------------------------------------------


@given(mazes())
def test_text_round_trips(maze: Maze) -> None:
    again = Maze.from_text(maze.to_text())
    assert again == maze and hash(again) == hash(maze)
    np.testing.assert_array_equal(again.neighbors, maze.neighbors)
    np.testing.assert_array_equal(again.cell_numbers, maze.cell_numbers)
    assert (again.start_mark, again.goal_marks) == (maze.start_mark, maze.goal_marks)
    assert again.to_text() == maze.to_text()


@given(mazes())
def test_neighbors_and_distances_are_those_of_the_drawn_graph(maze: Maze) -> None:
    graph = graph_of(maze.to_text())
    places = list(zip(maze.rows.tolist(), maze.columns.tolist(), strict=True))
    assert places == sorted(graph.nodes)  # numbered row by row
    edges = {
        frozenset((places[cell], places[after]))
        for cell in range(maze.num_cells)
        for after in maze.neighbors[cell, :4].tolist()
        if after != cell
    }
    assert edges == {frozenset(edge) for edge in graph.edges}
    assert maze.num_components == networkx.number_connected_components(graph)
    assert maze.is_connected == networkx.is_connected(graph)
    assert maze.num_loops == len(networkx.cycle_basis(graph))
    assert [places[cell] for cell in maze.dead_ends] == [
        place for place in places if graph.degree[place] == 1
    ]
    lengths = dict(networkx.all_pairs_shortest_path_length(graph))
    expected = [[lengths[a].get(b, UNREACHABLE) for b in places] for a in places]
    rows = [maze.distances_from(cell) for cell in range(maze.num_cells)]
    np.testing.assert_array_equal(rows, expected)  # one search each, no table yet
    np.testing.assert_array_equal(maze.distances, expected)
    assert maze.longest_distance == max(max(line.values()) for line in lengths.values())


@given(mazes())
def test_neighbors_are_symmetric(maze: Maze) -> None:
    for cell, row in enumerate(maze.neighbors.tolist()):
        assert row[STAY] == cell
        for there, back in ((NORTH, SOUTH), (SOUTH, NORTH), (EAST, WEST), (WEST, EAST)):
            assert row[there] == cell or maze.neighbors[row[there], back] == cell


def test_actions_point_north_south_east_west() -> None:
    maze = generate_maze("open", 3, 4)
    assert maze.neighbors[5].tolist() == [1, 9, 6, 4, 5]
    assert maze.neighbors[0].tolist() == [0, 4, 1, 0, 0]


DRAWN = "+-+-+-+\n|S    |\n+ +-+ +\n|    G|\n+-+-+-+\n"


@pytest.mark.parametrize(
    "text",
    [
        DRAWN.rstrip("\n"),  # no newline at the end
        DRAWN.replace("\n", "\r\n"),
        "\n\n" + DRAWN + "\n  \n",  # blank lines around
        DRAWN.replace("|\n", "  \n"),  # nothing drawn on the right ...
        DRAWN.replace("|\n", "\n"),  # ... and the blanks cut off by an editor
        DRAWN.replace("-", "=").replace("|", "!").replace("+", "*"),
        DRAWN.replace("-", "#").replace("|", "#").replace("+", "#"),
        DRAWN.replace("-", "─").replace("|", "│").replace("+", "┼"),
        DRAWN.replace("+ +-+ +", "|  -  |"),  # corner posts left out
    ],
)
def test_mazes_written_by_others_are_read(text: str) -> None:
    assert Maze.from_text(text) == Maze.from_text(DRAWN)


def test_a_file_with_a_byte_order_mark_and_carriage_returns_is_read(tmp_path: Path) -> None:
    path = tmp_path / "theirs.txt"
    path.write_bytes(b"\xef\xbb\xbf" + DRAWN.replace("\n", "\r\n").encode())
    assert load_maze(path) == load_maze(str(path)) == Maze.from_text(DRAWN)


def test_marks_and_blocked_cells_may_be_anywhere() -> None:
    maze = Maze.from_text("+-+-+-+\n|G #  |\n+ +-+ +\n|  S G|\n+-+-+-+")
    assert (maze.height, maze.width, maze.num_cells) == (2, 3, 5)
    assert maze.cell_numbers.tolist() == [[0, -1, 1], [2, 3, 4]]
    assert maze.start_mark == 3 and maze.goal_marks == (0, 4)
    assert maze.distances[0, 1] == 4


SHORT_LINE = "+-+-+\n|   |\n+-+\n|   |\n+-+-+\n"


@pytest.mark.parametrize(
    ("content", "line", "remedy"),
    [
        (SHORT_LINE, 3, "not rectangular; give every line the same length"),
        ("+-+-+\n|    |\n+-+-+\n", 2, "not rectangular"),
        ("+-+-+\n|     |\n+-+-+\n", 2, "not rectangular"),
        ("\n\n" + SHORT_LINE, 5, "not rectangular"),
        ("+-+-+\n|S G|\n", 2, "is the lower border missing?"),
        ("+-+-+\n|S X|\n+-+-+\n", 2, "unknown character 'X'; a cell is"),
        ("+-+-+\n|\t  |\n+-+-+\n", 2, r"unknown character '\t'; a maze is plain text"),
        ("+-+-+\n|S S|\n+-+-+\n", 2, "second start mark 'S'; keep one"),
        ("+-+-+\n|   |\n+G+-+\n|   |\n+-+-+\n", 3, "is between cells; put it in a cell"),
        ("+-+-+\n|S|G|\n+-+-+\n", 2, "unreachable from S; open a wall or move the mark"),
        ("+-+-+\n|G| |\n+-+ +\n|G  |\n+-+-+\n", 4, "unreachable from the other goals"),
        ("+-+-+\n|###|\n+-+-+\n", None, "no walkable cell; at least one must be walkable"),
        ("", None, "the file is empty; a maze of one cell is"),
        (" \n\n", None, "the file is empty"),
        (b"\x89PNG\r\n\x1a\n", 1, "not a text file"),
        (b"+-+-+\n|\xff\xfe |\n+-+-+\n", 2, "not a text file"),
        (b"\x00\x01\x02\x03", 1, ""),
    ],
)
def test_errors_of_invalid_files_name_line_and_remedy(
    tmp_path: Path, content: str | bytes, line: int | None, remedy: str
) -> None:
    path = tmp_path / "bad.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError) as caught:
        load_maze(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: " if line is None else f"{path}: line {line}: ")
    assert remedy in message and "\n" not in message


def test_errors_of_missing_files_name_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a directory or device; give a maze file"):
        load_maze(tmp_path)
    for missing in ("5x6", str(tmp_path / "missing.txt"), ""):
        with pytest.raises(
            ValueError,
            match=r"directory|; or give a path|no such file; give",
        ):
            load_maze(missing)
    with pytest.raises(ValueError, match="cannot be read"):
        load_maze("x" * 1000)
    with pytest.raises(ValueError, match=r"use Maze\.from_text"):
        load_maze(DRAWN)


def test_impossible_mazes_cannot_be_built() -> None:
    walls = np.ones((1, 2), dtype=bool), np.ones((2, 1), dtype=bool)
    walkable = np.array([[True, True], [True, False]])
    for start, goals in (((1, 1), ()), ((0, 2), ()), ((-1, 0), ()), ((0, 0), ((0, 0),))):
        with pytest.raises(ValueError, match="mark"):
            Maze(walkable, *walls, start, goals)
    with pytest.raises(ValueError, match="open_south has shape"):
        Maze(walkable, walls[1], walls[0])


# -- mazes as values -------------------------------------------------------------------------------


def test_equal_mazes_are_equal_keys_whatever_their_name() -> None:
    same = Maze.from_text(CORRIDOR.to_text(), name="other")
    assert same == CORRIDOR and hash(same) == hash(CORRIDOR) and len({same, CORRIDOR}) == 1
    walls = np.ones((0, 3), dtype=bool), np.ones((1, 2), dtype=bool)
    goals = ((0, 0), (0, 2))
    one, two = (Maze(np.ones((1, 3), dtype=bool), *walls, None, g) for g in (goals, goals[::-1]))
    assert one == two and hash(one) == hash(two)
    for row in ("|S G  |", "|G   S|", "|S   #|", "|S| | |", "|    G|", "|G   G|"):
        assert Maze.from_text(f"+-+-+-+\n{row}\n+-+-+-+") != CORRIDOR
    assert CORRIDOR.to_text() != CORRIDOR


def test_a_maze_cannot_be_changed() -> None:
    arrays_of = (CORRIDOR.neighbors, CORRIDOR.distances, CORRIDOR.cell_numbers, CORRIDOR.rows)
    for array in arrays_of:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_only_numbers_of_cells_are_cells() -> None:
    for cell in (-1, 3):
        with pytest.raises(ValueError, match="the cells are 0 to 2"):
            CORRIDOR.distances_from(cell)


def test_above_the_limit_there_is_no_table_but_single_searches() -> None:
    largest = generate_maze("open", 64)
    assert largest.num_cells == MAX_TABLE_CELLS and largest.distances[0, -1] == 126
    beyond = generate_maze("prim", 64, 65, loops=0.2)
    with pytest.raises(ValueError, match="distances_from"):
        _ = beyond.distances
    origin = 2000
    lengths = networkx.single_source_shortest_path_length(
        graph_of(beyond.to_text()), (int(beyond.rows[origin]), int(beyond.columns[origin]))
    )
    places = zip(beyond.rows.tolist(), beyond.columns.tolist(), strict=True)
    assert beyond.distances_from(origin).tolist() == [lengths[place] for place in places]


@pytest.mark.parametrize("algorithm", ["open", *TREES])
def test_a_million_cells_take_bounded_memory(algorithm: str) -> None:
    tracemalloc.start()
    maze = generate_maze(algorithm, 1000)
    distances = maze.distances_from(0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 300e6
    assert distances.max() < UNREACHABLE  # connected
    if algorithm == "open":
        np.testing.assert_array_equal(distances, maze.rows + maze.columns)
    else:
        assert num_passages(maze) == maze.num_cells - 1


# -- generators ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("algorithm", "size"), product(TREES, SIZES))
def test_without_loops_a_maze_is_a_spanning_tree(algorithm: str, size: tuple[int, int]) -> None:
    for seed in range(5):
        maze = generate_maze(algorithm, *size, seed=seed)
        assert (maze.height, maze.width, maze.num_cells) == (*size, size[0] * size[1])
        assert maze.is_connected and num_passages(maze) == maze.num_cells - 1


@pytest.mark.parametrize(
    ("algorithm", "size", "loops"), diagonal(TREES, SIZES * 2, [0.0, 0.1, 0.5, 0.77, 1.0])
)
def test_loops_is_the_exact_share_of_opened_walls(
    algorithm: str, size: tuple[int, int], loops: float
) -> None:
    tree, maze = (generate_maze(algorithm, *size, loops=share, seed=3) for share in (0, loops))
    room = generate_maze("open", *size)
    walls = num_passages(room) - num_passages(tree)
    assert maze.num_loops == round(loops * walls)
    assert np.all((maze.neighbors == tree.neighbors) | (tree.neighbors == tree.neighbors[:, 4:]))
    assert (maze == room) == (maze.num_loops == walls)


@pytest.mark.parametrize("loops", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("algorithm", [*TREES, "open"])
def test_braided_mazes_have_no_dead_ends(algorithm: str, loops: float) -> None:
    for height, width in ((1, 1), (2, 2), (2, 7), (3, 3), (9, 9), (20, 31)):
        before, braided = (
            generate_maze(algorithm, height, width, loops=loops, no_dead_ends=wish, seed=5)
            for wish in (False, True)
        )
        assert braided.dead_ends.size == 0 and braided.is_connected
        opened = num_passages(braided) - num_passages(before)
        dead_ends = before.dead_ends.size
        assert (dead_ends + 1) // 2 <= opened <= dead_ends  # a wall ends one dead end, or two


@pytest.mark.parametrize("algorithm", TREES)
def test_the_seed_decides_the_maze(algorithm: str) -> None:
    made = [generate_maze(algorithm, 9, loops=0.2, no_dead_ends=True, seed=s) for s in range(20)]
    again = [generate_maze(algorithm, 9, loops=0.2, no_dead_ends=True, seed=s) for s in range(20)]
    assert made == again and len(set(made)) == 20
    rng = np.random.default_rng(7)
    drawn = [generate_maze(algorithm, 9, seed=rng) for _ in range(5)]
    assert drawn[0] == generate_maze(algorithm, 9, seed=7) and len(set(drawn)) == 5


@pytest.mark.slow
def test_wilson_is_uniform_over_spanning_trees_and_prim_is_not() -> None:
    num_trees, samples = 15, 4500  # Kirchhoff: a grid of 2×3 has 15 spanning trees
    p_values = {}
    for algorithm in ("wilson", "prim"):
        rng = np.random.default_rng(0)
        texts = [generate_maze(algorithm, 2, 3, seed=rng).to_text() for _ in range(samples)]
        counts = np.unique(texts, return_counts=True)[1]
        assert counts.size == num_trees
        p_values[algorithm] = chisquare(counts).pvalue
    assert p_values["wilson"] > 1e-3
    assert p_values["prim"] < 1e-9  # the test can tell


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        ({"algorithm": "kruskal"}, "'kruskal'; one of prim, backtracker, wilson, open"),
        ({"height": 0}, "height=0; it is at least 1"),
        ({"width": -3}, "width=-3; it is at least 1"),
        ({"height": 2.5}, "height=2.5; it is a whole number"),
        (
            {"height": 3000, "width": 2000},
            "6000000 cells; they need 600,000,000 bytes.* at most 4000000: make it smaller",
        ),
        ({"loops": 1.5}, "loops 1.5; .*give a number from 0"),
        ({"loops": -0.1}, "loops -0.1; "),
        ({"loops": float("nan")}, "loops nan; "),
        ({"width": 1, "no_dead_ends": True}, "5x1 cells; .*give height and width of 2 or more"),
        ({"seed": -1}, "seed -1; give an int of 0 or more, or a numpy Generator"),
    ],
)
def test_invalid_arguments_are_refused(arguments: dict[str, object], remedy: str) -> None:
    with pytest.raises(ValueError, match=remedy):
        generate_maze(**{"algorithm": "prim", "height": 5, **arguments})  # type: ignore[arg-type]


# -- the shipped library ---------------------------------------------------------------------------


def test_the_shipped_files_are_what_the_generator_makes() -> None:
    made = library_mazes()
    assert sorted(made) == sorted(library_names())
    for name, maze in made.items():
        assert (LIBRARY / f"{name}.txt").read_text() == maze.to_text()
        assert load_maze(name) == maze and load_maze(name).name == name


@pytest.mark.parametrize("size", [*range(2, 10), 15])
def test_the_shipped_mazes_have_the_documented_properties(size: int) -> None:
    braided, tree, room = (load_maze(f"{size}x{size}{kind}") for kind in ("", "-tree", "-open"))
    for maze in (braided, tree, room):
        assert maze.is_connected and maze.num_cells == size * size
        assert (maze.start_mark, maze.goal_marks) == (0, (maze.num_cells - 1,))
    assert braided.dead_ends.size == 0 and tree.num_loops == 0
    assert room.num_loops == (size - 1) ** 2
    if size > 2:  # two by two cells without dead ends are an open ring
        assert braided.num_loops <= room.num_loops / 2
