"""Averages and mixtures of snapshots, against an opponent that infers the drawn snapshot."""

from __future__ import annotations

import json
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from self_play_runs import make_run

from pursuit import load_maze, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    best_response,
    mean_over_starts,
    solve_chase,
)
from train.self_play.averages import Average, averages, describe_averages, nash_convs

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
    snapshots = {role: {str(n): table for n, table in enumerate(tables)}}
    found = {one.what: one for one in averages(task, DISCOUNT, snapshots)}
    game = mean_over_starts(solve_chase(SMALL, DISCOUNT).values, SMALL)
    sign = 1.0 if role == "chaser" else -1.0
    exact = sign * (best_against_mixture(tables, role, 30) - game)
    mixed = found["all mixed"]
    assert mixed.lower - 1e-5 <= exact <= mixed.upper + 1e-5 and mixed.snapshots == 3
    # Of one alone there is nothing to infer: the recursion is the best response.
    alone = sign * (best_against_mixture(tables[-1:], role, 30) - game)
    assert found["last snapshot"].lower == pytest.approx(alone, abs=1e-5)
    assert found["last snapshot"].lower == found["last snapshot"].upper
    told = [exploited(SMALL, role, table, DISCOUNT) for table in tables]
    assert mixed.upper == pytest.approx(np.mean(told), abs=1e-6)


def test_averages_of_equal_policies_are_that_policy() -> None:
    maze = load_maze("5x5-tree")
    task = make_task("chase", maze=maze)
    pair = {
        "chaser": AStarChaser(0.1).action_probabilities(maze),
        "evader": AStarEvader(0.3).action_probabilities(maze),
    }
    snapshots = {role: {str(n): table for n in range(4)} for role, table in pair.items()}
    shares = {role: {"1": 0.25, "3": 0.75} for role in pair}
    found = averages(task, 0.95, snapshots, shares)
    assert {one.what for one in found} >= {"last snapshot", "all mixed", "later half averaged"}
    for one in found:
        alone = exploited(maze, one.role, pair[one.role], 0.95)
        assert one.lower == pytest.approx(alone) == one.upper
    assert sum(one.what == "Nash mixture" and one.snapshots == 2 for one in found) == 2
    # A mixture that gives something to others than snapshots is not one of these.
    few = averages(task, 0.95, snapshots, {"chaser": {"1": 0.5, "astar": 0.5}})
    assert not any(one.what == "Nash mixture" for one in few)
    convs = nash_convs(found)
    assert list(convs) == list(dict.fromkeys(one.what for one in found))
    assert convs["last snapshot"][0] == pytest.approx(
        sum(o.lower for o in found if o.what == "last snapshot")
    )


def test_words() -> None:
    assert describe_averages({"last": (1.25, 1.25), "all mixed": (0.5, 0.75)}) == (
        "NashConv of the snapshots in the pools: last 1.250; all mixed 0.500 to 0.750"
    )
    assert nash_convs([Average("chaser", "last", 1, 0.0, 0.0)]) == {}


def test_results_have_them(tmp_path: Path) -> None:
    sampling: dict[str, Any] = {"sampling": "double-oracle", "frames": 10_240}
    run = make_run(tmp_path / "pair", task={"maze": "3x3-tree"}, **sampling)
    run.train()
    content = run.results(10)
    run.lock.release()
    convs = content["averages"]
    assert convs["last snapshot"][1] == pytest.approx(content["evaluation"]["nash_conv"], rel=1e-3)
    assert {"Nash mixture", "all mixed", "later half averaged"} <= convs.keys()
    assert all(-1e-6 <= lower <= upper for lower, upper in convs.values())
    told = describe_averages(convs)
    assert "NashConv of the snapshots in the pools: last" in told and "Nash mixture" in told
    written = json.loads((tmp_path / "pair" / "results.json").read_text())["averages"]
    assert written == {name: list(bounds) for name, bounds in convs.items()}
