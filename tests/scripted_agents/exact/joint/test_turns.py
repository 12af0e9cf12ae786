"""The chase in turns, against plain sets."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_mazes import connected_maze, seeds
from test_equilibrium import RING, TWO_PARTS

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze, load_maze
from scripted_agents import (
    cop_number,
    solve_in_turns,
)
from scripted_agents.exact.graphs.cops_and_robbers import NEVER

# -- the chase in turns ----------------------------------------------------------------------------


def times_by_rounds(maze: Maze, chasers: int, stay: bool) -> dict[Any, int | None]:
    """Moves of the chasers until capture, or None, from plain sets: all that is known, again."""
    size, actions = maze.num_cells, 5 if stay else 4
    ways = [sorted({int(x) for x in maze.neighbors[cell, :actions]}) for cell in range(size)]
    known: dict[Any, int | None] = {
        (team, evader): 0 if evader in team else None
        for team in itertools.product(range(size), repeat=chasers)
        for evader in range(size)
    }
    time = 0
    while True:
        time += 1
        lost = {
            (team, evader)
            for team, evader in known
            if evader in team or all(known[team, f] is not None for f in ways[evader])
        }
        fresh = [
            (team, evader)
            for (team, evader), when in known.items()
            if when is None
            and any((t, evader) in lost for t in itertools.product(*(ways[c] for c in team)))
        ]
        if not fresh:
            return known
        for place in fresh:
            known[place] = time


@settings(max_examples=15, deadline=None)
@given(st.builds(connected_maze, seeds, st.integers(1, 3), st.integers(2, 3)), st.booleans())
def test_the_chase_in_turns_agrees_with_plain_sets(maze: Maze, stay: bool) -> None:
    for chasers in (1, 2):
        solved = solve_in_turns(maze, chasers, stay)
        assert solved.times is not None
        for (team, evader), when in times_by_rounds(maze, chasers, stay).items():
            assert solved.times[(*team, evader)] == (NEVER if when is None else when)
            assert solved.chasers_win[(*team, evader)] == (when is not None)


def test_three_chasers_agree_with_plain_sets() -> None:
    solved = solve_in_turns(RING, 3)
    assert solved.times is not None
    for (team, evader), when in times_by_rounds(RING, 3, True).items():
        assert solved.times[(*team, evader)] == (NEVER if when is None else when)


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(2, 12), st.integers(2, 12))
def test_one_chaser_is_enough_on_every_tree(seed: int, height: int, width: int) -> None:
    maze = generate_maze("wilson", height=height, width=width, seed=seed)
    assert maze.num_loops == 0 and cop_number(maze) == 1


def test_cop_numbers_that_are_known() -> None:
    assert cop_number(RING) == 2  # a cycle of eight
    assert cop_number(load_maze("2x2-open")) == 2  # a cycle of four
    assert cop_number(load_maze("7x7-open")) == 2  # every grid (Maamoun and Meyniel, 1987)
    assert cop_number(TWO_PARTS) == 2  # one for each part
    assert cop_number(RING, most=1) is None


def test_what_does_not_fit_into_memory_is_refused() -> None:
    with pytest.raises(ValueError, match="bytes of memory"):
        solve_in_turns(load_maze("15x15"), 4)
    with pytest.raises(ValueError, match="at least 1"):
        solve_in_turns(RING, 0)
