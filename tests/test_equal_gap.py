"""Errors at an equal gap: the maps, their likeness and its test, and the recipe in short."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from pursuit import load_maze
from pursuit.policy import Policy
from scripted_agents import AStarChaser, TablePolicy, best_response, duel_regret
from train.recipes import equal_gap
from train.recipes.equal_gap import alike, by_permutation, errors_of, exact_gap, within_less_between
from train.runs.parts import contest_of
from train.settings.task import TaskSettings


def test_maps_are_what_regret_says_and_nothing_of_a_best_response() -> None:
    maze = load_maze("3x3")
    contest = contest_of(TaskSettings(maze="3x3", opponent_epsilon=0.2), 5, 0)
    other = contest.opponent_table()
    optimum = contest.optimal().mean_steps
    best: Policy = TablePolicy(maze, best_response("chaser", maze, other).policy)
    assert exact_gap(contest, best, optimum) == pytest.approx(0.0, abs=1e-9)
    loss, visited = errors_of(contest, best)
    assert loss == pytest.approx(np.zeros(72), abs=1e-9) == visited
    # With far more steps to go than a game lasts, a state costs its visits times the loss.
    chaser = AStarChaser(0.3)
    own = chaser.action_probabilities(maze)
    loss, _ = errors_of(contest, chaser)
    found = duel_regret("chaser", maze, own, other)
    apart = ~np.eye(9, dtype=bool)
    assert loss == pytest.approx((found.regret / np.maximum(found.visits, 1e-300))[apart], rel=1e-4)
    gap = (found.achieved - found.optimum) / found.optimum
    assert exact_gap(contest, chaser, optimum) == pytest.approx(gap)


def test_likeness_and_its_p_by_all_ways_to_deal_out_the_labels() -> None:
    maps = [
        np.array(m, dtype=float) for m in ([1, 2, 3, 4], [1, 2, 4, 3], [4, 3, 2, 1], [4, 3, 1, 2])
    ]
    found = alike(maps)
    assert found[0, 1] == pytest.approx(0.8) and found[0, 2] == pytest.approx(-1.0)
    labels = [0, 0, 1, 1]
    difference, p = by_permutation(labels, found)
    assert difference == pytest.approx(
        0.8 - np.mean([found[0, 2], found[0, 3], found[1, 2], found[1, 3]])
    )
    dealt = [within_less_between(each, found) for each in permutations(labels)]
    assert (
        p == pytest.approx(np.mean(np.array(dealt) >= difference - 1e-12)) == pytest.approx(1 / 3)
    )


@pytest.mark.slow
def test_the_recipe_ends_its_runs_at_the_threshold_and_compares_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = "--maze 3x3 --seeds 2 --threshold 3 --frames 16384"
    equal_gap.main([*short.split(), "--out", str(tmp_path / "runs")])
    told = capsys.readouterr().out
    assert "near first, seed 3" in told and "uniform over starts: within less between" in told
    assert (tmp_path / "runs" / "report.md").read_text().count("| annealed |") >= 4
    pairs = (tmp_path / "runs" / "pairs.csv").read_text().splitlines()
    assert len(pairs) == 1 + 2 * 15
    with pytest.raises(SystemExit):
        equal_gap.main(["--seeds", "1"])
