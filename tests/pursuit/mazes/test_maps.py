"""Maps of other projects: conversion of squares, and invalid maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pursuit.mazes.maze import load_maze

MAP = """type octile
height 4
width 5
map
@@@@@
@..S@
@.TG@
@W..@
"""


def test_a_map_has_cells_where_it_is_passable(tmp_path: Path) -> None:
    path = tmp_path / "small.map"
    path.write_text(MAP)
    maze = load_maze(path)
    assert maze == load_maze(str(path)) and maze.name == str(path)
    drawn = ["#####", "#   #", "# # #", "##  #"]
    assert [line[1::2] for line in maze.to_text().splitlines()[1::2]] == drawn
    # No wall stands between two cells.
    rows, columns = maze.rows.astype(int), maze.columns.astype(int)
    near = np.abs(rows[:, None] - rows) + np.abs(columns[:, None] - columns) == 1
    joined = np.zeros((maze.num_cells, maze.num_cells), dtype=bool)
    joined[np.arange(maze.num_cells)[:, None], maze.neighbors[:, :4]] = True
    assert (joined & ~np.eye(maze.num_cells, dtype=bool) == near).all()


def test_the_width_may_come_first(tmp_path: Path) -> None:
    path = tmp_path / "turned.map"
    path.write_text(MAP.replace("height 4\nwidth 5", "width 5\nheight 4"))
    assert path.read_text() != MAP
    (tmp_path / "small.map").write_text(MAP)
    assert load_maze(path).to_text() == load_maze(tmp_path / "small.map").to_text()
    path.write_text(MAP.replace("width 5", "height 4"))
    with pytest.raises(ValueError, match="no header"):
        load_maze(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("@@\n..\n", "no header"),
        (MAP.replace("height 4", "height 3"), "4 rows, but the header says height 3"),
        (MAP.replace("@..S@", "@..x@"), "line 6: unknown terrain 'x'"),
        (MAP.replace("@..S@", "@..S"), "line 6: 4 characters, but the header says width 5"),
        ("type octile\nheight 0\nwidth 0\nmap\n", "the map has no cells"),
    ],
)
def test_other_maps_are_refused(text: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.map"
    path.write_text(text)
    with pytest.raises(ValueError, match=problem):
        load_maze(path)
