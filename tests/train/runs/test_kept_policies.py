"""Policies that are kept through training, and are read at their frames by every command."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of

from train import load_policy, settings_of, start
from train.commands.main import main
from train.files import read_json
from train.runs.folder import RUN, SELF_PLAY, kept_policies, read_kept_list, read_metrics
from train.self_play.parts import self_play_settings_of

SMALL: dict[str, Any] = {"num_games": 16, "rollout_steps": 4, "minibatch_size": 64, "width": 8}
GAMES: dict[str, dict[str, Any]] = {
    "chase": {"task": "chase", "maze": "3x3", "max_steps": 20},
    "small game": {"game": "trained_games:Stones", "observation": "one_hot", "max_steps": 20},
    "arm": {"task": "reacher", "joints": 2, "max_steps": 12},
    "self-play": {"maze": "3x3", "max_steps": 20, "snapshots": 5},
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folders = {}
    for name, game in GAMES.items():
        folder = tmp_path_factory.mktemp("runs") / name.replace(" ", "_")
        own = name == "self-play"
        make = self_play_settings_of if own else settings_of
        settings = make(**SMALL, **game, frames=4000, checkpoints=3, threads=1)
        run = start(SELF_PLAY if own else RUN, settings, folder)
        run.train()
        run.results(episodes=20)
        folders[name] = folder
    return folders


@pytest.mark.parametrize("name", GAMES)
def test_each_has_the_evaluation_of_its_time_and_the_best_is_marked(
    name: str, runs: dict[str, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = runs[name]
    listed, rows = read_kept_list(folder), {row["frames"]: row for row in read_metrics(folder)}
    column = read_json(folder / "results.json")["objective"]
    assert [round(each["frames"] / 4000 * 3) for each in listed.kept] == [1, 2, 3]
    pick = min if column["less_is_better"] else max
    best = pick(listed.kept, key=lambda each: each[column["column"]])
    assert listed.best == best["frames"]
    for each in listed.kept:
        frames, value = int(each["frames"]), rows[each["frames"]][column["column"]]
        assert each[column["column"]] == value
        out = tmp_path / f"{frames}.json"
        main(["evaluate", str(folder), "--at", str(frames), "--episodes", "500", "--seed", "0",
              "--out", str(out)])  # fmt: skip
        found = read_json(out)["evaluation"][column["column"]]
        assert found == pytest.approx(value, abs=1e-5), "in training 500 episodes"
    results = read_json(folder / "results.json")
    assert results["best"]["frames"] == listed.best
    main(
        ["evaluate", str(folder), "--at", "best", "--episodes", "20", "--out", str(tmp_path / "b")]
    )
    again = read_json(tmp_path / "b")["evaluation"][column["column"]]
    assert results["best"][column["column"]] == pytest.approx(again, abs=1e-5)
    capsys.readouterr()


def test_the_best_of_sampled_evaluations_has_other_starts(runs: dict[str, Path]) -> None:
    """The arm is evaluated by episodes: those of training chose it."""
    results, listed = read_json(runs["arm"] / "results.json"), read_kept_list(runs["arm"])
    chosen = next(each for each in listed.kept if each["frames"] == listed.best)
    assert not results["best"]["exact"]
    assert results["best"]["mean_steps"] != chosen["mean_steps"]


def test_snapshots_of_self_play_are_read_as_well(
    runs: dict[str, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = runs["self-play"]
    for role in ("chaser", "evader"):
        kept = kept_policies(folder / role)
        files = [path for path in kept.values() if path.is_file()]
        assert len(files) >= 4 and len(kept) == len(files) + 3
        for frames in kept:
            assert load_policy(folder / role, greedy=False, at=frames).agent == role
    first, last = str(min(kept)), str(max(kept))
    out = tmp_path / "league"
    main(["league", str(folder), "astar", "--at", first, last, "--out", str(out)])
    names = read_json(out / "league.json")["chasers"]
    assert names == [f"self-play at {first}", f"self-play at {last}", "astar"]
    for command in (
        ["view", str(folder / "chaser"), "--at", first, "--no-open", "--out", str(tmp_path / "v")],
        ["render", str(folder / "chaser"), "--at", first, "--out", str(tmp_path / "r.gif")],
        ["export", str(folder / "chaser"), "--at", first, "--out", str(tmp_path / "x.pt2")],
    ):
        main(command)
        assert Path(command[-1]).exists()
    capsys.readouterr()


def test_a_kept_policy_is_a_policy_of_its_own(
    runs: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    kept = next(iter(kept_policies(runs["chase"]).values()))
    main(["evaluate", str(kept), "--episodes", "20"])
    assert "learned, sampled" in capsys.readouterr().out
    settings = {**GAMES["chase"], "role": "evader", "opponent": str(kept)}
    assert settings_of(**SMALL, **settings, frames=4000).task.opponent == str(kept)


@pytest.mark.parametrize("at", ["7", "worst", "nan", "inf", "-1", ""])
@pytest.mark.parametrize("name", GAMES)
def test_a_time_that_was_not_kept_is_refused(
    name: str, at: str, runs: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = runs[name] / "chaser" if name == "self-play" else runs[name]
    for command in ("evaluate", "export", "view"):
        text = error_of(capsys, command, folder, f"--at={at}")
        assert f"at={at!r}, but it keeps policies of" in text and "give one of them" in text


def test_a_run_that_keeps_nothing_and_a_damaged_list(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = start(RUN, settings_of(**SMALL, **GAMES["chase"], frames=2000), tmp_path / "run")
    run.train()
    assert run.lock is not None
    run.lock.release()
    for at in ("best", "1000"):
        text = error_of(capsys, "evaluate", run.folder, "--at", at)
        assert "keeps no policies; leave at out, or train with --checkpoints" in text
    (run.folder / "checkpoints.json").write_text(json.dumps({"best": "x"}))
    text = error_of(capsys, "evaluate", run.folder, "--at", "best")
    assert "checkpoints.json" in text and "restore it from a copy" in text


@pytest.mark.parametrize("name", ["chase", "self-play"])
def test_results_do_not_need_the_policies_that_were_kept(name: str, tmp_path: Path) -> None:
    own = name == "self-play"
    make = self_play_settings_of if own else settings_of
    settings = make(**SMALL, **GAMES[name], frames=2000, checkpoints=1, threads=1)
    run = start(SELF_PLAY if own else RUN, settings, tmp_path)
    run.train()
    for folder in [*tmp_path.glob("**/checkpoints")]:
        shutil.rmtree(folder)
    with pytest.warns(UserWarning, match=r"no checkpoint.*results\.json has no best policy"):
        assert "best" not in run.results(episodes=5)
    assert (tmp_path / "results.json").exists()


def test_options_without_a_run_or_a_budget_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("train", "self-play"):
        text = error_of(capsys, command, "--maze", "3x3", "--stretch", "--out", tmp_path / "a")
        assert "--stretch is for --resume RUN with a longer budget" in text
    text = error_of(capsys, "league", "astar", "random", "--at", "best", "--out", tmp_path / "l")
    assert "--at is for runs" in text
    (tmp_path / "r.json").write_text("{}")
    text = error_of(capsys, "view", tmp_path / "r.json", "--at", "best", "--no-open")
    assert "--at is for runs" in text
