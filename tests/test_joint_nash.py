"""NashConv of whole games: that of duels, 0 in equilibria, and never negative."""

from __future__ import annotations

import numpy as np
import pytest

from pursuit.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    TablePolicy,
    joint_nash_conv,
    solve_chase,
    solve_joint,
)
from train.evaluation.exploitability import nash_conv


def test_of_duels_it_is_that_of_pairs_of_cells() -> None:
    task = make_task("chase", maze="3x3", rewards="zero_sum")
    maze = task.mazes[0]
    chaser, evader = AStarChaser(0.2), AStarEvader(0.3)
    found = joint_nash_conv(task, {"chaser": chaser, "evader": evader}, None, 0.95)
    tables = (chaser.action_probabilities(maze), evader.action_probabilities(maze))
    assert found.nash_conv == pytest.approx(nash_conv(maze, *tables), rel=1e-6)
    game = solve_chase(maze, 0.95)
    optimal = {
        "chaser": TablePolicy(maze, game.chaser_policy),
        "evader": TablePolicy(maze, game.evader_policy),
    }
    assert joint_nash_conv(task, optimal, None, 0.95).nash_conv == pytest.approx(0.0, abs=1e-5)


def test_runners_that_answer_each_other_reach_an_equilibrium_or_say_what_they_would_gain() -> None:
    task = make_task("race", maze="2x2", num_goals=2)
    policies = {"runner_0": NearestGoalRunner(0.2), "runner_1": NearestGoalRunner(0.2)}
    found = joint_nash_conv(task, policies, 100)
    gains = list(found.gains.values())
    assert min(gains) > 0.0 and gains[0] == pytest.approx(gains[1])  # the seats are alike
    best = solve_joint(task, "runner_0", policies, None, 0.9, "return")
    answered = joint_nash_conv(task, {**policies, "runner_0": best.policy}, None, 0.9)
    assert answered.gains["runner_0"] == pytest.approx(0.0, abs=1e-7)
    assert answered.nash_conv >= -1e-7


def test_a_side_gains_no_less_than_its_agents() -> None:
    task = make_task("chase", maze="3x3", num_chasers=2, rewards="zero_sum")
    pair = {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.3)}
    each, sides = joint_nash_conv(task, pair, 60), joint_nash_conv(task, pair, 60, sides=True)
    assert set(each.gains) == set(task.agent_names) and set(sides.gains) == {"chaser", "evader"}
    assert sides.gains["evader"] == pytest.approx(each.gains["evader_0"])
    assert sides.gains["chaser"] >= max(each.gains["chaser_0"], each.gains["chaser_1"])
    assert np.isfinite(sides.nash_conv)
