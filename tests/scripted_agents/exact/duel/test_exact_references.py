"""Shortest paths and shortest tours agree with independent algorithms."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_mazes import any_maze, connected_maze, random_maze, seeds, small_maze

from pursuit.mazes.maze import Maze
from pursuit.rules import UNREACHABLE
from scripted_agents.exact.tours import tour
from scripted_agents.exact.tours.tour import shortest_path

CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
TWO_PARTS = Maze.from_text("+-+-+-+\n|   | |\n+-+-+-+")


# -- shortest paths --------------------------------------------------------------------------------


def check_path(maze: Maze, path: list[int], start: int, goal: int) -> None:
    assert (path[0], path[-1]) == (start, goal)
    for cell, after in itertools.pairwise(path):
        assert after != cell and after in maze.neighbors[cell]


@settings(deadline=None)
@given(any_maze, seeds)
def test_paths_are_as_short_as_the_distances_say(maze: Maze, seed: int) -> None:
    start, goal = np.random.default_rng(seed).integers(maze.num_cells, size=2).tolist()
    distance = maze.distances_from(start)[goal]
    if distance == UNREACHABLE:
        with pytest.raises(ValueError, match="no path connects the cells"):
            shortest_path(maze, start, goal)
    else:
        path = shortest_path(maze, start, goal)
        assert len(path) == distance + 1
        check_path(maze, path, start, goal)


@pytest.mark.slow
def test_a_path_is_shortest_on_a_million_cells() -> None:
    maze = random_maze(0, 1000, 1000, 0.7, 0.05)
    distances = maze.distances_from(maze.num_cells // 2)
    far = int(np.argmax(np.where(distances == UNREACHABLE, -1, distances)))
    path = shortest_path(maze, far, maze.num_cells // 2)
    assert len(path) == distances[far] + 1 > 500
    check_path(maze, path, far, maze.num_cells // 2)


def test_a_path_names_a_cell_that_is_not_in_the_maze() -> None:
    with pytest.raises(ValueError, match="cell 5; the cells are 0 to 4"):
        shortest_path(CORRIDOR, 0, 5)
    assert shortest_path(CORRIDOR, 2, 2) == [2]


# -- tours -----------------------------------------------------------------------------------------


def walk(maze: Maze, start: int, order: tuple[int, ...]) -> int:
    return sum(int(maze.distances[a, b]) for a, b in itertools.pairwise((start, *order)))


@settings(deadline=None)
@given(small_maze, seeds, st.integers(0, 6))
def test_held_karp_equals_trying_every_order(maze: Maze, seed: int, num_goals: int) -> None:
    start, *goals = np.random.default_rng(seed).integers(maze.num_cells, size=num_goals + 1)
    shortest = min(walk(maze, start, order) for order in itertools.permutations(goals))
    found = tour.shortest_tour(maze, start, goals)
    assert found.length == shortest == walk(maze, start, found.order)
    assert set(found.order) == set(goals) and len(found.order) == len(set(goals))
    assert tour.tour_length(maze, start, goals) == shortest
    padded = np.array([[-1, *goals, -1]])
    assert tour.tour_lengths(maze, [start], padded).tolist() == [shortest]


def test_more_goals_than_are_solved_are_refused() -> None:
    maze = connected_maze(1, 12, 12)
    refused = pytest.raises(ValueError, match="19 goals; shortest tours are exact for up to 18")
    with refused:
        tour.shortest_tour(maze, 0, range(1, 20))
    with refused:
        tour.tour_lengths(maze, [0], [range(1, 20)])
    with refused:
        tour.expected_tour_length(maze, 19)


def test_tours_need_no_table_of_distances() -> None:
    room = Maze(np.ones((70, 70), bool), np.ones((69, 70), bool), np.ones((70, 69), bool))
    assert tour.tour_length(room, 0, [69, 4899, 4830]) == 3 * 69
    assert tour.tour_lengths(room, [0, 0], [[69, -1], [-1, -1]]).tolist() == [69, 0]
    sampled = tour.expected_tour_length(room, 1, samples=400)
    assert not sampled.exact and abs(sampled - 2 * 70 / 3) < 2 * sampled.ci95


def placements(num_cells: int, num_goals: int) -> Iterator[tuple[int, tuple[int, ...]]]:
    for goals in itertools.combinations(range(num_cells), num_goals):
        yield from ((start, goals) for start in range(num_cells) if start not in goals)


@settings(max_examples=20, deadline=None)
@given(small_maze, st.integers(1, 3))
def test_the_expected_tour_is_the_mean_over_all_placements(maze: Maze, num_goals: int) -> None:
    if num_goals >= maze.num_cells:
        return
    lengths = [
        min(walk(maze, start, order) for order in itertools.permutations(goals))
        for start, goals in placements(maze.num_cells, num_goals)
    ]
    expected = tour.expected_tour_length(maze, num_goals)
    assert expected == pytest.approx(np.mean(lengths), abs=1e-12)
    assert (expected.exact, expected.ci95, expected.samples) == (True, 0.0, len(lengths))


def test_the_expected_tour_of_a_corridor_is_its_closed_form() -> None:
    assert tour.expected_tour_length(CORRIDOR, 1) == pytest.approx((5 + 1) / 3)
    # All cells but the start are goals: the way to the nearer end, then to the other.
    all_others = tour.expected_tour_length(CORRIDOR, 4)
    assert abs(all_others - (4 + 5 + 6 + 5 + 4) / 5) < 2 * all_others.ci95


def test_a_sampled_interval_covers_the_exact_mean_95_times_in_100(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    maze = connected_maze(2, 6, 6)
    exact = tour.expected_tour_length(maze, 3)
    monkeypatch.setattr(tour, "MAX_ENUMERATED_PLACEMENTS", 0)
    estimates = [tour.expected_tour_length(maze, 3, samples=300, seed=s) for s in range(200)]
    assert not any(estimate.exact for estimate in estimates)
    assert 180 <= sum(abs(estimate - exact) <= estimate.ci95 for estimate in estimates) <= 199


def test_states_are_counted_as_formula_3_2_counts_them() -> None:
    counted = sum(len(list(placements(6, goals))) for goals in (1, 2, 3))
    assert tour.num_states(6, 3) == counted
    assert tour.num_placements(25, 3) == 2300 * 22 and tour.num_placements(1, 0) == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tour.tour_length(TWO_PARTS, 0, [2]), "start 0 and the goal 2"),
        (lambda: tour.tour_length(CORRIDOR, 0, [9]), "cell 9; the cells are"),
        (lambda: tour.tour_lengths(TWO_PARTS, [0, 0], [[1], [2]]), "placement 1: no path"),
        (lambda: tour.tour_lengths(CORRIDOR, [0], [[5]]), "goals holds 5; the cells are 0 to 4"),
        (lambda: tour.tour_lengths(CORRIDOR, [-1], [[4]]), "starts holds -1"),
        (lambda: tour.tour_lengths(CORRIDOR, [0], [4]), "give .placements. and"),
        (lambda: tour.tour_lengths(CORRIDOR, [0], [[0.5]]), "cells are integers"),
        (lambda: tour.expected_tour_length(CORRIDOR, 5), "num_goals=5; 5 cells hold"),
        (lambda: tour.expected_tour_length(CORRIDOR, 0), "num_goals=0"),
        (lambda: tour.expected_tour_length(CORRIDOR, 4, samples=1), "samples=1"),
        (lambda: tour.expected_tour_length(TWO_PARTS, 1), "is not connected"),
    ],
)
def test_impossible_tours_are_named(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
