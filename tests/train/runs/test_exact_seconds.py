"""Exact solutions at the end of a run are told, limited by --exact-seconds, and the limit named."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of, status_of

from scripted_agents.exact import long_work
from train.commands import progress
from train.kinds import start
from train.runs.folder import RUN, SELF_PLAY, load_results
from train.runs.parts import settings_of
from train.self_play.parts import self_play_settings_of

SMALL: dict[str, Any] = {
    "maze": "3x3", "max_steps": 8, "num_games": 16, "rollout_steps": 8, "minibatch_size": 128,
    "width": 8, "threads": 1, "frames": 512,
}  # fmt: skip
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "heist": (RUN, {"task": "heist", "role": "chaser", "num_goals": 1}),
    "escape": (RUN, {"task": "escape", "role": "evader", "num_exits": 1}),
    "one of a team": (RUN, {"num_chasers": 2}),
    "team": (RUN, {"num_chasers": 2, "algorithm": "ippo"}),
    "self-play of a team": (SELF_PLAY, {"num_chasers": 2, "maze": "7x7"}),  # above MAX_EXACT_WORK
    "self-play with goals": (SELF_PLAY, {"task": "heist", "num_goals": 1}),
}
LIMIT = "exact solutions are limited to {} s (--exact-seconds)"


@pytest.mark.filterwarnings("ignore:frames=")
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * ("7x7" in str(RUNS[name]))) for name in RUNS],
)
def test_the_limit_is_kept_and_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is solved at 0, or at a limit that the first sweep reaches; without one as before."""
    kind, given = RUNS[name]
    own = settings_of if kind == RUN else self_play_settings_of
    run = start(kind, own(**{**SMALL, **given}), tmp_path / "run")
    run.train()
    told: list[tuple[str, float]] = []
    whole = run.results(8, None, lambda *given: told.append(given))
    solved = [what for what, _ in told if what.startswith("exact solution of ")]
    assert solved and "exact_limit" not in whole
    if "7x7" not in given.values():  # so small that the limit leaves nothing out
        for seconds in (0.0, 1e-9):
            small = run.results(8, seconds)
            assert "exact_limit" not in small and small["evaluation"] == whole["evaluation"]
    monkeypatch.setattr(long_work, "MAX_EXACT_WORK", 0)
    found = []
    for seconds in (0.0, 1e-9):
        told.clear()
        content = run.results(8, seconds, lambda *given: told.append(given))
        assert content["exact_limit"] == LIMIT.format(f"{seconds:g}")
        swept = [what for what, _ in told if what.startswith("exact solution of ")]
        assert len(swept) == (seconds > 0)
        found.append(content["evaluation"])
        assert load_results(run.folder)["exact_limit"] == content["exact_limit"]
    assert found[0] == found[1]
    assert json.dumps(found[0]) != json.dumps(whole["evaluation"]) or kind == SELF_PLAY
    assert "exact_limit" not in run.results(8, 60.0)


@pytest.mark.filterwarnings("ignore:frames=")
@pytest.mark.parametrize("name", ["one of a team", "team"])
def test_small_games_lose_nothing_whenever_the_time_is_over(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each look at the clock takes a second."""
    kind, given = RUNS[name]
    run = start(kind, settings_of(**{**SMALL, **given}), tmp_path)
    run.train()
    whole = run.results(8)
    clock = count()
    monkeypatch.setattr(long_work, "perf_counter", lambda: float(next(clock)))
    for seconds in (2.0, 9.0, 20.0, 40.0, 60.0, 90.0, 140.0, 200.0):
        content = run.results(8, seconds)
        assert "exact_limit" not in content
        for part in ("evaluation", "team", "scores"):
            assert content.get(part) == whole.get(part), (seconds, part)


def test_commands_tell_limit_and_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(long_work, "MAX_EXACT_WORK", 0)
    monkeypatch.setattr(progress, "QUIET", 0.0)
    words = {"task": "heist", "role": "chaser", "num_goals": 1, **SMALL}
    options = [f"--{name.replace('_', '-')}={value}" for name, value in words.items()]
    out, told = str(tmp_path / "run"), LIMIT.format("0")
    assert status_of("train", *options, "--no-report", "--exact-seconds", 0, "--out", out) == 0
    said = capsys.readouterr()
    assert f"{told}; `pursuit evaluate` has none by default" in said.err
    assert "final evaluation: " in said.err and "optimal" not in said.out
    assert json.loads((tmp_path / "run" / "config.json").read_text())["final"] == {
        "episodes": 1000,
        "exact_seconds": 0.0,
    }
    assert status_of("evaluate", out, "--episodes", 4, "--exact-seconds", 0) == 0
    assert told in capsys.readouterr().out
    assert status_of("evaluate", out, "--episodes", 4) == 0
    assert "optimal return" in capsys.readouterr().out
    suite = ["--maze", "suite:5x5-test", "--exact-seconds", "3"]
    assert "exact_seconds=3.0 has no effect" in error_of(capsys, "evaluate", out, *suite)
    for command in (["evaluate", out], ["train", *options, "--out", out + "2"]):
        told = error_of(capsys, *command, "--exact-seconds", -1)
        assert "exact_seconds=-1.0; give at least 0" in told
    assert not (tmp_path / "run2").exists()
