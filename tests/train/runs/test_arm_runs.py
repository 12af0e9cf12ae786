"""Runs on an arm: training, curricula, evaluation, saving and loading, as for mazes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_errors import error_of, run

from pursuit.reacher.simulator import ReacherSimulator
from scripted_agents import InverseKinematics, LeastStepsPolicy, least_steps
from train.evaluation.arm_contest import ArmContest, bounds_of
from train.evaluation.scores import optimality_gap
from train.experiments.expansion import load_study
from train.families.maze_policies import MAZE_POLICIES
from train.families.policies import loaded_policy
from train.kinds import open_run, start
from train.runs.folder import RUN
from train.runs.opponents import SAVED, load_policy
from train.runs.parts import contest_of, parts_of, settings_of
from train.runs.saved import load_settings
from train.runs.worlds import task_world_of
from train.settings.algorithms import TD3Settings
from train.settings.curricula import curriculum_form
from train.settings.run import TrainSettings
from train.settings.task import ReacherSettings
from train.teaching.plan import plan_curriculum

TINY = [
    *("--task", "reacher", "--joints", "1", "--max-steps", "40", "--num-games", "16"),
    *("--rollout-steps", "8", "--minibatch-size", "64", "--width", "16", "--threads", "1"),
]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "arm"
    run("train", *TINY, "--frames", "4096", "--episodes", "50", "--out", folder)
    return folder


def test_a_run_leaves_a_complete_folder(trained: Path) -> None:
    for name in ("config.json", "metrics.csv", "checkpoint.pt", "learning_curve.png", "replay.gif"):
        assert (trained / name).exists(), name
    results = json.loads((trained / "results.json").read_text())
    assert (results["task"], results["joints"], results["maze"]) == ("reacher", 1, None)
    evaluation = results["evaluation"]
    gap = evaluation["mean_steps"] / evaluation["optimal_steps"] - 1
    assert evaluation["optimality_gap"] == pytest.approx(gap) and gap >= 0
    names = {score["name"] for score in results["scores"]}
    assert names >= {"random", "damped", "optimal", "learned", "learned, sampled"}


def test_a_run_is_evaluated_rendered_and_read_again(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("evaluate", trained, "--episodes", "50", "--out", tmp_path / "again.json")
    again = json.loads((tmp_path / "again.json").read_text())
    before = json.loads((trained / "results.json").read_text())
    assert again["evaluation"]["mean_steps"] == before["evaluation"]["mean_steps"]
    run("render", trained, "--out", tmp_path / "run.gif", "--episodes", "1")
    run("render", "--task", "reacher", "--joints", "3", "--optimal", "--out", tmp_path / "best.gif")
    settings: Any = load_settings(trained).task
    assert settings == ReacherSettings(joints=1, max_steps=40)
    actions = load_policy(trained).act(ReacherSimulator(settings.build(), 5).view())
    assert actions.shape == (5, 1) and (np.abs(actions) <= 1).all()
    with pytest.raises(ValueError, match="give a run of this game"):
        loaded_policy(MAZE_POLICIES, SAVED, trained)
    elsewhere = error_of(capsys, "evaluate", trained, "--env", "pursuit_v5", "--episodes", "2")
    assert "the policy of arm observes 'positions', but pursuers" in elsewhere


def test_baselines_and_the_minimum_steps(capsys: pytest.CaptureFixture[str]) -> None:
    run("baseline", "--task", "reacher", "--joints", "3", "--episodes", "50")
    told = capsys.readouterr().out
    for name in ("random", "transpose", "pseudo-inverse", "damped", "cyclic", "thesis", "optimal"):
        assert name in told
    assert "exact from every start" in told


def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    train = ("train", "--task", "reacher")
    assert "--maze" in error_of(capsys, *train, "--maze", "5x5")
    assert "or discrete_actions=True" in error_of(capsys, *train, "--algorithm", "dqn")
    table = error_of(capsys, *train, "--discrete-actions", "--algorithm", "q_learning")
    assert "of a maze, which this task does not have; use ppo" in table
    assert "threads=100000; give 0 to 1024" in error_of(capsys, *train, "--threads", "100000")
    wide = error_of(capsys, *train, "--tolerance", "5", "--curriculum", "tolerance")
    assert "for the task's tolerance" in wide
    assert "unknown observation" in error_of(capsys, *train, "--observation", "index")
    assert "games in mazes" in error_of(capsys, *train, "--curriculum", "maze-size")
    assert "needs an arm" in error_of(capsys, "train", "--curriculum", "hold")
    assert "reacher" in error_of(capsys, "train", "--task", "reachr")
    assert "discrete" in error_of(capsys, "train", "--algorithm", "td3")


def test_invalid_curricula_are_refused() -> None:
    arm = ReacherSettings(joints=1)
    with pytest.warns(UserWarning, match="curriculum 'hold' goes from 1 to 1, so it has no effect"):
        plan_curriculum("hold", curriculum_form("hold")(), task_world_of(arm).context, 0)
    hyper = TD3Settings(learning_starts=500)
    with pytest.warns(UserWarning, match="frames=400 with learning_starts=500"):
        parts_of(TrainSettings(arm, hyper, algorithm="td3", frames=400))


# -- evaluation -----------------------------------------------------------------------------------


def test_there_is_no_gap_if_the_time_limit_is_too_short_for_all() -> None:
    contest = contest_of(ReacherSettings(joints=1, max_steps=1, tolerance=1e-6, max_turn=1e-3), 20)
    assert contest.optimal() is None
    assert "optimal" not in [score.name for score in contest.baselines()]


def test_a_contest_counts_the_steps_of_every_start() -> None:
    contest = contest_of(ReacherSettings(joints=2, hold=4, max_steps=60), 40)
    starts, found = contest.starts(), []
    for arm in range(40):
        lower, upper = least_steps(starts.angles[arm], starts.targets[arm])
        assert lower == upper
        found.append(min(max(lower, 1) + 3, 60))
    optimum = contest.optimal()
    assert optimum.mean_steps == pytest.approx(np.mean(found))
    played = contest.score("least", LeastStepsPolicy())
    assert played.mean_steps == optimum.mean_steps and played.success_rate == 1.0
    others = contest.score("damped", InverseKinematics("damped"))
    gap = optimality_gap(others, optimum)
    assert gap is not None and gap > 0
    assert contest_of(ReacherSettings(joints=2, hold=4), 40, seed=1).seed != contest.seed


def test_a_smaller_evaluation_plays_the_first_starts_of_a_larger_one() -> None:
    task = ReacherSettings(joints=2).build()
    few, many = (bounds_of(task, episodes, 7) for episodes in (30, 1500))
    assert np.array_equal(few.lower, many.lower[:30]) and few.share_exact == 1.0


def test_discrete_actions_have_a_lower_bound_only(capsys: pytest.CaptureFixture[str]) -> None:
    contest = ArmContest(ReacherSettings(joints=2, discrete_actions=True).build(), 20)
    assert [score.name for score in contest.baselines()] == ["random", "optimal"]
    run("baseline", "--task", "reacher", "--discrete-actions", "--episodes", "20")
    assert "a lower bound for discrete actions" in capsys.readouterr().out


# -- curricula -------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["target-distance", "free-joints", "hold", "tolerance"])
def test_stages_configure_the_arms(axis: str, tmp_path: Path) -> None:
    settings = settings_of(
        task="reacher", joints=3, hold=4, max_steps=12, algorithm="ppo", curriculum=axis,
        num_games=32, rollout_steps=4, minibatch_size=64, width=8, frames=6000, threads=1,
    )  # fmt: skip
    run = start(RUN, settings, tmp_path / "run")
    simulator = run.trainee.simulator
    seen: list[float] = []

    def look(run: Any, row: dict[str, float]) -> None:
        arms = simulator.arms
        if axis == "target-distance":
            for arm in np.flatnonzero(arms.steps == 0):
                known = float(arms.tolerance[arm])
                lower, _ = least_steps(arms.angles[arm], arms.target[arm], tolerance=known)
                assert lower <= np.ceil(run.trainee.teacher.playing[arm])
                seen.append(lower)
        elif axis == "free-joints":
            seen.append(arms.free_joints.mean())
            assert (arms.angles[arms.free_joints == 1][:, 1:] == 0).all()
        else:
            seen.append(getattr(arms, axis).mean())

    run.train(look)
    ends = {"free-joints": (1, 3), "hold": (1, 4), "tolerance": (1.0, 0.2)}
    if axis in ends:
        assert (seen[0], seen[-1]) == pytest.approx(ends[axis])
    else:
        assert max(seen[:9]) < max(seen[-99:])
    assert (tmp_path / "run" / "curriculum.csv").exists()
    assert open_run(tmp_path / "run").trainee.teacher.axis.name == axis


def test_regrets_of_an_arm_are_against_the_least_steps_of_their_starts() -> None:
    settings = settings_of(
        task="reacher", joints=2, curriculum="level-replay", frames=1000, hold=2, num_games=16,
        rollout_steps=8, minibatch_size=128,
    )  # fmt: skip
    parts = parts_of(settings)
    env, teacher = parts.games()
    assert teacher is not None
    env.reset()
    arms = env.simulator.arms
    for game in range(16):
        least = max(least_steps(arms.angles[game], arms.target[game])[0], 1) + 1
        assert teacher.optima[game] == least
    with pytest.raises(ValueError, match="exact optimum"):
        plan_curriculum(
            "level-replay",
            settings.curriculum_settings,
            parts_of(settings_of(task="reacher", joints=8, frames=1000)).world.context,
            0,
        )


def test_the_experiments_on_the_arm_are_complete() -> None:
    by_joints = load_study("reacher_by_joints", version="full")
    assert len(by_joints.runs) == 4 * 5 * 11
    for name in ("reacher_noise_tau", "reacher_encodings"):
        assert len({run.settings.seed for run in load_study(name, version="short").runs}) == 11
