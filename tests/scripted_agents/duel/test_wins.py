"""Who does better than whom in duels: against plain enumeration, and as Elo counts it."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from pursuit import load_maze
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    duel_wins,
    evaluate_exactly,
    mean_over_starts,
)

MAZE = load_maze("5x5-tree")


def ends(maze: Any, chaser: Any, evader: Any, own: int, other: int, left: int) -> Any:
    """[left] chance that the game is over after each number of steps, by plain recursion."""
    found = np.zeros(left)
    if left == 1:
        return np.ones(1)  # cut
    for one, two in product(range(4), range(4)):
        chance = chaser[own, other, one] * evader[other, own, two]
        mine, theirs = maze.neighbors[own, one], maze.neighbors[other, two]
        if mine == theirs or (mine == other and theirs == own):
            found[0] += chance
        elif chance:
            found[1:] += chance * ends(maze, chaser, evader, mine, theirs, left - 1)
    return found


def test_whoever_captures_sooner_wins_as_plain_enumeration_counts_it() -> None:
    maze, horizon = load_maze("2x2-tree"), 3
    rng = np.random.default_rng(0)
    chasers, evaders = rng.dirichlet(np.ones(4), size=(2, 2, 4, 4))
    pairs = [(own, other) for own, other in product(range(4), range(4)) if own != other]
    sooner = np.zeros((2, 2))
    for evader, (own, other) in product(evaders, pairs):
        of = [ends(maze, chaser, evader, own, other, horizon) for chaser in chasers]
        for i, k in product(range(2), range(2)):
            for first, second in product(range(horizon), range(horizon)):
                won = 1.0 if first < second else 0.5 * (first == second)
                sooner[i, k] += of[i][first] * of[k][second] * won / (2 * len(pairs))
    wins, steps = duel_wins("chaser", maze, chasers, evaders, horizon)
    assert wins == pytest.approx(sooner)
    for i, j in product(range(2), range(2)):
        values = evaluate_exactly(maze, chasers[i], evaders[j], horizon)
        assert steps[i, j] == pytest.approx(mean_over_starts(values, maze))
    # The other side's steps are the same, and of two players each wins what the other does not.
    back, turned = duel_wins("evader", maze, evaders, chasers, horizon)
    assert turned == pytest.approx(steps.T) and back + back.T == pytest.approx(1.0)


def test_tables_of_four_and_of_five_actions_are_not_compared() -> None:
    four, five = (AStarChaser(0.2).action_probabilities(MAZE, stay) for stay in (False, True))
    evader = AStarEvader(0.2).action_probabilities(MAZE)
    with pytest.raises(ValueError, match=r"tables over 4 and 5 actions; .*give all of them"):
        duel_wins("chaser", MAZE, [four, five], [evader])


def test_who_moves_first_and_how_far_apart_they_start_is_as_in_the_game() -> None:
    chasers = [AStarChaser(epsilon).action_probabilities(MAZE) for epsilon in (0.0, 0.5)]
    evader = AStarEvader(0.2).action_probabilities(MAZE)
    _, steps = duel_wins("chaser", MAZE, chasers, [evader], 50, "chasers_first", 4)
    for number, chaser in enumerate(chasers):
        values = evaluate_exactly(MAZE, chaser, evader, 50, move_order="chasers_first")
        assert steps[number, 0] == pytest.approx(mean_over_starts(values, MAZE, 4))


def test_chasers_that_err_more_and_more_do_worse() -> None:
    chasers = [AStarChaser(e).action_probabilities(MAZE) for e in (0.0, 0.25, 0.5, 1.0)]
    evaders = [AStarEvader(e).action_probabilities(MAZE) for e in (0.2, 1.0)]
    wins, _ = duel_wins("chaser", MAZE, chasers, evaders)
    assert (wins[np.triu_indices(4, 1)] > 0.51).all() and (np.diff(wins.mean(axis=1)) < 0.0).all()
