"""Scores in many mazes: exact where they are said to be, beside the optimum of each maze."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pursuit.mazes.suites import load_suite
from pursuit.simulator.policy import TabularPolicy
from pursuit.tasks.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    RandomAgent,
    best_response,
    evaluate_exactly,
    mean_over_starts,
)
from scripted_agents.exact.references import is_known
from train import load_policy
from train.commands.main import main
from train.evaluation.contest import GameContest
from train.evaluation.suite_contest import SuiteContest, suite_called
from train.evaluation.suite_report import kind_table, maze_rows, summary_of
from train.evaluation.suite_tables import tables_of
from train.networks.actor_critic import ActorCritic
from train.networks.layers import Hidden
from train.networks.policy import MazeSeat

MAZES = "suite:5x5-test/0-3"
GAMES: dict[str, tuple[str, str, dict[str, Any], dict[str, Any]]] = {
    "runner": ("maze", "runner", {}, {"num_goals": 1}),
    "chaser": ("chase", "chaser", {"evader": AStarEvader(0.2)}, {}),
    "evader": ("chase", "evader", {"chaser": AStarChaser(0.2)}, {"stay_action": True}),
}
"""Task, agent, opponents and settings by role."""


def contest_of_role(role: str, **more: Any) -> SuiteContest:
    name, agent, opponents, settings = GAMES[role]
    task = make_task(name, maze=MAZES, max_steps=30, **settings)
    return SuiteContest(task, agent, opponents, **more)


def network(seat: MazeSeat, greedy: bool) -> Any:
    torch.manual_seed(3)
    return seat.policy(ActorCritic(seat.features, seat.num_actions, Hidden(8)), greedy)


@pytest.mark.parametrize("role", GAMES)
@pytest.mark.parametrize("greedy", [False, True])
def test_exact_means_are_those_of_many_games(role: str, greedy: bool) -> None:
    exact = contest_of_role(role, exact=True)
    played = contest_of_role(role, episodes=1200)
    policy = network(MazeSeat(exact.task, role, "planes"), greedy)
    assert exact.is_computed and not played.is_computed and is_known(exact.task, policy)
    found, games = (contest.in_mazes("learned", policy) for contest in (exact, played))
    assert found.exact and games.lengths is not None
    widths = 4 * games.lengths.reshape(4, -1).std(axis=1) / 300**0.5
    assert (np.abs(found.steps - games.steps) <= widths + 1e-9).all()
    assert games.success == pytest.approx(found.success, abs=0.12)


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_each_maze_of_a_duel_is_scored_as_it_is_alone(role: str) -> None:
    contest = contest_of_role(role, exact=True)
    found, best = contest.in_mazes("random", RandomAgent()), contest.best
    assert best is not None
    for number in (0, 3):
        maze = contest.task.mazes[number]
        task = make_task("chase", maze=maze, max_steps=30, stay_action=contest.task.stay_action)
        alone = GameContest(task, role, contest.opponents, 10)
        assert found.steps[number] == pytest.approx(alone.score("random", RandomAgent()).mean_steps)
        optimum = alone.optimal()
        assert optimum is not None
        assert best.steps[number] == pytest.approx(optimum.mean_steps)


def test_a_runner_with_one_goal_has_the_shortest_paths_as_its_optimum() -> None:
    contest = contest_of_role("runner", exact=True)
    best, nearest = contest.best, contest.in_mazes("nearest goal", NearestGoalRunner())
    assert best is not None
    for maze, steps in zip(contest.task.mazes, best.steps, strict=True):
        assert steps == pytest.approx(maze.distances[maze.distances > 0].mean())
    assert nearest.steps == pytest.approx(best.steps) and (nearest.success == 1.0).all()
    # By hand: a random walk is a linear system, and so is its chance to arrive in time.
    maze, goal = contest.task.mazes[0], 7
    walk = np.zeros((25, 25))
    table = RandomAgent().action_probabilities(maze)[:, goal]
    for action in range(4):
        np.add.at(walk, (np.arange(25), maze.neighbors[:, action]), table[:, action])
    walk[goal] = 0.0
    walk[goal, goal] = 1.0
    arrived = [np.linalg.matrix_power(walk, step)[:, goal] for step in range(31)]
    expected = sum(1.0 - chance for chance in arrived[:30])
    tables = next(iter(tables_of(RandomAgent(), contest.task, 0)))
    stay = np.zeros((25, 25, 5))
    stay[..., 4] = 1.0
    values = evaluate_exactly(maze, tables, stay, horizon=30).values[:, goal]
    assert values == pytest.approx(expected)


@pytest.mark.parametrize("role", GAMES)
def test_played_starts_stand_beside_the_optimum_of_the_same_starts(role: str) -> None:
    contest = contest_of_role(role, episodes=40)
    lengths, best = contest.optimal_lengths(), contest.best
    assert lengths is not None and best is not None and len(lengths) == 40
    assert best.steps == pytest.approx(lengths.reshape(4, 10).mean(axis=1))
    starts = contest.starts()
    assert (starts.maze_index == np.repeat(np.arange(4), 10)).all()
    for number in (0, 17, 39):
        simulator, play = contest.game(RandomAgent(), number)
        assert (simulator.positions[0] == starts.positions[number]).all()
        assert simulator.maze_index[0] == starts.maze_index[number]
        assert sum(1 for _ in play) <= 30
    scores = contest.baselines()
    assert [score.name for score in scores][-1] == "optimal" and not scores[0].exact
    assert scores[-1].ci95 > 0


def test_fewer_episodes_than_mazes_are_spread_over_them() -> None:
    task = make_task("maze", maze="suite:5x5-test", num_goals=2)
    contest = SuiteContest(task, "runner", {}, 50)
    assert len(contest.played) == 50 and contest.played[-1] == 199
    assert contest.best is not None and not contest.best.exact
    assert not contest.solvable
    assert "200 mazes of suite:5x5-test (1 runner, 2 goals)" in contest.line()


def test_suites_are_called_by_their_names() -> None:
    for name in ("suite:5x5-test", "suite:5x5-train/000-009"):
        assert suite_called(make_task("chase", maze=name)) == name
    mixed = make_task("chase", maze=("3x3", "suite:5x5-test/3"))
    assert suite_called(mixed) == "3x3 and 1 more"


def test_rows_and_summaries_are_of_the_same_numbers() -> None:
    contest = contest_of_role("chaser", exact=True)
    found = contest.references()
    rows = maze_rows(contest, found[:2])
    assert [row["maze"] for row in rows] == [maze.name for maze in load_suite(MAZES)]
    assert rows[0]["A*_chaser_gap"] == rows[0]["A*_chaser_steps"] / rows[0]["optimal_steps"] - 1
    told = summary_of(contest, found[1])
    assert told["mean_gap"] == pytest.approx(np.mean([row["A*_chaser_gap"] for row in rows]))
    assert told["optimality_gap"] == pytest.approx(
        np.mean([row["A*_chaser_steps"] for row in rows])
        / np.mean([row["optimal_steps"] for row in rows])
        - 1
    )
    assert [row["mazes"] for row in kind_table(rows).rows] == [1] * 4


def test_a_policy_plays_in_mazes_that_look_like_those_of_its_training() -> None:
    task = make_task("chase", maze="suite:5x5-train/0-1", max_steps=30)
    other = load_suite("7x7-test/0")[0]
    policy = network(MazeSeat(task, "chaser", "window:4"), False)
    table = policy.action_probabilities(other)
    assert isinstance(policy, TabularPolicy) and table.shape == (49, 49, 4)
    evader = AStarEvader(0.2).action_probabilities(other)
    mean = mean_over_starts(evaluate_exactly(other, table, evader), other)
    assert mean >= mean_over_starts(best_response("chaser", other, evader).values, other)
    for encoding in ("index", "planes"):  # the one shows no walls, the other has another shape
        blind = network(MazeSeat(task, "chaser", encoding), False)
        assert not blind.plays_in(other)
        with pytest.raises(ValueError, match="with an observation that fits it"):
            blind.action_probabilities(other)


@pytest.mark.slow
def test_a_run_is_judged_in_unseen_mazes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, out = tmp_path / "run", tmp_path / "out.json"
    command = "train --task maze --num-goals 1 --maze suite:5x5-train/0-9 --observation window:4 "
    command += "--network flat "
    command += "--max-steps 30 --frames 1000 --num-games 64 --rollout-steps 4 --minibatch-size 128 "
    command += f"--width 8 --episodes 40 --threads 1 --out {run}"
    assert main(command.split()) in (0, None)
    config = json.loads((run / "config.json").read_text())
    assert config["task"]["maze"] == "suite:5x5-train/0-9" and config["maze_text"] is None
    assert json.loads((run / "results.json").read_text())["maze"] == "suite:5x5-train/000-009"
    capsys.readouterr()
    files = f"--out {out} --table {tmp_path}/t.csv"
    assert main(f"evaluate {run} --maze {MAZES} {files}".split()) in (0, None)
    said = capsys.readouterr().out
    assert "4 mazes of suite:5x5-test/000-003" in said and "generalisation gap:" in said
    found = json.loads(out.read_text())
    assert found["evaluation"]["exact"] and found["suite"]["nearest goal"]["optimality_gap"] == 0
    told = found["generalisation"]
    assert told["unseen"]["mazes"] == 4 and told["seen"]["maze"] == "suite:5x5-train/000-009"
    lost = told["unseen"]["optimality_gap"] - told["seen"]["optimality_gap"]
    assert told["lost"]["optimality_gap"] == pytest.approx(lost)
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 and float(rows[0]["mean_path"]) > 0 and rows[0]["kind"] == "prim, loops 0"
    # Exact in one maze of another size, too.
    assert main(f"evaluate {run} --maze 3x3 --episodes 10".split()) in (0, None)
    policy = load_policy(run)
    assert policy.encoding == "window:4" and policy.seat.features.kind == "flat"


def test_the_references_of_a_suite_are_exact(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(f"baseline --task chase --maze {MAZES} --episodes 8".split()) in (0, None)
    said = capsys.readouterr().out
    assert said.count("exact") == 3 and "distinct states" not in said


@pytest.mark.parametrize(
    ("command", "problem"),
    [
        ("self-play --maze suite:5x5-train --frames 100", "self-play needs one maze"),
        (
            "train --maze suite:5x5-train --algorithm q_learning --frames 100",
            "needs a single maze",
        ),
        ("train --maze suite:6x6-train --frames 100", "unknown suite"),
    ],
)
def test_what_needs_one_maze_says_so(
    command: str, problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([*command.split(), "--out", str(tmp_path / "run")])
    assert problem in capsys.readouterr().err


def test_the_reference_of_a_heist_in_a_suite_is_the_best_scripted_agent() -> None:
    task = make_task("heist", maze=MAZES, num_goals=2, max_steps=20)
    contest = SuiteContest(task, "evader", {"chaser": AStarChaser(0.5)}, episodes=40)
    learned = contest.score("learned", RandomAgent())
    games, paid = contest.starts(), np.zeros(40)
    while not games.ended.all():
        over = games.ended.copy()
        actions = np.zeros((40, 2), dtype=np.int32)
        games.act([AStarChaser(0.5), RandomAgent()], actions)
        games.step(actions)
        paid += np.where(over, 0.0, games.rewards[:, contest.seat])
    assert learned.mean_return == pytest.approx(paid.mean(), abs=1e-5)
    baselines = contest.baselines()
    reference = contest.reference(baselines, learned)
    assert reference is not None and reference.unit == "return" and reference.kind == "best known"
    best = max(score.mean_return or -np.inf for score in baselines)
    assert reference.value == best
    assert reference.distance == pytest.approx(best - paid.mean(), abs=1e-5)
