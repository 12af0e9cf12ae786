"""Under limited sight scores stand beside what is certain, and nothing else is called optimal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from pursuit import Simulator, load_maze, make_task
from pursuit.simulator.policy import pairs_of_cells
from scripted_agents import AStarChaser, AStarEvader, RandomAgent, TablePolicy, solve_hidden_chase
from train.evaluation import hidden_contest
from train.evaluation.contest import GameContest
from train.evaluation.exploitability import exploitability
from train.evaluation.score_table import score_table
from train.evaluation.scores import UNKNOWN_GAP
from train.evaluation.self_play_metrics import limited_best_responses
from train.evaluation.self_play_text import describe_exploitability
from train.evaluation.suite_contest import SuiteContest
from train.evaluation.suite_report import summary_of
from train.networks.actor_critic import ActorCritic
from train.networks.layers import Hidden
from train.networks.numbering import QTablePolicy, StateNumbers
from train.networks.policy import MazeSeat
from train.runs.report import summary
from train.runs.single import evaluation_of


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hidden_contest, "SEARCH_SECONDS", 0.5)


def contest_for(role: str, **task: Any) -> GameContest:
    opponents: Any = {"chaser": AStarChaser(epsilon=0.6), "evader": AStarEvader(epsilon=0.2)}
    return GameContest(make_task("chase", maze="3x3", **task), role, opponents, episodes=300)


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_scores_stand_beside_the_certified_interval(role: str) -> None:
    contest = contest_for(role, view_radius={role: 1})
    assert contest.optimal() is None and contest.optimal_lengths() is None
    certificate = contest.certificate()
    assert certificate is not None and certificate.lower <= certificate.upper
    scores = {score.name: score for score in contest.baselines()}
    assert "optimal" not in scores and "optimal, full view" in scores
    certified = scores["certified"]
    assert certified.discounted_steps is not None and certified.discounted_ci95 is not None
    slack = 2.0 * certified.discounted_ci95 + 1e-9
    assert certificate.lower - slack <= certified.discounted_steps <= certificate.upper + slack
    for name in ("random", "optimal, full view"):  # tables, so exact; the random one is blind
        assert scores[name].discounted_ci95 in (0.0, None)
    blind = scores["random"].discounted_steps
    assert blind is not None
    assert blind >= certificate.lower if role == "chaser" else blind <= certificate.upper


def test_results_claim_no_optimum_that_is_none() -> None:
    contest = contest_for("chaser", view_radius={"chaser": 1})
    policy = RandomAgent()
    learned = contest.score("learned", policy)
    results = evaluation_of([learned], "greedy", contest, UNKNOWN_GAP, policy)
    found = results["evaluation"]
    assert found["optimal_steps"] is None and found["optimality_gap"] is None
    assert found["discount"] == 0.95 and found["certified_lower"] <= found["certified_upper"]
    expected = found["discounted_steps"] / found["certified_lower"] - 1.0
    assert found["certified_gap"] == pytest.approx(expected) and expected > 0.0
    objective = {"column": "mean_steps", "unit": "steps", "less_is_better": True}
    results |= {"frames": 1, "seconds": 1.0, "interrupted": False, "objective": objective}
    results["role"] = "chaser"
    page = score_table([learned], contest.certificate()).markdown()
    assert "certified optimum" in summary(results) and "discounted" in page
    assert "gap at most" in page and f"{100 * expected:+.2f} %" in page  # as on the terminal
    assert contest.objective_gap(0.95) == (None, None)
    sides = [side.name for side in contest.overlays(RandomAgent())]
    assert sides == ["chaser_0 with full view", "evader_0"]


@pytest.mark.parametrize("task", [{}, {"view_radius": {"evader": 1}}, {"view_radius": 9}])
def test_with_all_in_view_the_optimum_is_the_best_response(task: Any) -> None:
    contest = contest_for("chaser", **task)
    assert contest.optimal() is not None and contest.certificate() is None
    assert contest.score("random", RandomAgent()).discounted_steps is None


@pytest.mark.parametrize("exact", [False, True])
def test_in_suites_the_optimum_of_full_sight_is_called_that(exact: bool) -> None:
    task = make_task("chase", maze="suite:5x5-test/0-1", view_radius={"chaser": 1})
    contest = SuiteContest(task, "chaser", {"evader": AStarEvader(0.2)}, 20, exact=exact)
    assert contest.best is None and contest.optimal() is None and contest.optimal_lengths() is None
    found = contest.references()
    names = [each.name for each in found]
    limited = ["searching chaser", "belief chaser"] if not exact else []  # which are not solved
    assert names == ["random", "A* chaser", *limited, "optimal, full view"]
    assert (found[-1].steps <= found[1].steps + 1e-9).all() or not exact
    assert "optimality_gap" not in summary_of(contest, found[0])


def test_a_nash_conv_under_a_limited_view_is_called_a_bound() -> None:
    results: dict[str, Any] = {"evaluation": {"nash_conv": 1.0}, "frames": 1, "seconds": 1.0}
    assert "0 is an equilibrium" in describe_exploitability(results)[0]
    told = describe_exploitability({**results, "limited_view": True})[0]
    assert "0 is an equilibrium" not in told and "full view" in told


def test_a_table_over_states_refuses_a_seat_that_does_not_see_them() -> None:
    task = make_task("chase", maze="3x3", view_radius={"chaser": 1})
    numbers = StateNumbers(task, "chaser")
    policy = QTablePolicy(numbers, np.zeros((numbers.count, task.num_actions)))
    simulator = Simulator(task, num_games=2, seed=0)
    with pytest.raises(ValueError, match="needs full observability"):
        policy.act(simulator.view("chaser"))


def test_a_table_of_another_sight_is_not_taken_for_what_is_played() -> None:
    seeing, blind = (make_task("chase", maze="3x3", view_radius=radius) for radius in (None, 0))
    seat = MazeSeat(seeing, "chaser")
    torch.manual_seed(0)
    policy = seat.policy(ActorCritic(seat.features, 4, Hidden(width=16)))
    assert contest_for("chaser").score("learned", policy).exact
    contest = GameContest(blind, "chaser", {"evader": AStarEvader(epsilon=0.2)}, episodes=300)
    found = contest.score("learned", policy)
    played = policy.distribution(blind, pairs_of_cells(blind, blind.mazes[0], "chaser"), 0)
    table = TablePolicy(blind.mazes[0], played.reshape(9, 9, 4))
    assert not found.exact
    exact = contest.score("the same as a table", table)
    assert exact.exact and abs(found.mean_steps - exact.mean_steps) <= 2.0 * found.ci95


def test_best_responses_with_limited_views_are_bounds_of_nash_conv() -> None:
    maze, pair = load_maze("3x3"), {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.3)}
    tables = [policy.action_probabilities(maze) for policy in pair.values()]
    full = limited_best_responses(make_task("chase", maze=maze), pair)
    exact = exploitability(maze, *tables, discount=0.95).nash_conv
    assert full["nash_conv"] == pytest.approx((exact, exact))
    hidden = make_task("chase", maze=maze, view_radius={"chaser": 1})
    found = limited_best_responses(hidden, pair)
    proven = solve_hidden_chase(maze, tables[1], 1, width=1e-3)
    assert found["against_evader"] == pytest.approx((proven.lower, proven.upper), rel=1e-3)
    assert found["against_evader"][0] > full["against_evader"][0]  # less is seen
    assert found["against_chaser"] == full["against_chaser"]  # the evader sees all
    low, high = found["nash_conv"]
    assert low <= high < exact
    told = describe_exploitability(
        {"evaluation": {}, "limited_best_responses": found, "frames": 1, "seconds": 1.0}
    )
    assert (
        told[2] == f"NashConv with these views: {low:.3f} to {high:.3f} discounted steps, proven."
    )
