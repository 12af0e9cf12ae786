"""Graphs as mazes, against networkx: cells, distances, text, files, errors, and games on them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import networkx
import numpy as np
import pytest
from conformance import check_parallel_env
from diagonals import diagonal
from PIL import Image

import pursuit
from pursuit import chase_v0
from pursuit.mazes.graph_generation import GRAPHS
from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.rendering.animation import save_animation
from pursuit.rendering.rendering import AgentMark, Scene
from pursuit.tasks.task import Task, make_task


@pytest.mark.parametrize("name", ["2x2", "5x5", "7x7-tree", "9x9-open"])
def test_a_maze_and_its_graph_have_equal_moves(name: str) -> None:
    maze = pursuit.load_maze(name)
    graph = Maze.from_graph(maze.to_graph(), name=name)
    np.testing.assert_array_equal(graph.neighbors, maze.neighbors)
    np.testing.assert_array_equal(graph.distances, maze.distances)
    assert graph.num_loops == maze.num_loops and not graph.is_directed


@pytest.mark.parametrize("kind", GRAPHS)
def test_distances_are_those_of_networkx(kind: str) -> None:
    maze = pursuit.generate_graph(kind, 5, 6, seed=3)
    graph = maze.to_graph()
    known = dict(networkx.all_pairs_shortest_path_length(graph))
    for a, one in enumerate(maze.cell_names):
        row = [known[one][other] for other in maze.cell_names]
        np.testing.assert_array_equal(maze.distances[a], row)
        np.testing.assert_array_equal(maze.distances_to(a), maze.distances[:, a])
    degrees = {"torus": 4, "eight": 8, "hexagonal": 6}
    assert maze.num_moves == degrees.get(kind, maze.degrees.max())
    assert Maze.from_text(maze.to_text()) == maze


def test_lengths_are_steps_and_opposite_edges_share_their_cells() -> None:
    graph = networkx.DiGraph()
    graph.add_edge("a", "b", length=3)
    graph.add_edge("b", "a", length=3)
    graph.add_edge("b", "c")
    graph.add_edge("c", "a", length=2)
    maze = Maze.from_graph(graph)
    assert maze.cell_names == ("a", "b", "c", "a-b:1", "a-b:2", "c-a")
    assert maze.is_directed
    assert maze.distances[:3, :3].tolist() == [[0, 3, 4], [3, 0, 1], [2, 5, 0]]
    middle = maze.cell_names.index("a-b:1")
    assert sorted(maze.neighbors[middle, :-1].tolist()) == [0, 4]  # an agent can turn


def test_files_of_other_programs_are_read(tmp_path: Path) -> None:
    edges = tmp_path / "small.edgelist"
    edges.write_text("# a comment\na b\nb c 2\n")
    assert pursuit.load_maze(edges).distances.max() == 3
    for wrong in ("a b 1 2\n", "a\n", "a b far\n"):
        edges.write_text(wrong)
        with pytest.raises(ValueError, match=r"small.edgelist: line 1: .*`node node length`"):
            pursuit.load_maze(edges)
    edges.write_text("a b 2\nb a 5\nb c {'length': 3.0}\nc a {}\n")  # the shortest counts
    assert pursuit.load_maze(edges).distances[:3, :3].tolist() == [[0, 2, 1], [2, 0, 3], [1, 3, 0]]
    graph = networkx.petersen_graph()
    for missing, problem in (("no.graphml", "no such file"), ("a.gml", "graphs are read from")):
        (tmp_path / "a.gml").write_text("graph []")
        with pytest.raises(ValueError, match=problem):
            pursuit.load_maze(tmp_path / missing)
    networkx.write_graphml(graph, tmp_path / "petersen.graphml")
    assert pursuit.load_maze(tmp_path / "petersen.graphml").num_cells == 10
    saved = tmp_path / "graph.txt"
    saved.write_text(Maze.from_graph(graph, start=0, goals=[3, 4]).to_text())
    maze = pursuit.load_maze(saved)
    assert (maze.start_mark, maze.goal_marks) == (0, (3, 4))
    assert pursuit.load_maze("roads-8x8").is_directed


def test_actions_are_in_the_order_of_the_neighbors() -> None:
    rng = np.random.default_rng(0)
    for case in range(40):
        kind: Any = (networkx.Graph, networkx.DiGraph, networkx.MultiGraph)[case % 3]
        graph = kind(networkx.cycle_graph(8))
        for a, b in rng.integers(8, size=(12, 2)).tolist():
            if a != b:
                graph.add_edge(a, b, length=int(rng.integers(1, 3)))
        maze = Maze.from_graph(graph)
        for node in range(8):
            for action, there in enumerate(graph.adj[node]):
                cell = maze.neighbors[node, action]  # of a long edge its first cell
                assert cell == there or maze.cell_names[cell] in (
                    f"{node}-{there}",
                    f"{there}-{node}",
                )


def loop() -> Any:
    return networkx.Graph([("a", "a"), ("a", "b")])


@pytest.mark.parametrize(
    ("graph", "settings", "problem"),
    [
        (networkx.Graph(), {}, "without nodes"),
        (networkx.Graph([(0, 1), (2, 3)]), {}, "no path from '0' to '2'"),
        (networkx.DiGraph([(0, 1), (1, 2)]), {}, "no path from '1' to '0'"),
        (loop(), {}, "an edge from 'a' to itself; remove it"),
        (networkx.Graph([(1, "1")]), {}, "two nodes are named '1'"),
        (networkx.star_graph(32), {}, "32 neighbors; at most 31"),
        (networkx.path_graph(3), {"num_moves": 1}, "num_moves=1; a node has 2"),
        (networkx.Graph([(0, 1, {"length": 1.5})]), {}, "length=1.5; a length is a whole number"),
        (networkx.Graph([(0, 1, {"length": 0})]), {}, "length=0"),
        (networkx.path_graph(3), {"positions": {0: (0, 0)}}, "no entry for the node 1"),
        (networkx.path_graph(2), {"positions": {0: 1, 1: 2}}, "pairs of numbers"),
        (
            networkx.Graph([("a", "b", {"length": 2}), ("b", "a-b")]),
            {},
            "two nodes are named 'a-b'",
        ),
        (
            networkx.DiGraph(
                [("a", "b", {"action": 0}), ("a", "c", {"action": 0}), ("b", "a"), ("c", "a")]
            ),
            {},
            "two edges from 'a' have one action",
        ),
        (
            networkx.Graph([(0, 1, {"action": "north"})]),
            {},
            "action='north'; an action is a number",
        ),
        (networkx.Graph([(0, 1, {"action": -1})]), {}, "action=-1; an action is a number"),
        (
            networkx.Graph([(0, 1, {"length": 10**9})]),
            {},
            "1,000,000,001 cells, .* most 200,000",
        ),
        (networkx.path_graph(3), {"goals": 1}, "goals=1; give a list of nodes"),
        (networkx.path_graph(3), {"start": 7}, "the mark 7 is no node"),
        (networkx.path_graph(3), {"start": 1, "goals": [1]}, "at one node"),
        (
            networkx.cycle_graph(MAX_TABLE_CELLS + 1, create_using=networkx.DiGraph),
            {},
            "a directed graph of 4097 cells",
        ),
    ],
)
def test_impossible_graphs_are_refused(graph: Any, settings: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        Maze.from_graph(graph, **settings)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("graph of 0 cells and 2 moves\n", "without cells"),
        ('graph of 2 cells and 1 moves\n0 "a" 0 0: 1\n1 "b" x 0: 0\n', "line 3: .*numbers"),
        ('graph of 2 cells and 1 moves\n0 "a" 0 0: 1\n7 "b" 0 0: 0\n', "line 3"),
        ('graph of 2 cells and 1 moves\n0 "a" 0 0: 1\n1 "b" 0 0: 5\n', "line 3: neighbors"),
        ('graph of 2 cells and 1 moves\n0 "a" 0 0: 1\n1 "a" 0 0: 0\n', "two nodes are named 'a'"),
        ('graph of 2 cells and 2 moves\n0 "a" 0 0: 1 0\n1 "b" 0 0: 0\n', "line 3: .*give 2"),
        ('graph of 3 cells and 1 moves\n0 "a" 0 0: 1\n1 "b" 0 0: 0\n', "says 3 cells, but 2"),
        ('graph of 2 cells and 5 moves\n0 "a" 0 0: 1\n1 "b" 0 0: 0\n', "line 2: .*give 5"),
        ('graph of 2 cells and 0 moves\n0 "a" 0 0:\n1 "b" 0 0:\n', "line 1: 0 moves"),
        ('graph of two nodes\n0 "a" 0 0: 1\n1 "b" 0 0: 0\n', "line 1: 'graph of two nodes'"),
        ('graph of 2 cells and 1 moves, drawn\n0 "a" 0 0: 1\n1 "b" 0 0: 0\n', "line 1: "),
        ('graph of 2 cells and 1 moves\n0 "a" 0 0 S: 1\n1 "b" 0 0 S: 0\n', "line 3: a second"),
        ('graph of 2 cells and 1 moves\n0 "a" 0 0 SG: 1\n1 "b" 0 0: 0\n', "line 2"),
        ('graph of 2 cells and 1 moves\n0 "a" nan 0: 1\n1 "b" 0 0: 0\n', "line 2: .*finite"),
        ('graph of 2 cells and 1 moves\n0 "a" 0 0: 1\n1 "b" 0 -inf: 0\n', "line 3: .*finite"),
        (f'graph of 2 cells and 1 moves\n0 "a" 0 0: {"9" * 5000}\n1 "b" 0 0: 0\n', "line 2"),
        (f'graph of 2 cells and 1 moves\n{"0" * 9999} "a" 0 0: 1\n1 "b" 0 0: 0\n', "line 2"),
        (f'graph of 2 cells and 1 moves\n0 "a" {"9" * 999} 0: 1\n1 "b" 0 0: 0\n', "line 2"),
    ],
)
def test_damaged_texts_are_refused(text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        Maze.from_text(text)


def test_what_needs_rows_and_columns_is_refused() -> None:
    maze = Maze.from_graph(networkx.petersen_graph(), name="petersen")
    with pytest.raises(ValueError, match="petersen: a graph has no height"):
        _ = maze.height
    for encoding in ("planes", "window", "walls"):
        with pytest.raises(ValueError, match="shows rows and columns, and petersen is a graph"):
            chase_v0.parallel_env(maze=maze, observation=encoding)
    with pytest.raises(ValueError, match="line_of_sight: petersen is a graph"):
        make_task("chase", maze=maze, line_of_sight=True)
    with pytest.raises(ValueError, match="Manhattan distance"):
        make_task("chase", maze=maze, rewards="distance")
    with pytest.raises(ValueError, match="all mazes of a task need the same number"):
        make_task("chase", maze=[maze, pursuit.load_maze("3x3")])
    same = Maze.from_graph(networkx.petersen_graph(), num_moves=4)
    assert make_task("chase", maze=[same, pursuit.load_maze("3x3")]).num_actions == 4


@pytest.mark.parametrize(
    ("observation", "stay"), diagonal(["index", "one_hot", "positions", "cells"], [False, True])
)
def test_environments_on_graphs_conform(observation: str, stay: bool) -> None:
    maze = pursuit.generate_graph("eight", 4, 4)
    env = chase_v0.parallel_env(
        maze=maze, observation=observation, stay_action=stay, num_chasers=2, view_radius=2
    )
    check_parallel_env(env)
    assert env.action_space("chaser_0").n == 8 + stay


@pytest.mark.parametrize(
    ("kind", "size", "problem"),
    [("torus", 1000, "1,000,000 cells"), ("geometric", 400, "distances needs .* bytes")],
)
def test_graphs_that_are_too_large_are_not_generated(kind: str, size: int, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        pursuit.generate_graph(kind, size, size)


def test_a_step_follows_the_edges() -> None:
    maze = pursuit.generate_graph("hexagonal", 4, 5)
    task = Task(maze=maze, num_chasers=1, num_evaders=1, stay_action=True)
    sim = pursuit.Simulator(task, num_games=512, seed=0)
    sim.reset()
    random = np.random.default_rng(0)
    for _ in range(20):
        before, actions = sim.positions.copy(), random.integers(7, size=(512, 2))
        sim.step(actions)
        playing = ~sim.terminated & ~sim.truncated
        after = maze.neighbors[before, actions]
        np.testing.assert_array_equal(sim.positions[playing], after[playing])
        met = after[:, 0] == after[:, 1]
        swapped = (after[:, 0] == before[:, 1]) & (after[:, 1] == before[:, 0])
        np.testing.assert_array_equal(sim.terminated, met | swapped)


def test_pictures_show_nodes_and_names() -> None:
    maze = pursuit.load_maze("roads-8x8")
    scene = Scene(maze, (AgentMark("chaser_0", 3), AgentMark("evader_0", 9, False)), (5,), 2, 9)
    names = maze.cell_names
    assert scene.text().splitlines() == [
        f"chaser_0 at {names[3]}",
        f"evader_0 at {names[9]} (captured)",
        f"goal at {names[5]}",
        "step 2 / 9",
    ]
    image = scene.draw(size=300)
    assert max(image.shape[:2]) <= 300 + 40 and len(np.unique(image.reshape(-1, 3), axis=0)) > 20


def test_suites_of_graphs_are_generated_from_their_seeds() -> None:
    test = pursuit.load_suite("roads-5x5-test")
    assert len(test) == 200 and {maze.num_moves for maze in test} == {6}
    assert test[17] == pursuit.load_maze("suite:roads-5x5-test/017")
    assert test[17].name == "roads-5x5-test/017"
    splits = [set(pursuit.load_suite(f"roads-5x5-{split}")) for split in ("train", "test")]
    assert len(splits[0]) == 1000 and not splits[0] & splits[1]
    task = make_task("chase", maze="suite:roads-5x5-test/0-9")
    assert len(task.mazes) == 10 and task.num_actions == 6


def test_the_pictures_of_all_graphs_have_one_size(tmp_path: Path) -> None:
    mazes = [*pursuit.load_suite("roads-5x5-test/0-5"), pursuit.generate_graph("hexagonal", 3, 9)]
    scenes = [Scene(maze, (AgentMark("chaser_0", 0),), (), 0, 9) for maze in mazes]
    save_animation(tmp_path / "a.gif", scenes)
    with Image.open(tmp_path / "a.gif") as image:
        frames: int = image.n_frames  # type: ignore[attr-defined]
        assert image.size == (480, 510) and frames == len(scenes)
    with pytest.raises(ValueError, match=r"a picture of \d+x\d+ after pictures of 480x510"):
        save_animation(
            tmp_path / "b.gif", [scenes[0], Scene(pursuit.load_maze("7x7"), (), (), 0, 9)]
        )
