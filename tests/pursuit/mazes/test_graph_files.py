"""Files and arguments of graphs: positions, lengths, long content, generation, and round trips."""

from __future__ import annotations

import html
from itertools import product
from pathlib import Path
from typing import Any

import networkx
import numpy as np
import pytest
from diagonals import diagonal

import pursuit
from pursuit.mazes.graph_files import SUFFIXES
from pursuit.mazes.graph_generation import DIAGONAL, ONE_WAY, REMOVED
from pursuit.mazes.maze import Maze
from pursuit.mazes.sources import MOVINGAI, OTHER_GRAPHS
from pursuit.mazes.suites import load_mazes
from train.commands.main import main


def line(places: Any) -> Any:
    """A path with these positions."""
    graph = networkx.path_graph(len(places))
    for node, (x, y) in enumerate(places):
        graph.nodes[node].update(x=x, y=y)
    return graph


@pytest.mark.parametrize(
    ("offset", "unit"),
    diagonal(
        [(0.0, 0.0), (13.3759, 52.5163), (391_779.27, 5_820_072.34)],
        [1e-12, 4.5e-5, 1.0, 5.0, 3e7],
    ),
)
def test_positions_keep_their_distances_in_every_unit(
    offset: tuple[float, float], unit: float
) -> None:
    """Degrees, metres of UTM, and others, to 1e-6 of the distance of neighbors."""
    shape = np.random.default_rng(0).random((20, 2)).cumsum(axis=0)
    places = offset + unit * shape
    maze = Maze.from_graph(line(places.tolist()))
    for read in (maze, Maze.from_text(maze.to_text())):
        np.testing.assert_allclose(read.positions, places, rtol=0.0, atol=1e-6 * unit)
        pictured = np.linalg.norm(np.diff(read.picture, axis=0), axis=1)
        steps = np.linalg.norm(np.diff(shape, axis=0), axis=1)
        np.testing.assert_allclose(pictured, 1.5 * steps / np.median(steps), rtol=1e-4)
    np.testing.assert_array_equal(Maze.from_text(maze.to_text()).positions, maze.positions)


def test_cells_within_edges_lie_on_short_decimals() -> None:
    maze = Maze.from_graph(networkx.Graph([(0, 1, {"length": 10})]), {0: (0, 0), 1: (1, 3)})
    assert maze.positions[4].tolist() == [0.3, 0.9]  # 0.30000000000000004 otherwise


def test_nodes_at_one_place_do_not_blow_up_the_picture() -> None:
    maze = Maze.from_graph(line([(0, 0), (0, 0), (0, 0), (0, 0), (1, 0)]))
    assert max(maze.picture_size) < 10


@pytest.mark.parametrize(("bad", "how"), [(np.nan, "positions"), (np.inf, "xy"), (-np.inf, "pos")])
def test_positions_that_are_not_finite_are_refused(bad: float, how: str) -> None:
    graph = networkx.path_graph(2)
    places = {0: (0.0, bad), 1: (1.0, 0.0)}
    for node, (x, y) in places.items():
        graph.nodes[node].update({"xy": {"x": x, "y": y}, "pos": {"pos": (x, y)}}.get(how, {}))
    with pytest.raises(ValueError, match="finite"):
        Maze.from_graph(graph, places if how == "positions" else None)


def test_positions_without_a_finite_distance_are_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        Maze.from_graph(line([(-1.7e308, 0), (1.7e308, 0)]))


