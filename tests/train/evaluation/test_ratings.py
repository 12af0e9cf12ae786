"""Ratings against closed forms and other solvers, and known cycles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from train.evaluation.ratings import (
    best_response_cycle,
    elo_ratings,
    nash_average,
    pairwise_wins,
    preference_cycle,
)


def results_of(strengths: Any, seed: int = 0, games: int = 2000) -> Any:
    """[players, 1, games]: logistic noise, so that i beats k with Elo's probability exactly."""
    rng = np.random.default_rng(seed)
    scale = 400 / np.log(10)
    noise = rng.gumbel(scale=scale, size=(len(strengths), 1, games))
    return np.asarray(strengths)[:, None, None] + noise


def test_pairwise_wins_count_ties_half() -> None:
    wins = pairwise_wins(np.array([[[3, 1]], [[2, 1]]]))
    assert wins[0, 1].tolist() == [1.0, 0.5] and wins[1, 0].tolist() == [0.0, 0.5]


def test_elo_recovers_the_strengths_it_was_drawn_from() -> None:
    strengths = np.array([1300.0, 1500.0, 1550.0, 1650.0])
    ratings = elo_ratings(pairwise_wins(results_of(strengths)))
    for strength, (rating, low, high) in zip(strengths, ratings, strict=True):
        assert low <= rating <= high and abs(rating - strength) < 25
        assert low - 15 < strength < high + 15


def test_elo_of_two_is_the_closed_form() -> None:
    wins = np.zeros((2, 2, 100))
    wins[0, 1, :75] = wins[1, 0, 75:] = 1.0
    (one, _, _), (two, _, _) = elo_ratings(wins)
    assert one - two == pytest.approx(400 * np.log10(75.5 / 25.5), abs=1e-3)
    assert one + two == pytest.approx(3000)


def test_ratings_of_constant_winners_are_finite_and_of_one_player_1500() -> None:
    wins = np.zeros((2, 2, 10))
    wins[0, 1] = 1.0
    assert 1500 < elo_ratings(wins)[0][0] < 3000
    assert elo_ratings(np.full((1, 1, 3), 0.5)) == [(1500.0, 1500.0, 1500.0)]


def test_nash_averaging_is_uniform_over_copies_and_ignores_weak_opponents() -> None:
    rock = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
    average = nash_average(rock)
    assert average.value == pytest.approx(0, abs=1e-9)
    assert average.column == pytest.approx([1 / 3] * 3, abs=1e-3)
    twice = nash_average(rock[:, [0, 0, 1, 2]])
    assert twice.row == pytest.approx([1 / 6, 1 / 6, 1 / 3, 1 / 3], abs=2e-3)
    prey = nash_average(np.c_[rock, [-5.0, -5.0, -5.0]])
    assert prey.row[3] == pytest.approx(0, abs=1e-3)


def test_nash_averages_are_equilibria_of_random_games() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        payoff = rng.integers(0, 4, size=rng.integers(1, 6, size=2)).astype(float)
        average = nash_average(payoff)
        assert (average.column @ payoff).max() <= average.value + 1e-4
        assert (payoff @ average.row).min() >= average.value - 1e-4


def test_cycles_are_found_where_there_is_no_pure_equilibrium() -> None:
    rock = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
    cycle = best_response_cycle(rock, np.zeros((3, 3)))
    assert len(cycle) == 6 and {role for role, _ in cycle} == {"chaser", "evader"}
    for (role, number), (other, answer) in zip(cycle, [*cycle[1:], cycle[0]], strict=True):
        assert role != other
        if role == "chaser":
            assert rock[number, answer] == rock[number].max()
        else:
            assert rock[answer, number] == rock[:, number].min()
    assert best_response_cycle(np.array([[3.0, 2.0], [5.0, 4.0]]), np.zeros((2, 2))) == []
    # Within the doubts of the entries nothing speaks against an equilibrium.
    assert best_response_cycle(rock, np.full((3, 3), 1.1)) == []


def test_players_of_one_role_can_form_a_cycle() -> None:
    strengths = np.array([[3, 1, 2], [1, 2, 3], [2, 3, 1]])  # each better against two of three
    results = np.repeat(strengths[:, :, None], 50, axis=2)
    cycle = preference_cycle(pairwise_wins(results))
    assert sorted(cycle) == [0, 1, 2]
    wins = pairwise_wins(results).mean(axis=2)
    assert all(wins[a, b] > 0.5 for a, b in zip(cycle, [*cycle[1:], cycle[0]], strict=True))
    assert preference_cycle(pairwise_wins(results_of([1200.0, 1500.0, 1800.0]))) == []


def test_a_shortest_cycle_is_found_among_many_players() -> None:
    """Each of 101 is better than the next 50: more circles than can ever be listed."""
    players = np.arange(101)
    better = (players[None, :] - players[:, None]) % 101 <= 50
    wins = np.repeat(better[:, :, None], 20, axis=2).astype(float)
    wins[players, players] = 0.5
    cycle = preference_cycle(wins)
    assert len(cycle) == len(set(cycle)) == 3
    assert all(better[a, b] for a, b in zip(cycle, [*cycle[1:], cycle[0]], strict=True))
