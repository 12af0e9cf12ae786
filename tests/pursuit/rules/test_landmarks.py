"""Searches by landmarks: all first moves of shortest paths, against breadth-first search."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_mazes import any_maze

from pursuit.compilation.compiled import compiled
from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.rules.distances import NO_MOVES, moves_by_landmarks
from pursuit.rules.layout import Search, world_of
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import AStarChaser
from scripted_agents.agents import kernels, scripted


@compiled
def search_from_each(
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    maze: int,
    landmarks: Any,
    cells: Any,
    scratch: Any,
    room: int,
    found: Any,
) -> None:
    """Fill `found` [cells, 2] with what `moves_by_landmarks` says of every cell of a maze."""
    world = world_of(mazes, neighbors, facts, tables)
    search, closed = Search(scratch[0], scratch[1]), Search(scratch[2], scratch[3])
    for own in range(found.shape[0]):
        found[own] = moves_by_landmarks(
            world, maze, landmarks, own, cells, len(cells), search, closed, room
        )


def breadth_first_moves(maze: Maze, cells: list[int]) -> list[int]:
    """The first moves to the nearest of `cells` from every cell, in plain Python."""
    away, waiting, after = dict.fromkeys(cells, 0), deque(cells), maze.neighbors.tolist()
    while waiting:
        cell = waiting.popleft()
        for other in after[cell]:
            if other not in away:
                away[other] = away[cell] + 1
                waiting.append(other)
    return [
        sum(
            1 << action
            for action in range(4)
            if own in away and away[after[own][action]] == away[own] - 1
        )
        for own in range(maze.num_cells)
    ]


def searched(
    mazes: tuple[Maze, ...], number: int, cells: list[int], room: int
) -> NDArray[np.int64]:
    arrays = lay_out(mazes)
    size = len(arrays.neighbors)
    scratch = np.full((4, max(size, room)), -1, dtype=np.int32)
    found = np.zeros((mazes[number].num_cells, 2), dtype=np.int64)
    landmarks = scripted.landmarks_of(arrays, kernels.CHASER)
    sought = np.array(cells, dtype=np.int32)
    search_from_each(*arrays, number, landmarks, sought, scratch, room, found)
    assert (scratch[[0, 2]] == -1).all()  # nothing is left for the next search
    return found


@settings(max_examples=150, deadline=None)
@given(any_maze, st.lists(st.integers(0, 10**6), min_size=0, max_size=6), st.integers(1, 60))
def test_they_find_all_first_moves_or_say_that_room_was_short(
    maze: Maze, drawn: list[int], room: int
) -> None:
    """Sources that are equally near, in one cell, out of reach, or where the agent stands."""
    if maze.num_cells <= 10:
        return
    cells = [number % maze.num_cells for number in drawn]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pursuit.mazes.maze_arrays.MAX_TABLE_CELLS", 10)
        lay_out.cache_clear()
        expected = breadth_first_moves(maze, cells)
        whole = searched((maze,), 0, cells, 5 * maze.num_cells)
        short = searched((maze,), 0, cells, min(room, maze.num_cells))
    lay_out.cache_clear()
    assert whole[:, 0].tolist() == expected
    assert all(mask in (NO_MOVES, moves) for (mask, _), moves in zip(short, expected, strict=True))


@pytest.mark.parametrize("loops", [0.0, 0.1, 0.5, 1.0])
def test_in_large_mazes_side_by_side_too(loops: float) -> None:
    mazes = tuple(generate_maze("prim", 70, loops=loops, seed=seed) for seed in (1, 2))
    cells = np.random.default_rng(0).integers(4900, size=12).tolist()
    for number, maze in enumerate(mazes):
        found = searched(mazes, number, cells, 4900)
        assert found[:, 0].tolist() == breadth_first_moves(maze, cells)
        assert found[:, 1].mean() < 4900 / 8  # they look at little of the maze


def test_distances_beyond_a_uint16_are_bounded_all_the_same() -> None:
    """A corridor that winds through 300 x 300 cells: saturated bounds are bounds."""
    rows = ["+" + "-+" * 300]
    for row in range(300):
        rows.append("|" + "  " * 299 + " |")
        gap = 299 if row % 2 == 0 else 0
        rows.append("+" + "".join(" +" if at == gap and row < 299 else "-+" for at in range(300)))
    maze = Maze.from_text("\n".join(rows))
    landmarks = scripted.landmarks_of(lay_out((maze,)), kernels.CHASER)
    assert landmarks.max() == 65534
    cells = [100, 40_000, 88_000]
    games = Simulator(Task(maze, num_chasers=3, num_evaders=3), 1)
    expected = breadth_first_moves(maze, cells)
    for own in ([0, 20_000, 89_999], [64_000, 64_001, 150]):
        games.positions[0] = own + cells
        actions = np.zeros((1, 6), dtype=np.int32)
        games.act([AStarChaser()] * 3 + [None] * 3, actions)
        for chaser, cell in enumerate(own):
            assert expected[cell] >> actions[0, chaser] & 1