@pytest.mark.parametrize(
    ("lengths", "problem"),
    [(("2", "3", "1"), None), (("2.0", "3", "1"), None), (("2.5", "1", "1"), "length=2.5"),
     (("two", "1", "1"), "length='two'"), (("-1", "1", "1"), "length=-1"),
     (("inf", "1", "1"), "length=inf"), (("9" * 100_000, "1", "1"), "a whole number")],
)  # fmt: skip
def test_lengths_of_graphml_may_be_texts(
    lengths: tuple[str, ...], problem: str | None, tmp_path: Path
) -> None:
    """As OSMnx and others write them, with the attribute of type string."""
    graph = networkx.Graph()
    for (a, b), length in zip((("a", "b"), ("b", "c"), ("c", "a")), lengths, strict=True):
        graph.add_edge(a, b, length=length)
    path = tmp_path / "map.graphml"
    networkx.write_graphml(graph, path)
    if problem is None:
        assert pursuit.load_maze(path).distances[:3, :3].tolist() == [
            [0, 2, 1],
            [2, 0, 3],
            [1, 3, 0],
        ]
        return
    with pytest.raises(ValueError, match=problem) as caught:
        pursuit.load_maze(path)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16", "ascii"])
def test_graphml_is_read_in_the_encoding_that_it_declares(encoding: str, tmp_path: Path) -> None:
    graph = networkx.Graph([("Zürich", "Genève"), ("Genève", "Bern")])
    text = html.unescape("\n".join(networkx.generate_graphml(graph)))
    declared = encoding.removesuffix("-sig")
    path = tmp_path / "towns.graphml"
    whole = f'<?xml version="1.0" encoding="{declared}"?>\n{text}'
    path.write_bytes(whole.encode(encoding, "xmlcharrefreplace"))
    assert sorted(pursuit.load_maze(path).cell_names) == ["Bern", "Genève", "Zürich"]
    path.write_bytes(text.encode("latin-1"))  # not declared
    with pytest.raises(ValueError, match=r"towns\.graphml: not a valid \.graphml file"):
        pursuit.load_maze(path)


@pytest.mark.parametrize(
    ("words", "suffix"),
    diagonal(
        ["9" * 100_000, "-" * 100_000 + "1", "(" * 100_000, "{[]: 1}", "1" + "+1" * 100_000],
        [".edges", ".edgelist"],
    ),
)
def test_a_long_or_odd_length_in_an_edge_list_is_one_short_line(
    words: str, suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"graph{suffix}"
    path.write_text(f"a b\nb c {words}\n")
    with pytest.raises(ValueError, match=r"line 2: .*`node node length`") as caught:
        pursuit.load_maze(path)
    assert len(str(caught.value)) < 500


def test_a_long_height_of_a_map_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "long.map"
    path.write_text(f"type octile\nheight {'9' * 5000}\nwidth 1\nmap\n.\n")
    with pytest.raises(ValueError, match=r"long.map: no header"):
        pursuit.load_maze(path)


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"graph": networkx.Graph}, "give a networkx graph"),
        ({"graph": None}, "give a networkx graph"),
        ({"graph": [(0, 1)]}, "give a networkx graph"),
        ({"graph": np.eye(99)}, "give a networkx graph"),
        ({"positions": np.eye(99)}, "give a dict"),
        ({"positions": 5}, "positions=5"),
        ({"positions": [(0, 0), (1, 1)]}, "give a dict"),
        ({"positions": {0: (0, 0), 1: (1,)}}, "pairs of numbers"),
        ({"positions": {0: "ab", 1: "cd"}}, "pairs of numbers"),
        ({"length": 3}, "length=3"),
        ({"length": ["length"]}, "length="),
        ({"num_moves": "6"}, "num_moves='6'"),
        ({"num_moves": 2.0}, "num_moves=2.0"),
        ({"start": [0]}, r"the mark \[0\]"),
        ({"start": {}}, "the mark {}"),
        ({"goals": [[1]]}, r"the mark \[1\]"),
        ({"goals": 3}, "goals=3"),
    ],
)
def test_wrong_arguments_are_refused(settings: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem) as error:
        Maze.from_graph(**{"graph": networkx.path_graph(2), **settings})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("given", [[], None, 3, ("5x5-test",), {}])
def test_a_suite_has_a_name(given: Any) -> None:
    with pytest.raises(ValueError, match="give the name of a suite"):
        pursuit.load_suite(given)
    with pytest.raises(ValueError, match="give the name of a maze"):
        load_mazes(7)  # type: ignore[arg-type]


