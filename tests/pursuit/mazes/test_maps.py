"""Maps of other projects: what their squares become, and what is no such map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pursuit
from pursuit.mazes.maze import Maze, load_maze
from scripted_agents import shortest_path

MAP = """type octile
height 4
width 5
map
@@@@@
@..S@
@.TG@
@W..@
"""

SCENARIOS = """version 1
0\tsmall.map\t5\t4\t1\t1\t3\t2\t2.41421356
1\tsmall.map\t5\t4\t2\t3\t1\t1\t4.0
"""

GRID = """
#######
#>..#.#
#.#.#.#
#.#...#
#.###G#
#######
"""


def test_a_map_has_cells_where_it_is_passable(tmp_path: Path) -> None:
    path = tmp_path / "small.map"
    path.write_text(MAP)
    maze = pursuit.read_map(path)
    assert maze == load_maze(path) == load_maze(str(path)) and maze.name == str(path)
    drawn = ["#####", "#   #", "# # #", "##  #"]
    assert [line[1::2] for line in maze.to_text().splitlines()[1::2]] == drawn
    # No wall stands between two cells.
    rows, columns = maze.rows.astype(int), maze.columns.astype(int)
    near = np.abs(rows[:, None] - rows) + np.abs(columns[:, None] - columns) == 1
    joined = np.zeros((maze.num_cells, maze.num_cells), dtype=bool)
    joined[np.arange(maze.num_cells)[:, None], maze.neighbors[:, :4]] = True
    assert (joined & ~np.eye(maze.num_cells, dtype=bool) == near).all()


def test_scenarios_are_read_and_their_lengths_bound_ours(tmp_path: Path) -> None:
    (tmp_path / "small.map").write_text(MAP)
    (tmp_path / "small.map.scen").write_text(SCENARIOS)
    maze = pursuit.read_map(tmp_path / "small.map")
    first, second = pursuit.read_scenarios(tmp_path / "small.map.scen")
    assert first == ("small.map", 4, 5, (1, 1), (2, 3), 2.41421356)
    for each in (first, second):
        ends = [pursuit.cell_at(maze, place) for place in (each.start, each.goal)]
        assert len(shortest_path(maze, *ends)) - 1 >= each.optimal_length - 1e-9
    with pytest.raises(ValueError, match="is blocked"):
        pursuit.cell_at(maze, (0, 0))
    with pytest.raises(ValueError, match="is outside the maze"):
        pursuit.cell_at(maze, (4, 0))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("@@\n..\n", "no header"),
        (MAP.replace("height 4", "height 3"), "4 rows, and its header says height 3"),
        (MAP.replace("@..S@", "@..x@"), "line 6: unknown terrain 'x'"),
        (MAP.replace("@..S@", "@..S"), "line 6: 4 characters; its header says width 5"),
        ("type octile\nheight 0\nwidth 0\nmap\n", "a map without cells"),
    ],
)
def test_other_maps_are_refused(text: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.map"
    path.write_text(text)
    with pytest.raises(ValueError, match=problem):
        pursuit.read_map(path)
    path.write_text("version 1\n0\tsmall.map\tfive\n" if "header" in problem else "hello")
    with pytest.raises(ValueError, match=r"line 2: nine columns|begins with 'version 1'"):
        pursuit.read_scenarios(path)


def test_a_grid_of_a_benchmark_is_a_maze_with_marks() -> None:
    maze = pursuit.read_grid(GRID, "corridor")
    expected = [line.replace(">", "S").replace(".", " ") for line in GRID.split()]
    assert [line[1::2] for line in maze.to_text().splitlines()[1::2]] == expected
    assert maze.name == "corridor" and maze.start_mark == 0
    assert Maze.from_text(maze.to_text()) == maze
    assert len(shortest_path(maze, 0, maze.goal_marks[0])) - 1 == 7
    indented = "\n".join(f"    {line}" for line in GRID.split())
    assert pursuit.read_grid(indented) == maze
    assert pursuit.read_grid(GRID.replace(".", " ")) == maze


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "an empty grid"),
        ("#.#\n#.", "line 2: 2 characters where another has 3"),
        (".x.", "line 1: unknown character 'x'"),
        (">.<", "line 1: a second agent"),
        ("##", "no walkable cell"),
    ],
)
def test_other_grids_are_refused(text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        pursuit.read_grid(text)
