"""NashConv of whole games: that of duels, 0 in equilibria, and never negative."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pursuit.mazes.maze import load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    TablePolicy,
    joint_nash_conv,
    solve_chase,
    solve_joint,
    solve_joint_game,
)
from train.evaluation.exploitability import duel_nash_conv, exploitability, team_exploitability


def test_of_duels_it_is_that_of_pairs_of_cells() -> None:
    task = make_task("chase", maze="3x3", rewards="zero_sum")
    maze = task.mazes[0]
    chaser, evader = AStarChaser(0.2), AStarEvader(0.3)
    found = joint_nash_conv(task, {"chaser": chaser, "evader": evader}, None, 0.95)
    tables = (chaser.action_probabilities(maze), evader.action_probabilities(maze))
    assert found.nash_conv == pytest.approx(duel_nash_conv(maze, *tables), rel=1e-6)
    gains = exploitability(maze, *tables).gains
    assert [*found.gains.values()] == pytest.approx([gains["chaser"], gains["evader"]], rel=1e-6)
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


def test_zero_sum_of_two_chasers_is_the_game_of_the_team() -> None:
    task = make_task("chase", maze="3x3", num_chasers=2, rewards="zero_sum")
    chaser, evader = AStarChaser(0.3), AStarEvader(0.3)
    pair = {"chaser": chaser, "evader": evader}
    found = joint_nash_conv(task, pair, None, 0.95, sides=True)
    known = team_exploitability(task, chaser, evader, 0.95)
    assert found.returns["evader"] == pytest.approx(known.mean_value, rel=1e-6)
    assert found.gains["chaser"] == pytest.approx(
        known.mean_evader + known.mean_value - known.mean_game_value, rel=1e-6
    )
    assert found.nash_conv == pytest.approx(known.nash_conv, rel=1e-6)


@pytest.mark.parametrize(("chasers", "evaders"), [(2, 1), (1, 2), (2, 2)])
def test_zero_sum_is_so_between_one_chaser_and_all_evaders_and_between_sides(
    chasers: int, evaders: int
) -> None:
    task = make_task(
        "chase", maze="2x2", num_chasers=chasers, num_evaders=evaders, rewards="zero_sum"
    )
    pair = {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.3)}
    each = joint_nash_conv(task, pair, 20, 0.9).returns
    one = [paid for name, paid in each.items() if name not in ("chaser_1",)]
    assert sum(one) == pytest.approx(0.0, abs=1e-9)
    sides = joint_nash_conv(task, pair, 20, 0.9, sides=True).returns
    assert sides["chaser"] == pytest.approx(each["chaser_0"])
    assert sides["chaser"] + sides["evader"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
def test_the_game_of_a_duel_is_that_of_pairs_of_cells(order: Any) -> None:
    task = make_task("chase", maze="3x3", rewards="zero_sum", move_order=order)
    known = solve_chase(task.mazes[0], 0.95, move_order=order)
    found = solve_joint_game(task, 0.95)
    # The chaser pays what the evader is paid: its lead is twice what it pays.
    np.testing.assert_allclose(found.values, -2.0 * known.values.ravel(), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", ["race", "heist"])
def test_nobody_gains_against_an_equilibrium_of_a_race_or_a_heist(name: str) -> None:
    task = make_task(name, maze="2x2" if name == "heist" else "3x3", num_goals=2)
    game = solve_joint_game(task, 0.9)
    found = joint_nash_conv(task, game.policies, None, 0.9, objective="lead")
    first, second = task.agent_names
    assert found.returns[first] == pytest.approx(game.mean_over_starts, abs=1e-6)
    assert found.returns[second] == pytest.approx(-game.mean_over_starts, abs=1e-6)
    assert found.best[first] == pytest.approx(game.mean_over_starts, abs=1e-6)
    assert found.nash_conv == pytest.approx(0.0, abs=1e-5)
    if name == "race":  # the seats are alike
        assert game.mean_over_starts == pytest.approx(0.0, abs=1e-6)
    simulator = Simulator(task, 2000, 2**62, auto_restart=False)
    actions, paid = np.zeros((2000, 2), dtype=np.int32), np.zeros(2000)
    for step in range(60):
        simulator.act([game.policies[first], game.policies[second]], actions)
        simulator.step(actions)
        paid += 0.9**step * (simulator.rewards[:, 0] - simulator.rewards[:, 1])
    assert abs(paid.mean() - game.mean_over_starts) < 4.0 * paid.std() / 2000**0.5 + 1e-2


def test_what_is_no_game_of_two_is_refused() -> None:
    with pytest.raises(ValueError, match="3 agents"):
        solve_joint_game(make_task("race", maze="3x3", num_runners=3))
    with pytest.raises(ValueError, match="discount 1"):
        solve_joint_game(make_task("race", maze="3x3"), 1.0)
    with pytest.raises(ValueError, match=r"discount 0\.999999999; .* at most 0\.9995"):
        solve_joint_game(make_task("race", maze="3x3"), 1 - 1e-9)
    with pytest.raises(ValueError, match="47,177,249 states"):
        solve_joint_game(make_task("race", maze="7x7"))


@pytest.mark.parametrize(
    "options",
    [{"slip": {"evader": 0.3}}, {"capture": "adjacent"}, {"slip": 0.1, "stay_action": True}],
)
def test_the_value_of_a_duel_with_options_is_that_of_the_lead(options: dict[str, Any]) -> None:
    task = make_task("chase", maze="3x3-tree", rewards="zero_sum", **options)
    game = solve_joint_game(task, 0.9)
    chaser, evader = (game.policies[name] for name in ("chaser_0", "evader_0"))
    found = team_exploitability(task, chaser, evader, 0.9)
    # The lead of the chaser is twice minus the discounted steps.
    assert found.mean_game_value == pytest.approx(-game.mean_over_starts / 2, abs=1e-7)
    assert found.nash_conv == pytest.approx(0.0, abs=1e-6)


def test_the_value_for_two_chasers_is_that_of_the_rules_of_the_task() -> None:
    teams: dict[str, Any] = {"maze": "3x3", "num_chasers": 2, "num_evaders": 1}
    pair = AStarChaser(0.5), AStarEvader(0.5)
    plain = solve_chase(load_maze("3x3"), 0.9, num_chasers=2).mean_over_starts
    rarely = team_exploitability(Task(**teams, slip=1e-12), *pair, 0.9)
    assert rarely.mean_game_value == pytest.approx(plain, abs=1e-7)
    near = team_exploitability(Task(**teams, capture="adjacent", n_catch=2), *pair, 0.9)
    assert near.mean_game_value > 2.0 * plain  # both must be near, and the maze has a loop