def slow_roads(height: int, width: int, random: np.random.Generator) -> Any:
    """The graph of `roads` with the whole graph searched for every street."""
    graph: Any = networkx.DiGraph()
    cells = list(product(range(height), range(width)))
    random.uniform(-0.25, 0.25, (len(cells), 2))
    graph.add_nodes_from(f"{r},{c}" for r, c in cells)
    for r, c in cells:
        for down, right in ((0, 1), (1, 0), (1, 1)):
            if r + down < height and c + right < width:
                a, b = f"{r},{c}", f"{r + down},{c + right}"
                if down + right < 2 or random.random() < DIAGONAL:
                    steps = 2 if random.random() < DIAGONAL else 1
                    graph.add_edge(a, b, length=steps)
                    graph.add_edge(b, a, length=steps)
    streets = [edge for edge in graph.edges if edge[0] < edge[1]]
    for index in random.permutation(len(streets)).tolist():
        (a, b), draw = streets[index], random.random()
        gone = [(a, b), (b, a)] if draw < REMOVED else [(a, b)] if draw < REMOVED + ONE_WAY else []
        kept = [(*edge, graph.edges[edge]) for edge in gone]
        graph.remove_edges_from(gone)
        if gone and not networkx.is_strongly_connected(graph):
            graph.add_edges_from(kept)
    return graph


@pytest.mark.parametrize("seed", range(8))
def test_roads_are_those_of_a_search_of_the_whole_graph(seed: int) -> None:
    height, width = 3 + seed, 11 - seed
    known = Maze.from_graph(slow_roads(height, width, np.random.default_rng(seed)))
    maze = pursuit.generate_graph("roads", height, width, seed=seed)
    assert maze.cell_names == known.cell_names
    np.testing.assert_array_equal(maze.neighbors, known.neighbors)


def test_the_shipped_graph_is_generated_again() -> None:
    again = pursuit.generate_graph("roads", 8, 8, seed=0)
    shipped = pursuit.load_maze("roads-8x8")
    np.testing.assert_array_equal(again.neighbors, shipped.neighbors)
    np.testing.assert_array_equal(again.positions, shipped.positions)


def test_large_roads_are_generated_or_refused_before(monkeypatch: pytest.MonkeyPatch) -> None:
    assert pursuit.generate_graph("roads", 50, 50).num_cells > 2500
    monkeypatch.setattr(networkx.DiGraph, "add_node", None)  # nothing may be made
    with pytest.raises(ValueError, match="directed graph of at least 4,225 cells; at most 4096"):
        pursuit.generate_graph("roads", 65, 65)


def test_equal_names_are_found_in_linear_time() -> None:
    """Counted instead of timed: no name is compared with all others."""
    compared = 0

    class Name(str):
        def __eq__(self, other: object) -> bool:
            nonlocal compared
            compared += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    class Node:
        def __init__(self, name: str) -> None:
            self.name = name

        def __str__(self) -> str:
            return Name(self.name)

    graph = networkx.path_graph([Node(f"{i}") for i in range(2000)] + [Node("1999")])
    with pytest.raises(ValueError, match="two nodes are named '1999'"):
        Maze.from_graph(graph)
    assert compared < 10_000


TEXT_PATHS = ("maze.txt", "maze", "maze.maze", "maze.TXT", "5x5.txt")


@pytest.mark.parametrize(
    ("name", "what"), diagonal(TEXT_PATHS, [["4x4"], ["--generate", "roads", "--height", "3"]])
)
def test_what_is_written_is_read_again(
    name: str, what: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    main(["maze", *what, "--out", name])
    main(["maze", name, "--out", "again.txt"])
    assert Path(name).read_text() == Path("again.txt").read_text()


@pytest.mark.parametrize(
    "name",
    [
        *(f"m{suffix}" for suffix in (*SUFFIXES, *OTHER_GRAPHS, MOVINGAI, ".MAP")),
        "5x5",
        "roads-8x8",
    ],
)
def test_what_would_not_be_read_again_is_not_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main(["maze", "3x3", "--out", name])
    assert caught.value.code == 2 and "give a .txt file" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
