"""`Tracker`: policies of other learners as runs, compared with the same policies of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_errors import error_of
from numpy.typing import NDArray

import pursuit
from train.commands.main import main
from train.files import read_json
from train.runs.folder import kept_policies, load_results, read_metrics
from train.runs.parts import contest_of
from train.settings.task import TaskSettings

Observations = NDArray[Any]


def uniform(actions: int) -> Any:
    return lambda seen: np.full((len(seen), actions), 1.0 / actions)


GAMES: dict[str, tuple[dict[str, Any], int]] = {
    "chase": ({"task": "chase", "maze": "3x3"}, 4),
    "evader": ({"task": "escape", "role": "evader", "maze": "3x3", "max_steps": 20}, 4),
    "goals": ({"task": "maze", "maze": "3x3", "num_goals": 2, "max_steps": 30}, 4),
    "suite": ({"task": "maze", "maze": "suite:5x5-train/0-9", "observation": "planes"}, 4),
    "view": ({"task": "chase", "maze": "3x3", "view_radius": "chaser=1", "max_steps": 20}, 4),
    "small game": ({"game": "soccer"}, 5),
    "arm": ({"task": "reacher", "joints": 2, "max_steps": 12}, 2),
    "arm by numbers": (
        {"task": "reacher", "joints": 2, "max_steps": 12, "discrete_actions": True}, 9
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", GAMES)
def test_every_kind_of_game_is_tracked_and_read_again(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    game, actions = GAMES[name]
    policy = (lambda seen: np.zeros((len(seen), 2))) if name == "arm" else uniform(actions)
    out = tmp_path / "run"
    with pursuit.Tracker(game, out, checkpoints=2) as tracker:
        for frames in (100, 250):
            row = tracker.log(frames, policy)
    rows, results = read_metrics(out), load_results(out)
    assert [row["frames"] for row in rows] == [100, 250] and results["frames"] == 250
    column = results["objective"]["column"]
    assert rows[-1][column] == row[column] == rows[0][column]
    if results["evaluation"]["exact"]:
        assert results["evaluation"][column] == row[column]
    assert not results["interrupted"] and [*kept_policies(out)] == [100, 250]
    main(["evaluate", str(out), "--out", str(tmp_path / "again.json")])
    again = read_json(tmp_path / "again.json")["evaluation"]
    assert again[column] == pytest.approx(results["evaluation"][column], abs=1e-9)
    main(["view", str(out), "--no-open"])
    assert "interrupted" not in capsys.readouterr().out


def test_a_uniform_function_is_the_uniform_agent(tmp_path: Path) -> None:
    task = TaskSettings("chase", maze="5x5")
    expected = contest_of(task, 100).score("uniform", pursuit.UniformAgent())
    with pursuit.Tracker("chase", tmp_path / "run", maze="5x5") as tracker:
        row = tracker.log(1, uniform(4))
    assert row["mean_steps"] == pytest.approx(expected.mean_steps, rel=1e-9)
    optimal = load_results(tmp_path / "run")["evaluation"]["optimal_steps"]
    assert row["optimality_gap"] == pytest.approx(row["mean_steps"] / optimal - 1.0)


def test_a_learned_policy_as_a_function_has_its_own_gap_and_plays_in_a_league(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flat = {"task": "chase", "maze": "3x3", "observation": "one_hot", "frames": 20_000}
    run = pursuit.start("single", pursuit.settings_of(**flat, width=16), tmp_path / "a")
    run.train()
    policy = run.trainee.learner.policy(greedy=False)
    with pursuit.Tracker("chase", tmp_path / "b", maze="3x3") as tracker:
        row = tracker.log(run.trainee.frames, policy.probabilities)
        # What goes on learning afterwards does not change what was logged.
        for weight in run.trainee.learner.network.parameters():
            weight.data.zero_()
    sampled = {s["name"]: s["mean_steps"] for s in run.results(episodes=50)["scores"]}
    assert row["mean_steps"] != sampled["learned, sampled"]
    ours = pursuit.load_policy(tmp_path / "a", greedy=False)
    expected = contest_of(TaskSettings("chase", maze="3x3"), 50).score("x", ours).mean_steps
    assert row["mean_steps"] == pytest.approx(expected, abs=1e-4)
    assert load_results(tmp_path / "b")["evaluation"]["mean_steps"] == row["mean_steps"]
    run.lock.release()
    main(
        ["league", str(tmp_path / "a"), str(tmp_path / "b"), "astar", "--out", str(tmp_path / "l")]
    )
    payoff = read_json(tmp_path / "l" / "league.json")["payoff"]
    assert payoff[0] == pytest.approx(payoff[1], abs=1e-4)
    main(["report", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "r")])
    assert "| b | 1 |" in capsys.readouterr().out


def fails(seen: Observations) -> Any:
    raise KeyError("weights")


@pytest.mark.parametrize(
    "policy, message",
    [
        (lambda seen: seen, r"returned float32 of shape \[81, 27\] for 81 observations; give"),
        (lambda seen: np.zeros(len(seen)), r"float64 of shape \[81\] for 81 observations"),
        (lambda seen: np.zeros(3, int), r"int64 of shape \[3\] for 81"),
        (lambda seen: np.full(len(seen), 4), "actions from 4 to 4; give 0 to 3"),
        (lambda seen: np.full(len(seen), -1), "actions from -1 to -1; give 0 to 3"),
        (lambda seen: np.full((len(seen), 4), 0.5), "no probabilities of sum 1"),
        (lambda seen: np.full((len(seen), 4), np.nan), "no probabilities of sum 1"),
        (lambda seen: None, r"returned object of shape \[\]"),
        (lambda seen: ["left"] * len(seen), r"returned <U4 of shape \[81\]"),
        (fails, "the policy raised KeyError: 'weights'; mend it"),
        ("ppo", "the policy raised TypeError: 'str' object is not callable"),
    ],
)
def test_a_policy_that_returns_anything_else_is_refused_and_nothing_is_lost(
    policy: Any, message: str, tmp_path: Path
) -> None:
    with pursuit.Tracker("chase", tmp_path / "run", maze="3x3") as tracker:
        before = tracker.log(100, uniform(4))
        with pytest.raises(ValueError, match=message):
            tracker.log(200, policy)
        for frames in (100, 0, 1.5, True, None):
            with pytest.raises(ValueError, match="after 100; give the steps so far, a larger"):
                tracker.log(frames, uniform(4))  # type: ignore[arg-type]
    assert [row["frames"] for row in read_metrics(tmp_path / "run")] == [100]
    assert load_results(tmp_path / "run")["evaluation"]["mean_steps"] == before["mean_steps"]


def test_turns_of_an_arm_are_checked_as_well(tmp_path: Path) -> None:
    tracker = pursuit.Tracker("reacher", tmp_path / "run", joints=2, max_steps=5)
    for policy in (
        lambda seen: np.zeros(len(seen), int),
        lambda seen: np.full((len(seen), 2), np.inf),
    ):
        with pytest.raises(ValueError, match="turns"):
            tracker.log(1, policy)
    tracker.close()
    assert not (tmp_path / "run" / "results.json").exists()


def test_what_does_not_fit_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for bad in ({"maze": "3x4"}, {"task": "chess"}):
        with pytest.raises(ValueError, match=r"maze|task"):
            pursuit.Tracker({"task": "chase", **bad}, tmp_path / "run")
    for name in ("frames", "algorithm", "curriculum", "frame_stack", "gamma", "colour"):
        with pytest.raises(ValueError, match=f"{name}: a tracker records what is logged"):
            pursuit.Tracker({"task": "chase", name: 5}, tmp_path / "run")
    with pursuit.Tracker(
        "maze", tmp_path / "run", maze="7x7", num_goals=5, max_steps=20
    ) as tracker:
        tracker.log(10, uniform(4))
    assert "trained by its script" in error_of(
        capsys, "train", "--algorithm", "tracked", "--maze", "3x3", "--out", tmp_path / "x"
    )
    text = error_of(capsys, "evaluate", tmp_path / "run", "--seed", "5")
    assert "only its actions where it was evaluated are saved" in text
    with pytest.raises(ValueError, match="contains a run already"):
        pursuit.Tracker("chase", tmp_path / "run")


@pytest.mark.parametrize(
    "game", [{"task": "chase", "maze": "3x3"}, {"task": "heist", "maze": "3x3"}]
)
def test_a_policy_that_draws_its_actions_is_refused(game: dict[str, Any], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    tracker = pursuit.Tracker(game, tmp_path / "run", checkpoints=1)
    with pytest.raises(ValueError, match="answers the same observations differently; give prob"):
        tracker.log(10, lambda seen: rng.integers(4, size=len(seen)))
    row = tracker.log(10, lambda seen: (np.abs(seen).sum(axis=1) * 7).astype(int) % 4)
    tracker.close()
    assert [each["frames"] for each in read_metrics(tmp_path / "run")] == [10]
    column = load_results(tmp_path / "run")["objective"]["column"]
    found = load_results(tmp_path / "run")["evaluation"][column]
    assert found == pytest.approx(row[column], rel=0.2)  # 500 and 1000 episodes of a heist
    with pytest.raises(ValueError, match="this tracker is closed; use a new one"):
        tracker.log(20, uniform(4))
    with pytest.raises(ValueError, match="export it there"):
        pursuit.export_policy(pursuit.load_policy(tmp_path / "run"), tmp_path / "x.onnx")


def test_frames_have_a_limit(tmp_path: Path) -> None:
    tracker = pursuit.Tracker("chase", tmp_path / "run", maze="3x3")
    with pytest.raises(ValueError, match="give the steps so far"):
        tracker.log(10**30, uniform(4))
    tracker.close()
    assert not (tmp_path / "run" / "metrics.csv").exists()
