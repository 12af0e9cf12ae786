"""Commands that evaluate a run play the opponents of its training; of one side of self-play the
judged policy of the other side. The header says which."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of
from self_play_runs import make_run

from train.commands.main import main
from train.kinds import start
from train.runs.folder import RUN, load_results
from train.runs.opponents import load_policy
from train.runs.parts import contest_of, settings_of
from train.runs.saved import evaluated_settings, load_settings

ARCHIVE = sorted((Path(__file__).parents[2] / "old_folders").glob("*.tar.xz"))[-1]
SIDES = {
    "pair/chaser": "pair/evader",
    "pair/evader": "pair/chaser",
    "pair_team/chaser": "pair_team/evader",
    "pair_game/player_0": "pair_game/player_1",
    "pair_game/player_1": "pair_game/player_0",
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    with tarfile.open(ARCHIVE) as tar:
        tar.extractall(folder, filter="data")
    return folder


@pytest.mark.parametrize("side", SIDES)
def test_one_side_of_self_play_meets_the_judged_policy_of_the_other(
    side: str, runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(runs)
    other = SIDES[side]
    main(["evaluate", side, "--episodes", "4"])
    header = capsys.readouterr().out.splitlines()[0]
    assert f"{other} (sampled)" in header
    contest: Any = contest_of(evaluated_settings(side).task, 4)
    policy = contest.opponents[Path(other).name]
    judged = load_policy(other, greedy=False)
    if hasattr(contest.task, "game"):
        assert policy.table(contest.task).tolist() == judged.table(contest.task).tolist()
    else:
        assert policy.seat == judged.seat and not policy.greedy
    assert f"{other} (sampled)" in str(contest.players(side))
    for command in ("view --no-open --overwrite --out page.html", "render --overwrite --out a.gif"):
        name, *options = command.split()
        main([name, side, *options])
    assert (
        f"{other} (sampled)" in Path("page.html").read_text(encoding="utf-8") or "pair_team" in side
    )
    main(["evaluate", side, "--episodes", "4", "--opponent", "random"] if "game" not in side else
         ["evaluate", side, "--episodes", "4", "--opponent", "uniform"])  # fmt: skip
    assert other not in capsys.readouterr().out


def test_a_side_against_a_fixed_policy_meets_it_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "fixed", evader="random", frames=2000)
    run.train()
    main(["evaluate", str(tmp_path / "fixed" / "chaser"), "--episodes", "4"])
    assert "RandomAgent" in capsys.readouterr().out.splitlines()[0]


def test_a_single_run_meets_the_opponents_of_its_training(runs: Path) -> None:
    for folder in sorted(runs.iterdir()):
        config = folder / "config.json"
        if config.exists() and json.loads(config.read_text())["kind"] == "single":
            assert evaluated_settings(folder) == load_settings(folder)


def test_results_of_earlier_formats_are_converted_and_of_later_ones_refused(
    tmp_path: Path,
) -> None:
    """Time-outs counted as successes of evaders in escapes."""
    flat = {"task": "escape", "role": "evader", "maze": "2x2", "num_exits": 1, "max_steps": 2}
    small = {"algorithm": "ppo", "frames": 64, "num_games": 16, "rollout_steps": 4, "width": 8}
    run = start(RUN, settings_of(**flat, **small, minibatch_size=64), tmp_path / "run")
    run.train()
    run.results(20)
    present = load_results(tmp_path / "run")
    assert present["format"] == 2
    path = tmp_path / "run" / "results.json"
    former = json.loads(path.read_text())
    del former["format"]
    for each in (former["evaluation"], *former["scores"]):
        each["success_rate"] = 1.0 - each["capture_rate"]
    assert former["evaluation"]["success_rate"] > present["evaluation"]["success_rate"]
    path.write_text(json.dumps(former))
    assert load_results(tmp_path / "run") == present
    path.write_text(json.dumps({**former, "format": 99}))
    with pytest.raises(ValueError, match="has format 99, this version of pursuit reads up to 2"):
        load_results(tmp_path / "run")


def test_a_side_without_its_run_needs_an_opponent(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = tmp_path / "chaser"
    alone.mkdir()
    for name in ("config.json", "checkpoint.pt"):
        (alone / name).write_bytes((runs / "pair" / "chaser" / name).read_bytes())
    assert "give --opponent" in error_of(capsys, "evaluate", alone)
    main(["evaluate", str(alone), "--opponent", "astar", "--episodes", "4"])
