"""Mixtures of snapshots, against an opponent that infers the drawn snapshot."""

from __future__ import annotations

import json
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from self_play_runs import make_run, sides_of_task

from pursuit import load_maze, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    TablePolicy,
    best_response,
    mean_over_starts,
    solve_chase,
)
from train.evaluation.self_play_text import describe_exploitability
from train.self_play.mixtures import mixture_bounds, mixture_nash_conv
from train.self_play.pool import Member

SMALL, DISCOUNT = load_maze("2x2"), 0.6


def one_of_each(seed: int, count: int, maze: Any) -> Any:
    """[count, own, other, action]: policies that know what they do in every state."""
    rng = np.random.default_rng(seed)
    return np.eye(4)[rng.integers(4, size=(count, maze.num_cells, maze.num_cells))]


def best_against_mixture(tables: Any, role: str, left: int) -> float:
    """What an opponent of a mixture of such policies gets, who sees what they do and infers who.

    By plain recursion over the state and those that the games so far leave possible.
    """
    far = range(SMALL.num_cells)

    @cache
    def value(own: int, other: int, who: tuple[int, ...], left: int) -> float:
        """Summed over those that are still possible; `own` is the cell of the mixture's side."""
        if left == 0:
            return 0.0
        found = []
        for action in range(4):
            mine, total = int(SMALL.neighbors[other, action]), 0.0
            after: dict[int, list[int]] = {}
            for one in who:
                took = int(tables[one, own, other].argmax())
                after.setdefault(int(SMALL.neighbors[own, took]), []).append(one)
            for cell, alike in after.items():
                total += len(alike)
                met = cell == mine or (cell == other and mine == own)
                if not met:
                    total += DISCOUNT * value(cell, mine, tuple(alike), left - 1)
            found.append(total)
        return max(found) if role == "chaser" else min(found)

    everybody = tuple(range(len(tables)))
    starts = [(a, b) for a, b in product(far, far) if a != b]
    return sum(value(a, b, everybody, left) for a, b in starts) / len(starts) / len(tables)


def exploited(maze: Any, role: Any, table: Any, discount: float) -> float:
    """What the best response to a table gains over the value of the game."""
    responder: Any = "evader" if role == "chaser" else "chaser"
    best = best_response(responder, maze, table, None, discount).values
    gain = best - solve_chase(maze, discount).values
    return mean_over_starts(gain if role == "chaser" else -gain, maze)


@pytest.mark.parametrize("role", ["chaser", "evader"])
@pytest.mark.parametrize("seed", range(4))
def test_a_mixture_lies_between_its_bounds(role: Any, seed: int) -> None:
    task, tables = make_task("chase", maze=SMALL), one_of_each(seed, 3, SMALL)
    game = mean_over_starts(solve_chase(SMALL, DISCOUNT).values, SMALL)
    sign = 1.0 if role == "chaser" else -1.0
    exact = sign * (best_against_mixture(tables, role, 30) - game)
    lower, upper = mixture_bounds(sides_of_task(task, DISCOUNT), role, tables, np.full(3, 1 / 3))
    assert lower - 1e-5 <= exact <= upper + 1e-5
    each = [exploited(SMALL, role, table, DISCOUNT) for table in tables]
    assert upper == pytest.approx(np.mean(each), abs=1e-6)
    # Of one table there is nothing to infer: the recursion is the best response.
    one = sign * (best_against_mixture(tables[-1:], role, 30) - game)
    bounds = mixture_bounds(sides_of_task(task, DISCOUNT), role, tables[-1:], np.ones(1))
    assert bounds == pytest.approx((one, one), abs=1e-5)


def test_mixtures_of_equal_policies_are_that_policy() -> None:
    maze = load_maze("5x5-tree")
    task = make_task("chase", maze=maze)
    pair = {
        "chaser": AStarChaser(0.1).action_probabilities(maze),
        "evader": AStarEvader(0.3).action_probabilities(maze),
    }
    kept = {
        role: [Member(str(n), TablePolicy(maze, table), False) for n in range(4)]
        for role, table in pair.items()
    }
    expected = sum(exploited(maze, role, table, 0.95) for role, table in pair.items())
    for shares in (None, {role: {"1": 0.25, "3": 0.75} for role in pair}):
        found = mixture_nash_conv(sides_of_task(task), kept, shares)
        assert found == pytest.approx((expected, expected))
    # A mixture with other policies than snapshots has no bounds here.
    other = {role: {"1": 0.5, "astar": 0.5} for role in pair}
    assert mixture_nash_conv(sides_of_task(task), kept, other) is None
    assert mixture_nash_conv(sides_of_task(task), {"chaser": kept["chaser"]}, None) is None


@pytest.mark.parametrize("sampling", ["nash-mixture", "latest"])
def test_results_have_them_where_mixtures_converge(tmp_path: Path, sampling: str) -> None:
    given: dict[str, Any] = {"sampling": sampling, "frames": 10_240}
    run = make_run(tmp_path / "pair", task={"maze": "3x3-tree"}, **given)
    run.train()
    content = run.results(10)
    run.lock.release()
    text = " ".join(describe_exploitability(content))
    assert ("NashConv of drawing from" in text) == ("mixture_nash_conv" in content)
    assert ("mixture_nash_conv" in content) == (sampling != "latest")
    if sampling != "latest":
        lower, upper = content["mixture_nash_conv"]
        assert 0.0 <= lower <= upper
        assert content["evaluation"]["played_nash_conv"] == lower
        written = json.loads((tmp_path / "pair" / "results.json").read_text())
        assert written["mixture_nash_conv"] == [lower, upper]
