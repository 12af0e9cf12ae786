"""Contests of teams and rivals stand beside exact optima, or say why there is none."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import networkx
import numpy as np
import pytest

from pursuit.mazes.maze import Maze
from pursuit.reacher.task import ReacherTask
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarChaser, AStarEvader, NearestGoalRunner, RandomAgent, solve_joint
from train import settings_of, start
from train.commands.main import main
from train.commands.scores import print_scores
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.games import won_by
from train.evaluation.score_table import score_table
from train.evaluation.scores import (
    BY_GOALS,
    BY_MOST_STEPS,
    BY_RETURN,
    Score,
    optimality_gap,
    strongest_reference,
)
from train.evaluation.suite_contest import SuiteContest
from train.experiments.measures import measure_of_rows as measure_of_rows
from train.experiments.rows import read_run
from train.runs.folder import RUN, read_metrics
from train.runs.pictures import draw_learning_curve
from train.runs.report import summary

RACE = GameContest(
    make_task("race", maze="3x3", num_goals=2), "runner", {"runner": NearestGoalRunner(0.2)}, 2000
)
HEIST = GameContest(
    make_task("heist", maze="3x3", num_goals=2), "evader", {"chaser": AStarChaser(0.2)}, 2000
)


def test_a_race_has_a_gap_in_steps_and_a_regret_in_returns() -> None:
    optimum, paid = RACE.optimal(), RACE.optimal(BY_RETURN)
    assert optimum is not None and paid is not None and RACE.best_in() is not None
    alone = solve_joint(RACE.task, "runner_0", RACE.opponents)  # not both runners as one
    assert alone.mean_over_starts == RACE.best_in().mean_over_starts
    assert optimum.mean_steps == pytest.approx(alone.mean_over_starts, rel=0.02)
    lengths = RACE.optimal_lengths()
    assert lengths is not None and lengths.mean() == optimum.mean_steps
    played = RACE.score("optimal", RACE.best_in().policy)
    assert abs(played.mean_steps - optimum.mean_steps) < 0.1
    for policy in (RandomAgent(), NearestGoalRunner()):
        score = RACE.score("scripted", policy)
        gap, regret = optimality_gap(score, optimum), BY_RETURN.distance(score, paid)
        assert gap is not None and gap > 0.0 and regret is not None and regret > 0.0


def test_a_heist_has_no_gap_in_steps() -> None:
    best = HEIST.optimal(BY_RETURN)
    assert HEIST.optimal() is None and best is not None
    names = [score.name for score in HEIST.baselines()]
    assert names == ["random", "A* evader", "optimal return"]
    response = HEIST.best_in(BY_RETURN)
    assert response is not None and best.mean_return is not None
    returns = HEIST.values(response.policy)
    assert abs(returns.mean() - best.mean_return) < 4.0 * returns.std() / len(returns) ** 0.5


def test_each_of_several_evaders_is_judged_by_its_own_life() -> None:
    task = make_task("chase", maze="3x3-tree", num_evaders=2, max_steps=40)
    opponents: dict[str, Policy] = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
    contest = GameContest(task, "evader_1", opponents, 1000)
    optimum = contest.optimal()
    assert optimum is not None and contest.optimal(BY_RETURN) is None
    lengths, _ = contest.play(contest.best_in().policy)  # type: ignore[union-attr]
    assert abs(lengths.mean() - optimum.mean_steps) < 4.0 * lengths.std() / len(lengths) ** 0.5
    assert optimum.mean_steps > contest.score("A*", AStarEvader(0.2)).mean_steps


def test_a_game_that_is_too_large_says_how_large_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    contest = replace(RACE, most_work=10_000)
    assert contest.optimal() is None and contest.optimal(BY_RETURN) is None
    told = "\n".join(contest.facts())
    assert "distinct states: 3,645" in told and "no exact optimum: 3,645 states" in told
    assert "mean optimum over all starts" in "\n".join(RACE.facts())
    print_scores(RACE.baselines(), RACE)
    assert "below the best" in capsys.readouterr().out


def test_other_references_stay_as_they_are() -> None:
    duel = GameContest(make_task("chase", maze="3x3"), "chaser", {"evader": AStarEvader(0.2)}, 100)
    lone = GameContest(make_task("maze", maze="3x3"), "runner", {}, 100)
    for contest in (duel, lone):
        assert contest.best_in() is None or contest is duel
        names = [score.name for score in contest.baselines()]
        assert names.count("optimal") == 1 and "optimal return" not in names
    assert np.isfinite(lone.optimal().mean_steps)  # type: ignore[union-attr]


def test_the_floor_of_a_whole_game_is_what_the_best_by_the_rewards_loses() -> None:
    for contest, discount in ((RACE, 0.8), (HEIST, 0.8)):
        floor = contest.objective_gap(discount)
        name = contest.task.agent_names[contest.task.seat(contest.agent)]
        plan = solve_joint(contest.task, [name], contest.opponents, None, discount, "return").policy
        score = contest.score("best by the rewards", plan)
        scores = {each.name: each for each in contest.baselines()}
        paid = BY_RETURN.distance(score, scores["optimal return"])
        assert floor.missing_return is not None and floor.missing_return > -1e-9
        assert paid == pytest.approx(floor.missing_return, abs=0.06)
        assert (floor.gap is None) == (contest is HEIST)
        if floor.gap is not None:
            gap = optimality_gap(score, scores["optimal"])
            assert gap == pytest.approx(floor.gap, abs=0.03)
    # The farther it looks ahead, the nearer it is to what it is paid in the end.
    for contest in (RACE, HEIST):
        near, far = (contest.objective_gap(discount).missing_return for discount in (0.5, 0.999))
        assert near is not None and far is not None and far <= near and far < 1e-3
    assert HEIST.objective_gap(1.0) == (None, None)


def score(name: str, steps: float, paid: float | None = None) -> Score:
    return Score(name, steps, 0.1, 1.0, 100, False, mean_return=paid)


def test_whatever_is_known_there_is_a_reference() -> None:
    learned, chance = score("learned", 30.0, 1.0), score("random", 21.0, 1.2)
    scripted, seeing = score("nearest goal", 20.0, 2.0), score("searching runner", 25.0, 1.5)
    some = [chance, scripted, seeing, learned]
    found = strongest_reference(some, learned)
    assert found is not None and (found.kind, found.name) == ("best known", "nearest goal")
    assert found.distance == pytest.approx(0.5) and "best known, not proven" in found.line()
    evader = strongest_reference(some, learned, BY_MOST_STEPS)
    assert evader is not None and evader.name == "searching runner"
    fair = strongest_reference(some, learned, comparable=("searching runner",))
    assert strongest_reference(some, learned, comparable=()) is None
    assert fair is not None and fair.distance == pytest.approx(0.2)
    paid = strongest_reference(some, learned, BY_RETURN)
    assert paid is not None and (paid.name, paid.value, paid.distance) == ("nearest goal", 2.0, 1.0)
    bound = strongest_reference([*some, score("optimal, full view", 10.0)], learned)
    assert bound is not None and bound.kind == "bound" and "gap +200.00 %" in bound.line()
    exact = strongest_reference([*some, score("optimal", 15.0)], learned)
    assert exact is not None and exact.kind == "exact" and exact.distance == pytest.approx(1.0)
    lucky = strongest_reference([score("random", 5.0), *some], learned)
    assert lucky is not None and lucky.name == "random"
    assert strongest_reference([learned], learned) is None


def test_full_sight_is_a_bound_where_sight_is_limited() -> None:
    task = make_task("heist", maze="3x3", num_goals=2, view_radius="evader=1")
    limited = GameContest(task, "evader", {"chaser": AStarChaser(0.2)}, 500)
    scores = limited.baselines()
    full = next(s for s in scores if s.name == "optimal return, full view")
    whole = replace(HEIST, episodes=500).optimal(BY_RETURN)
    assert whole is not None and full.mean_return == pytest.approx(whole.mean_return)
    found = limited.reference(scores, scores[0])
    assert found is not None and (found.kind, found.unit) == ("bound", "return")
    assert found.distance > 0.0
    huge = GameContest(make_task("race", maze="9x9"), "runner", {"runner": NearestGoalRunner()}, 50)
    best = huge.reference(huge.baselines(), huge.score("random", RandomAgent()))
    assert best is not None and best.kind == "best known"
    many = make_task("maze", maze="7x7", num_goals=20)
    assert "20 goals" in str(GameContest(many, "runner", {}, 50).exact_reference.reason)


def test_a_bound_is_that_of_the_game_that_is_played() -> None:
    """Lifting the sight of one agent leaves that of the others as it was."""
    task = make_task("heist", maze="3x3", num_goals=1, view_radius="chaser=1,evader=2")
    limited = GameContest(task, "evader", {"chaser": AStarChaser(0.2)}, 100)
    full = limited.full.task
    assert not full.hides_from("evader") and full.hides_from("chaser")
    assert full.sight.limits[full.seat("chaser")] == task.sight.limits[task.seat("chaser")]


def test_suites_and_arms_say_what_their_references_are() -> None:
    mazes = ["2x2", "3x3"]
    steps = score("A* evader", 9.0), score("learned", 4.0)
    heists = SuiteContest(make_task("heist", maze=mazes, num_goals=1), "evader", {}, 20)
    assert heists.reference(steps, steps[1]) is None  # steps say nothing there
    runs = SuiteContest(make_task("maze", maze=mazes, num_goals=1), "runner", {}, 20)
    found = runs.reference([score("optimal", 2.0), steps[1]], steps[1])
    assert found is not None and (found.kind, found.distance) == ("exact", 1.0)
    arm = ArmContest(ReacherTask(joints=2, discrete_actions=True), 20)
    bound = arm.reference([score("optimal", 2.0), steps[1]], steps[1])
    assert bound is not None and bound.kind == "bound"


# -- what a contest is compared by -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "agent", "name", "less_is_better"),
    [
        ("chase", "chaser", "steps", True),
        ("chase", "evader", "steps", False),
        ("maze", "runner", "steps", True),
        ("race", "runner", "goals", False),
        ("heist", "evader", "return", False),
        ("heist", "chaser", "return", False),
    ],
)
def test_every_contest_names_its_measure(
    task: str, agent: str, name: str, less_is_better: bool
) -> None:
    one = GameContest(make_task(task, maze="3x3"), agent, {}, 10)
    many = SuiteContest(make_task(task, maze=["3x3", "3x3-open"]), agent, {}, 10)
    for contest in (one, many):
        assert (contest.measure.name, contest.measure.less_is_better) == (name, less_is_better)


def test_random_evaders_of_a_heist_rank_below_scripted_ones() -> None:
    contest = replace(HEIST, most_work=1)  # no optimum is known
    scores = contest.baselines()
    chance, scripted = scores
    assert chance.mean_steps < scripted.mean_steps  # it is caught soon
    assert contest.measure.best(scores) is scripted
    missing = contest.measure.distance(chance, scripted)
    assert missing is not None and missing > 0.0
    held = contest.reference(scores, chance)
    assert held is not None and (held.name, held.unit) == ("A* evader", "return")


def test_success_in_a_race_is_to_collect_more_goals_than_each_of_the_others() -> None:
    task = make_task("race", maze="3x3", num_goals=3)
    policies: dict[str, Policy] = {"runner_0": NearestGoalRunner(), "runner_1": RandomAgent()}
    scores = [
        GameContest(task, name, policies, 500).score(name, policy)
        for name, policy in policies.items()
    ]
    best, worst = scores
    assert best.mean_goals is not None and worst.mean_goals is not None
    assert best.mean_goals + worst.mean_goals == pytest.approx(3.0)
    assert worst.success_rate < 0.2 < 0.6 < best.success_rate
    assert best.success_rate + worst.success_rate <= 1.0


def test_a_draw_is_won_by_none() -> None:
    game = Simulator(make_task("race", maze="3x3-open", num_goals=1), auto_restart=False)
    for cells, winners in (([3, 5], [False, False]), ([3, 8], [True, False])):
        game.place(cells, [4])
        game.step([[2, 3]])
        assert game.terminated[0]
        assert [bool(won_by(game, seat)[0]) for seat in (0, 1)] == winners


@pytest.mark.parametrize("runners", [3, 7])
def test_shared_goals_are_counted_exactly(runners: int) -> None:
    """Against fractions, in races in which every runner can reach every goal in each step."""
    nodes, games, random = runners + 5, 200, np.random.default_rng(runners)
    maze = Maze.from_graph(networkx.complete_graph(nodes))
    task = Task(maze=maze, num_runners=runners, num_goals=5, stay_action=True)
    simulator = Simulator(task, games, auto_restart=False)
    simulator.place(list(range(runners)), list(range(runners, nodes)))
    to = np.array([[row.index(cell) for cell in range(nodes)] for row in maze.neighbors.tolist()])
    shares = [[Fraction(0)] * runners for _ in range(games)]
    for goal in range(runners, nodes):
        takers = random.random((games, runners)) < 0.5
        takers[:, 0] |= ~takers.any(axis=1)
        actions = to[simulator.positions, np.where(takers, goal, simulator.positions)]
        for row, taking in zip(shares, takers.tolist(), strict=True):
            for seat in np.flatnonzero(taking):
                row[seat] += Fraction(1, sum(taking))
        simulator.step(actions)
    assert simulator.terminated.all()
    for seat in range(runners):
        known = [row[seat] > max(row[:seat] + row[seat + 1 :]) for row in shares]
        assert won_by(simulator, seat).tolist() == known


def test_the_optimum_of_a_race_collects_most_goals() -> None:
    best, response = RACE.optimal(BY_GOALS), RACE.best_in(BY_GOALS)
    assert best is not None and best.mean_goals is not None and response is not None
    goals = RACE.values(response.policy)
    assert abs(goals.mean() - best.mean_goals) < 4.0 * goals.std() / len(goals) ** 0.5
    scores = RACE.baselines()
    assert all((score.mean_goals or 0.0) <= best.mean_goals + 0.03 for score in scores)
    held = RACE.reference(scores, scores[0])
    assert held is not None and (held.kind, held.name, held.unit) == (
        "exact",
        "optimal goals",
        "goals",
    )
    assert HEIST.optimal(BY_GOALS) is None
    assert replace(RACE, most_work=1).optimal(BY_GOALS) is None


@pytest.mark.parametrize(
    ("task", "role", "unit"), [("heist", "evader", "return"), ("race", "runner", "goals")]
)
def test_a_run_is_judged_by_the_measure_of_its_contest(
    task: str, role: str, unit: str, tmp_path: Path
) -> None:
    small: dict[str, Any] = {"frames": 2048, "num_games": 64, "minibatch_size": 512, "threads": 1}
    settings = settings_of(task=task, role=role, maze="3x3", num_goals=2, **small)
    run = start(RUN, settings, tmp_path)
    run.train()
    content, column = run.results(50), f"mean_{unit}"
    run.lock.release()
    assert content["objective"] == {"column": column, "unit": unit, "less_is_better": False}
    rows = read_metrics(tmp_path, column)
    assert column in rows[0]
    found = content["evaluation"]
    regret = found[f"optimal_{unit}"] - found[column]
    assert found[f"{unit}_regret"] == pytest.approx(regret)
    assert f"Learned: {unit} {found[column]:.3f}" in summary(content)
    scores = [Score(**score) for score in content["scores"]]
    assert unit in score_table(scores, measure=run.trainee.contest.measure).markdown().split("|")[2]
    row = read_run(tmp_path)[0]
    measure = measure_of_rows([row])
    assert measure.column == column and row[column] == found[column]
    draw_learning_curve(
        tmp_path / "c.png", rows, content["scores"], "", measure=run.trainee.objective
    )


@pytest.mark.parametrize(
    "task, agent, opponents, beside",
    [
        ({"num_chasers": 2}, "chaser_0", {}, " + AStarChaser(epsilon=0.2)"),
        ({"num_chasers": 3}, "chaser", {}, " + 2 × AStarChaser(epsilon=0.2)"),
        (
            {"num_chasers": 3}, "chaser_1", {"chaser_0": RandomAgent()},
            " + RandomAgent(epsilon=1) + AStarChaser(epsilon=0.2)",
        ),
        ({"num_evaders": 2}, "evader_0", {}, " + AStarEvader(epsilon=0.2)"),
        ({"num_evaders": 2}, "chaser_0", {}, ""),
        ({}, "chaser", {}, ""),
    ],
)  # fmt: skip
def test_teammates_stand_in_every_row_and_in_the_results(
    task: dict[str, int], agent: str, opponents: dict[str, Policy], beside: str
) -> None:
    others = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2), **opponents}
    contest = GameContest(make_task("chase", maze="3x3", **task), agent, others, 4)
    learned = contest.score("learned", RandomAgent())
    table = score_table([*contest.baselines(), learned], None, contest.measure, contest.beside)
    rows = [next(iter(cells)) for cells in table.cells()]
    assert rows[-1] == f"learned{beside}" and all(row.endswith(beside) for row in rows)
    assert ("teammates" in contest.describe()) == bool(beside)


def test_the_evaluation_of_one_side_names_its_teammates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair, out = tmp_path / "pair", tmp_path / "out.json"
    small = ["--num-games", "16", "--rollout-steps", "4", "--minibatch-size", "16", "--width", "8"]
    game = ["--maze", "3x3", "--num-chasers", "2", "--max-steps", "9", "--frames", "100"]
    main(["self-play", *game, *small, "--episodes", "4", "--no-report", "--out", str(pair)])
    capsys.readouterr()
    scripted = ["--teammates", "scripted", "--episodes", "4", "--out", str(out)]
    main(["evaluate", str(pair / "chaser"), *scripted])
    said = capsys.readouterr().out.splitlines()
    assert [line for line in said if line.startswith("learned + AStarChaser(epsilon=0.2)  ")]
    assert json.loads(out.read_text())["teammates"] == {"chaser_1": "AStarChaser(epsilon=0.2)"}
