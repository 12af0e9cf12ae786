"""The comparison of libraries: from the search to its report, resumed, and failing runs."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from executed_here import executed_here

from train.commands.main import main
from train.experiments import executors
from train.experiments.library_runs import (
    COMPARED_LIBRARIES,
    LIBRARY_RUN,
    ComparedAgent,
    hyper_of,
    library_settings_of,
    ordinary,
)
from train.experiments.rows import CURVES, RUNS, curve_measures
from train.experiments.stages import Stage, stages_of
from train.experiments.study import StudyFile, choose_version, read_file
from train.experiments.tuning import last_trials, least_copy_of, mazes_of
from train.experiments.variants import times_row
from train.kinds import open_run, resume, write_config
from train.runs.folder import is_complete, read_metrics
from train.runs.forms import Final
from train.settings.presets import tuned
from train.settings.task import TaskSettings

pytest.importorskip("stable_baselines3")

TINY = """
title = "Tiny"
kind = "contestant"
episodes = 20
[settings]
frames = 256
[grid]
contestant = ["ours", "stable-baselines3"]
[[variants]]
name = "runner, 2x2"
task = "maze"
maze = "2x2"
num_goals = 1
[tuning]
mazes = ["3x3"]
shipped = false
[tuning.space.all]
num_games = { choices = [8] }
rollout_steps = { choices = [8] }
minibatch_size = { choices = [32, 999] }
learning_rate = { low = 1e-3, high = 1e-2, scale = "log" }
width = { choices = [16] }
[tuning.short]
samples = 2
frames = 128
[tuning.full]
samples = 2
seconds = 1
[short]
seeds = [0, 1]
[full]
seeds = [0]
"""
RUNNER = TaskSettings(task="maze", maze="3x3", num_goals=1)


def stages(folder: Path, text: str = TINY) -> list[Stage]:
    path = folder / "tiny.toml"
    path.write_text(text, encoding="utf-8")
    return stages_of(str(path), "comparison", None, folder / "out")


def compare(folder: Path, text: str = TINY) -> Path:
    """The folder of a comparison that the command has executed in this process."""
    (folder / "tiny.toml").write_text(text, encoding="utf-8")
    with executed_here():
        main(["compare", str(folder / "tiny.toml"), "--out", str(folder / "out")])
    return folder / "out"


def told(folder: Path) -> list[dict[str, str]]:
    with folder.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


# -- a comparison --------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_small_comparison_runs_to_its_report_and_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = compare(tmp_path)
    said = capsys.readouterr().out
    assert said.count("4 complete\n") == 2 and "report: " in said
    # The final settings are those of the trial with the lowest score.
    trials = last_trials(out)
    runs, curves = (pandas.read_csv(out / name) for name in (RUNS, CURVES))
    for name in ("ours", "stable-baselines3"):
        own = [row for row in trials if row["contestant"] == name]
        scores = [row["score"] for row in own]
        assert [row["chosen"] for row in own].index(True) == int(np.argmin(scores))
        (rate,) = (row["learning_rate"] for row in own if row["chosen"])
        mine = [row for row in runs.to_dict("records") if row["contestant"] == name]
        assert {row["learning_rate"] for row in mine} == {rate}
        assert all(row["minibatch_size"] <= 64 for row in mine)  # a rollout
        of_one = curves[curves["run"] == mine[0]["run"]]
        assert of_one["frames"].to_list() == [64.0, 128.0, 192.0, 256.0]
    text = (out / "report" / "report.md").read_text(encoding="utf-8")
    for word in ("First to each gap", "Stable-Baselines3", "learning_rate", "stable_baselines3"):
        assert word in text
    assert (out / "report" / "curves.png").stat().st_size > 10_000
    assert (out / "report" / "report.html").is_file()
    rows = told(out / "report" / "runs.csv")
    assert {(row["contestant"], row["seed"]) for row in rows} == {
        (name, seed) for name in ("ours", "stable-baselines3") for seed in "01"
    }
    assert all(row["greedy"] and row["processor_seconds"] and row["frames"] for row in rows)
    assert [row["chosen"] for row in told(out / "report" / "trials.csv")].count("True") == 2

    # Repeated: nothing is executed, and the report is the same.
    monkeypatch.setattr(executors, "perform_here", pytest.fail)
    table = (out / "report" / "table.csv").read_bytes()
    compare(tmp_path)
    assert (out / "report" / "table.csv").read_bytes() == table


def test_a_failed_run_is_reported_and_retried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: Any) -> Any:
        raise RuntimeError("no luck")

    alone = TINY.replace('"ours", "stable-baselines3"', '"ours"')
    monkeypatch.setattr(ComparedAgent, "iterate", broken)
    with pytest.raises(SystemExit):
        compare(tmp_path, alone)
    assert "of 'ours' on 'runner, 2x2' is complete; see" in capsys.readouterr().out
    errors = list((tmp_path / "out" / "tuning").rglob("error.txt"))
    assert len(errors) == 2 and "no luck" in errors[0].read_text(encoding="utf-8")
    monkeypatch.undo()
    compare(tmp_path, alone)
    assert not list((tmp_path / "out").rglob("error.txt"))


def test_contestants_alternate(tmp_path: Path) -> None:
    for stage in stages(tmp_path):
        names = [run.label["contestant"] for run in stage.expand().runs]
        assert names[:4] == ["ours", "stable-baselines3", "stable-baselines3", "ours"]


def test_a_folder_of_something_else_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out" / "tuning").mkdir(parents=True)
    (tmp_path / "out" / "tuning" / "ours-2x2-seed1000000-0123456789.json").write_text("{}")
    with pytest.raises(SystemExit):
        compare(tmp_path)
    assert re.search("tuning: not empty, .*; give a new folder", capsys.readouterr().err)


def test_options_of_the_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for options, words in (
        (["--workers", "-1"], "workers=-1"),
        (["--version", "medium"], "short or full"),
        (["--clock", "sun"], "unknown clock 'sun'"),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(["compare", "ppo", *options])
        assert stopped.value.code == 2 and words in capsys.readouterr().err
    main(["compare", "ppo", "--clock", "processor", "--out", str(tmp_path / "o"), "--dry-run"])
    assert "26 runs to do" in capsys.readouterr().out and not (tmp_path / "o").exists()


# -- what is compared ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("version", ["short", "full"])
@pytest.mark.parametrize("name", ["ppo", "ppo-frames"])
def test_a_shipped_comparison_is_tuned_on_other_mazes_and_fits_its_time(
    name: str, version: str, tmp_path: Path
) -> None:
    search, final = [s.expand() for s in stages_of(name, "comparison", version, tmp_path)]
    if version == "short":
        runs = [run.settings for run in (*search.runs, *final.runs)]
        assert sum((run.seconds or 0.0) + (run.frames or 0) / 5e4 for run in runs) <= 20 * 60
    file = choose_version(read_file(name, "comparison", StudyFile)[1], version)
    names = file.grid["contestant"]
    assert {*names} == {*COMPARED_LIBRARIES} or version == "short"
    assert file.tuning is not None
    for task in file.variants or ():
        held_out = mazes_of(file.tuning, file.tuning.full, task)
        copies = {least_copy_of(maze) for maze in (task["maze"], *held_out)}
        assert 2 <= len(held_out) <= 5 and len(copies) == 1 + len(held_out)
    # Every contestant has the same trials, seeds and budgets, and as many of each.
    alike = {
        name: [
            {n: v for n, v in run.label.items() if n != "contestant"} | {"seed": run.seed}
            for run in search.runs
            if run.label["contestant"] == name
        ]
        for name in names
    }
    assert all(each == alike["ours"] for each in alike.values())
    assert len(alike["ours"]) == (8 if version == "short" else 10 * 2 * 2)


def test_times_are_censored_and_medians_need_more_than_half() -> None:
    points = [
        {"seconds": s, "frames": 10 * s, "greedy": gap, "sampled": 1.0, "optimality_gap": gap}
        for s, gap in ((1.0, 0.2), (2.0, 0.04), (3.0, 0.06))
    ]
    row = curve_measures({"optimality_gap": 0.06, "role": "runner"}, points)
    assert (row["greedy_seconds_to_5"], row["greedy_frames_to_5"]) == (2.0, 20.0)
    assert row["sampled_seconds_to_5"] is None

    def median(*times: float | None) -> float:
        rows = [{"seconds_to_5": time, "frames_to_5": time} for time in times]
        return float(times_row(rows, [5.0])["seconds_to_5"])

    assert median(1.0, 2.0, 4.0, None, None) == 4.0
    assert median(1.0, 2.0, None, None) == float("inf")


def started(folder: Path, name: str, frames: int = 200, **changed: Any) -> Any:
    """A run of a contestant in a new folder, of iterations of 64 frames."""
    drawn = {"num_games": 8, "rollout_steps": 8, "minibatch_size": 32, "width": 16, **changed}
    task = {"task": "maze", "maze": "3x3", "num_goals": 1}
    settings: Any = library_settings_of(contestant=name, seed=3, frames=frames, **task, **drawn)
    folder.mkdir(exist_ok=True)
    write_config(LIBRARY_RUN, settings, folder, Final(50))
    return open_run(folder)


@pytest.mark.parametrize("name", COMPARED_LIBRARIES)
def test_every_contestant_learns_and_is_evaluated_equally(name: str, tmp_path: Path) -> None:
    run = started(tmp_path, name)
    # Initial policies are nearly uniform for all observations.
    trainee = run.trainee
    games = trainee.contest.starts().games
    probabilities = trainee.learner.policy(greedy=False).distribution(
        trainee.parts.seat.task, games, 0
    )
    assert np.allclose(probabilities.mean(axis=0), 0.25, atol=0.1)
    run.train()
    rows, content = read_metrics(tmp_path), run.results(50)
    assert [row["frames"] for row in rows] == [64, 128, 192]  # a fourth would not fit
    assert all(row["processor_seconds"] > 0 and row["greedy"] >= 0 for row in rows)
    assert all(row["optimality_gap"] == min(row["greedy"], row["sampled"]) for row in rows)
    assert run.is_trained and is_complete(tmp_path) and content["algorithm"] == name
    assert content["evaluation"].items() >= {n: rows[-1][n] for n in ("greedy", "sampled")}.items()
    run.lock.release()
    assert read_metrics(tmp_path) == open_run(tmp_path).rows


def test_a_comparison_resumes_where_it_was_stopped(tmp_path: Path) -> None:
    whole = started(tmp_path / "whole", "cleanrl")
    whole.train()
    half = started(tmp_path / "half", "cleanrl")

    def stop(run: Any, row: dict[str, float]) -> None:
        run.stopped = run.trainee.frames >= 64

    half.train(stop)
    half.results(50)
    assert not is_complete(tmp_path / "half")
    half.lock.release()
    again: Any = resume(tmp_path / "half", LIBRARY_RUN)
    again.train()
    for one, two in zip(whole.rows, again.rows, strict=True):
        for column in ("frames", "greedy", "sampled", "mean_steps"):
            assert one[column] == two[column]
    assert again.seconds == pytest.approx(again.trainee.spent["wall"], abs=0.05)


def test_the_marks_of_evaluations(tmp_path: Path) -> None:
    marks = started(tmp_path, "cleanrl", evaluations=4).marks
    assert marks == [1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0]


def test_settings_are_those_of_the_presets_and_of_the_libraries() -> None:
    eight = replace(RUNNER, num_goals=8)
    ours = hyper_of(COMPARED_LIBRARIES["ours"], eight, {})
    assert ours == tuned("ppo", eight.profile()) and ours.gamma_end == pytest.approx(0.997)
    for name, entry in COMPARED_LIBRARIES.items():
        drawn = hyper_of(entry, eight, {"gamma": 0.95})
        assert drawn.gamma == drawn.last_gamma == 0.95
        flat = {"task": "chase", "maze": "9x9", "num_games": 64, "clip": 0.3}
        run: Any = ordinary(library_settings_of(contestant=name, frames=9, **flat))
        assert run.hyper.clip == 0.3 and run.hyper.minibatch_size <= 64 * run.hyper.rollout_steps
        assert run.observation == ("index" if "ours" in name else "one_hot")
        assert run.curriculum == ("start-distance" if name == "ours" else "none")
    with pytest.raises(ValueError, match="'a2c' has no setting clip, epochs, minibatch_size"):
        library_settings_of(contestant="a2c", task="chase", maze="3x3", frames=9)


# -- a library of one's own ------------------------------------------------------------------------

LIBRARY = "my_parts:LOOP"
OWN = """
title = "Own"
episodes = 20
[settings]
frames = 512
task = "maze"
maze = "2x2"
num_goals = 1
num_games = 8
rollout_steps = 8
minibatch_size = 32
width = 16
"""


@pytest.mark.parametrize(
    ("command", "more"),
    [
        ("sweep", f"[grid]\nalgorithm = ['ppo', '{LIBRARY}', 'sb3_ppo']"),
        (
            "ablate",
            "control = 'ppo'\nvariants = [{name='ppo', algorithm='ppo'}, "
            f"{{name='own', algorithm='{LIBRARY}'}}, {{name='clean', algorithm='cleanrl_ppo'}}]",
        ),
        (
            "compare",
            f"kind = 'contestant'\n[grid]\ncontestant = ['ours', '{LIBRARY}']\n[[variants]]\n"
            "name = '2x2'\ntask = 'maze'\n[short]\n[full]",
        ),
    ],
)
def test_a_library_of_ones_own_is_one_file(
    command: str, more: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "own_parts"))
    monkeypatch.setattr("pursuit.plugins._allowed", {"my_parts"})
    top, tables = (OWN, more) if command != "ablate" else (more + OWN, "")
    if command == "compare":
        kind, _, tables = more.partition("\n")
        top = kind + OWN.replace('task = "maze"\n', "")
    (tmp_path / "own.toml").write_text(f"{top}\n{tables}", encoding="utf-8")
    with executed_here():
        main([command, str(tmp_path / "own.toml"), "--out", str(tmp_path / "out")])
    rows = told(tmp_path / "out" / "report" / "runs.csv")
    column = {"sweep": "algorithm", "ablate": "algorithm", "compare": "contestant"}[command]
    own = next(row for row in rows if row[column] == LIBRARY)
    assert own["status"] == "complete" and float(own["mean_steps"]) >= 1.0
    assert all(row["status"] == "complete" for row in rows)
    assert LIBRARY in (tmp_path / "out" / "report" / "report.md").read_text() or command == "ablate"
