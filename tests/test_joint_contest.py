"""Contests of teams and rivals stand beside exact optima, or say why there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pursuit.policy import Policy
from pursuit.task import make_task
from scripted_agents import AStarChaser, AStarEvader, NearestGoalRunner, RandomAgent, solve_joint
from train.commands.scores import print_scores, print_whole_game
from train.evaluation.contest import GameContest
from train.evaluation.scores import optimality_gap, return_regret

RACE = GameContest(
    make_task("race", maze="3x3", num_goals=2), "runner", {"runner": NearestGoalRunner(0.2)}, 2000
)
HEIST = GameContest(
    make_task("heist", maze="3x3", num_goals=2), "evader", {"chaser": AStarChaser(0.2)}, 2000
)


def test_a_race_has_a_gap_in_steps_and_a_regret_in_returns() -> None:
    optimum, paid = RACE.optimal(), RACE.optimal_return()
    assert optimum is not None and paid is not None and RACE.best_of_steps is not None
    alone = solve_joint(RACE.task, "runner_0", RACE.opponents)  # not both runners as one
    assert alone.mean_over_starts == RACE.best_of_steps.mean_over_starts
    assert optimum.mean_steps == pytest.approx(alone.mean_over_starts, rel=0.02)
    lengths = RACE.optimal_lengths()
    assert lengths is not None and lengths.mean() == optimum.mean_steps
    played = RACE.score("optimal", RACE.best_of_steps.policy)
    assert abs(played.mean_steps - optimum.mean_steps) < 0.1
    for policy in (RandomAgent(), NearestGoalRunner()):
        score = RACE.score("scripted", policy)
        gap, regret = optimality_gap(score, optimum), return_regret(score, paid)
        assert gap is not None and gap > 0.0 and regret is not None and regret > 0.0


def test_a_heist_has_no_gap_in_steps() -> None:
    best = HEIST.optimal_return()
    assert HEIST.optimal() is None and best is not None
    names = [score.name for score in HEIST.baselines()]
    assert names == ["random", "A* evader", "optimal return"]
    response = HEIST.best_of_returns
    assert response is not None and best.mean_return is not None
    returns = HEIST.returns(response.policy)
    assert abs(returns.mean() - best.mean_return) < 4.0 * returns.std() / len(returns) ** 0.5


def test_each_of_several_evaders_is_judged_by_its_own_life() -> None:
    task = make_task("chase", maze="3x3-tree", num_evaders=2, max_steps=40)
    opponents: dict[str, Policy] = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
    contest = GameContest(task, "evader_1", opponents, 1000)
    optimum = contest.optimal()
    assert optimum is not None and contest.optimal_return() is None
    lengths, _ = contest.play(contest.best_of_steps.policy)  # type: ignore[union-attr]
    assert abs(lengths.mean() - optimum.mean_steps) < 4.0 * lengths.std() / len(lengths) ** 0.5
    assert optimum.mean_steps > contest.score("A*", AStarEvader(0.2)).mean_steps


def test_a_game_that_is_too_large_says_how_large_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    contest = replace(RACE, most_work=10_000)
    assert contest.optimal() is None and contest.optimal_return() is None
    print_whole_game(contest)
    told = capsys.readouterr().out
    assert "distinct states: 3,645" in told and "no exact optimum: 3,645 states" in told
    print_whole_game(RACE)
    assert "mean optimum over all starts" in capsys.readouterr().out
    print_scores(RACE.baselines())
    assert "below the best" in capsys.readouterr().out


def test_other_references_stay_as_they_are() -> None:
    duel = GameContest(make_task("chase", maze="3x3"), "chaser", {"evader": AStarEvader(0.2)}, 100)
    lone = GameContest(make_task("maze", maze="3x3"), "runner", {}, 100)
    for contest in (duel, lone):
        assert contest.best_of_steps is None or contest is duel
        names = [score.name for score in contest.baselines()]
        assert names.count("optimal") == 1 and "optimal return" not in names
    assert np.isfinite(lone.optimal().mean_steps)  # type: ignore[union-attr]
