"""Sweeps: expansion of files, execution and resumption, and reports."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas
import pytest
from command_errors import error_of
from executed_here import executed_here

from train.commands.main import main
from train.commands.studies import SweepWatch
from train.experiments.executors import progress_of, run_locally, start_worker
from train.experiments.expansion import load_study
from train.experiments.report import report_on
from train.experiments.rows import CURVES, RUNS, read_all, write_table
from train.experiments.runs import prepare, status_of
from train.experiments.summary import sweep_notes
from train.files import only_one
from train.reports.tables import Row

TINY = """
title = "Tiny"
episodes = 20
seeds = [0, 1]

[settings]
task = "maze"
frames = 2000
max_steps = 40
num_games = 32

[grid]
maze = ["2x2", "3x3"]
algorithm = ["a2c", "q_learning"]

[report]
x = "maze"
"""
TABULAR = TINY.replace('"a2c", "q_learning"', '"q_learning"')


def write(path: Path, text: str = TINY) -> str:
    path.write_text(text)
    return str(path)


def silent(statuses: dict[str, str], progress: dict[str, float]) -> None:
    pass


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a complete sweep."""
    folder = tmp_path_factory.mktemp("swept")
    with executed_here():
        main(["sweep", write(folder / "tiny.toml", TABULAR), "--out", str(folder / "out")])
    return folder / "out"


# -- running ---------------------------------------------------------------------------------------


def test_a_sweep_runs_reports_and_is_not_repeated(
    swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, curves = (pandas.read_csv(swept / name) for name in (RUNS, CURVES))
    assert runs["status"].to_list() == ["complete"] * 4
    before = {path: path.stat().st_mtime_ns for path in swept.glob("runs/*/results.json")}
    main(["sweep", write(tmp_path / "tiny.toml", TABULAR), "--out", str(swept)])
    assert "4 complete already" in capsys.readouterr().out
    assert before == {path: path.stat().st_mtime_ns for path in before}
    assert set(curves["run"].to_list()) == set(runs["run"].to_list())
    assert (runs["frames"] >= 2000).all()


def test_the_tables_are_the_same_as_csv_and_parquet_to_pandas_and_duckdb(swept: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    path = swept / "results.parquet"
    ours = pandas.read_csv(swept / RUNS)
    theirs = pandas.read_parquet(path)
    query = f"select run, optimality_gap from '{path}' order by run"
    third = dict(duckdb.sql(query).fetchall())
    expected = {
        folder.name: json.loads((folder / "results.json").read_text())["evaluation"][
            "optimality_gap"
        ]
        for folder in swept.glob("runs/*")
    }
    assert dict(zip(ours["run"], ours["optimality_gap"], strict=True)) == expected
    assert dict(zip(theirs["run"], theirs["optimality_gap"], strict=True)) == expected
    assert third == expected
    wanted = {"maze", "algorithm", "seed", "gamma", "frames", "seconds", "mean_steps", "status"}
    assert wanted | {"torch_version", "commit", "machine", "error"} <= set(ours.columns)
    assert [*ours] == [*theirs]
    types = {name: str(theirs[name].dtype) for name in ("seed", "gamma", "exact", "error")}
    assert types == {"seed": "int64", "gamma": "float64", "exact": "bool", "error": "object"}
    curves = [pandas.read_csv(swept / CURVES), pandas.read_parquet(swept / "curves.parquet")]
    assert [each["run"].nunique() for each in curves] == [4, 4]
    assert curves[0]["frames"].tolist() == curves[1]["frames"].tolist()


def test_a_table_has_any_values_and_no_parquet_without_pyarrow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows: list[Row] = [{"a": 1, "b": "x", "c": None}, {"a": 2.5, "b": 3.0, "d": True}]
    path, beside = tmp_path / "t.csv", tmp_path / "t.parquet"
    write_table(path, rows)
    text = "a,b,c,d\n1,x,,\n2.5,3.0,,True\n"
    assert path.read_text() == text
    found = pandas.read_parquet(beside).astype(object)
    assert found.where(found.notna(), None).to_dict("records") == [
        {"a": 1.0, "b": "x", "c": None, "d": None},
        {"a": 2.5, "b": "3.0", "c": None, "d": True},
    ]
    write_table(path, [])
    assert path.read_text().strip() == "" and len(pandas.read_parquet(beside)) == 0
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    write_table(path, rows)
    assert path.read_text() == text and not beside.exists()


def test_a_folder_of_other_settings_or_another_version_is_refused(
    swept: Path, tmp_path: Path
) -> None:
    sweep = load_study(write(tmp_path / "tiny.toml", TABULAR))
    out = tmp_path / "out"
    shutil.copytree(swept, out)
    config = out / "runs" / sweep.runs[0].name / "config.json"
    content = json.loads(config.read_text())
    config.write_text(json.dumps(content | {"seed": 5}))
    with pytest.raises(ValueError, match="other settings"):
        run_locally(sweep, out, 1, silent)
    config.write_text(json.dumps(content | {"format": 1}))
    with pytest.raises(ValueError, match="another version"):
        run_locally(sweep, out, 1, silent)
    with pytest.raises(ValueError, match="another version"):
        read_all(out)
    config.write_text(json.dumps(content))
    hints = json.loads((out / "sweep.json").read_text())
    (out / "sweep.json").write_text(json.dumps(hints | {"format": 1}))
    with pytest.raises(ValueError, match="has format 1"):
        run_locally(sweep, out, 1, silent)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(ValueError, match="not a sweep"):
        prepare(sweep, tmp_path / "mine")


def test_two_sweeps_cannot_share_a_folder_at_once(tmp_path: Path) -> None:
    sweep = load_study(write(tmp_path / "tiny.toml"))
    with only_one(tmp_path / "out", "sweep"), pytest.raises(ValueError, match="another sweep"):
        run_locally(sweep, tmp_path / "out", 1, silent)


def test_another_process_is_refused_at_once_and_a_killed_one_does_not_block(tmp_path: Path) -> None:
    code = """
import sys, time
from multiprocessing.process import BaseProcess
from pathlib import Path
from train.files import only_one
with only_one(Path(sys.argv[1]), 'sweep'):
    print("held", flush=True)
    time.sleep(600)
"""
    command = [sys.executable, "-c", code, str(tmp_path / "out")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "held\n"
        with pytest.raises(ValueError, match="another sweep"), only_one(tmp_path / "out", "sweep"):
            pass
        other.kill()
    for _ in range(2):  # after the release the next one can lock it
        with only_one(tmp_path / "out", "sweep"):
            pass


@pytest.mark.slow
def test_a_killed_run_is_recorded_and_the_others_continue(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = TINY.replace("frames = 2000", "frames = 60000").replace("[0, 1]", "[0]")
    path = write(tmp_path / "tiny.toml", text.replace('"a2c", "q_learning"', '"a2c"'))
    sweep, out = load_study(path), tmp_path / "out"
    prepare(sweep, out)
    broken = out / "runs" / sweep.runs[0].name
    (broken / "checkpoint.pt").write_bytes(b"no checkpoint")  # it crashes on reading this
    victim = out / "runs" / sweep.runs[1].name
    started: dict[Path, BaseProcess] = {}

    def start(folder: Path) -> BaseProcess:
        started[folder] = start_worker(folder)
        return started[folder]

    def kill(statuses: dict[str, str], progress: dict[str, float]) -> None:
        if progress_of(victim) > 0:
            started[victim].kill()

    monkeypatch.setattr("train.experiments.executors.start_worker", start)
    before = dict(os.environ)
    statuses = run_locally(sweep, out, 2, kill)
    assert dict(os.environ) == before
    assert set(statuses.values()) == {"failed"}
    assert "damaged" in (broken / "error.txt").read_text()
    assert "signal 9 (SIGKILL)" in (victim / "error.txt").read_text()
    runs = read_all(out).everything
    assert [row["status"] for row in runs] == ["failed"] * 2
    assert "SIGKILL" in "".join(row["error"] for row in runs)
    # Repeated: the killed run resumes from its checkpoint, the broken one fails again.
    with pytest.raises(SystemExit) as exit_:
        main(["sweep", path, "--out", str(out), "--workers", "2"])
    assert exit_.value.code == 1
    printed = capsys.readouterr()
    assert "failed" in printed.err and str(broken / "error.txt") in printed.err
    assert status_of(victim) == "complete" and not (victim / "error.txt").exists()
    assert "1 complete, 1 failed" in printed.out


@pytest.mark.parametrize("later", [0.0, 40.0])
def test_the_time_left_follows_the_budgets_and_what_runs_took(
    later: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Budgets of 10, 20, 10 and 30 seconds, two at once; "d" goes on from its middle."""
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    budgets = {"a": 10.0, "b": 20.0, "c": 10.0, "d": 30.0}
    runs: list[Any] = [
        SimpleNamespace(name=name, cost=cost, settings=SimpleNamespace(seconds=cost))
        for name, cost in budgets.items()
    ]
    watch, names = SweepWatch("Study", runs, later), list(budgets)
    frames = SweepWatch("Study", runs, later)
    frames.in_seconds = False
    statuses = dict(zip(names, ("running", "running", "new", "interrupted"), strict=True))
    begun = {"a": 0.0, "b": 0.0}
    assert watch.seconds_left(statuses, begun) == pytest.approx((70.0 + later) / 2)
    assert frames.seconds_left(statuses, begun) is None
    now = 20.0  # half of "a" took four times as long as its budget
    assert watch.seconds_left(statuses, begun | {"a": 0.5}) == pytest.approx(2 * (65.0 + later))
    now = 25.0  # nothing new is known
    assert watch.seconds_left(statuses, begun | {"a": 0.5}) == pytest.approx(2 * (65.0 + later))
    now = 30.0
    statuses |= {"a": "complete", "d": "running"}
    left = watch.seconds_left(statuses, {"b": 0.0, "d": 0.5})
    assert left == pytest.approx(3 * (45.0 + later) / 2)
    now = 40.0
    statuses |= {"b": "failed", "c": "running"}  # its time tells nothing
    left = watch.seconds_left(statuses, {"c": 0.0, "d": 1.0})
    assert left == pytest.approx((10.0 + later) / 2 * 40.0 / 25.0)


# -- reports ---------------------------------------------------------------------------------------


def test_a_report_says_what_the_runs_found(swept: Path) -> None:
    from PIL import Image

    folder = report_on(swept)
    text = (folder / "report.md").read_text()
    assert text.startswith("# Tiny") and "4 runs, seeds 0, 1" in text
    runs = pandas.read_csv(swept / RUNS)
    table = pandas.read_csv(folder / "table.csv")
    assert len(table) == 2
    for row in table.to_dict("records"):
        chosen = runs[(runs["maze"] == row["maze"]) & (runs["algorithm"] == row["group"])]
        assert row["seeds"] == 2
        assert row["gap"] == pytest.approx(100 * chosen["optimality_gap"].mean())
    for name in ("final.png", "learning_curves.png"):
        with Image.open(folder / name) as picture:
            assert min(picture.size) > 300
        assert f"({name})" in text


def test_a_report_says_which_policy_was_evaluated(swept: Path) -> None:
    rows = [row | {"_x": "", "_group": ""} for row in read_all(swept).everything]
    for kinds, told in (
        (("greedy",), "Steps are those of the greedy policy and "),
        (("sampled",), "Steps are those of the sampled policy and "),
        (("sampled", "greedy"), "Steps are those of the greedy or sampled policy and "),
    ):
        given = [row | {"evaluate": kinds[n % len(kinds)]} for n, row in enumerate(rows)]
        assert told in " ".join(sweep_notes(given))


def test_a_report_of_nothing_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(SystemExit) as exit_:
            main(["report", str(folder)])
        assert exit_.value.code == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1


# -- sweeps of self-play ---------------------------------------------------------------------------

ONE_AXIS = """
kind = "self-play"
seeds = [0]
episodes = 10
[settings]
task = "chase"
maze = "2x2-tree"
frames = 512
num_games = 16
minibatch_size = 64
snapshots = 2
[grid]
{axis} = [{values}]
"""


@pytest.mark.parametrize(
    ("axis", "values"), [("max_steps", (5, 10)), ("chaser.entropy_coef", (0.02, 0.05))]
)
def test_a_sweep_of_self_play_with_one_axis_has_its_report(
    axis: str, values: tuple[float, float], tmp_path: Path
) -> None:
    text = ONE_AXIS.format(axis=axis, values=f"{values[0]}, {values[1]}")
    report = report_of(tmp_path, f'{text}[report]\nx = "{axis}"\n')
    assert all(f"| {value} | self-play | 1 |" in report for value in values)
    assert "pursuit ablate" not in report  # it refuses self-play
    assert "learning_curves" in report
    assert "Mean curves end with their shortest run." in report


def test_sampling_schemes_are_compared_by_a_sweep(tmp_path: Path) -> None:
    text = ONE_AXIS.format(axis="sampling", values='"latest", "nash-mixture"')
    report = report_of(tmp_path, text)
    assert "NashConv (discounted steps) [95 %]" in report and "| nash-mixture |" in report
    assert (tmp_path / "out" / "report" / "learning_curves.png").stat().st_size > 10_000


def report_of(folder: Path, text: str) -> str:
    """The report of a sweep."""
    with executed_here():
        main(["sweep", write(folder / "file.toml", text), "--out", str(folder / "out")])
    return (folder / "out" / "report" / "report.md").read_text()


def test_a_report_has_a_title_names_and_figures_as_one_asks(
    swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(swept, tmp_path / "one")
    shutil.copytree(swept, tmp_path / "two")
    folders, out = [str(tmp_path / "one"), str(tmp_path / "two")], tmp_path / "both"
    report = ["report", *folders, "--out", str(out)]
    asked = ["--title", "Both", "--names", "first", "second", "--y", "log", "--format", "pdf"]
    for options in (asked, [], asked):  # the folder stays that of the command
        main([*report, *options])
    text = (out / "report.md").read_text()
    assert text.startswith("# Both\n\nRuns of first, second.\n\n") and "| first: " in text
    assert (out / "learning_curves.pdf").read_bytes().startswith(b"%PDF")
    drawn = (out / "learning_curves.svg").read_text()  # of the second one
    assert "below the axis" not in drawn and "Runs of one, two" in drawn
    main(["report", folders[0], "--y", "log", "--title", "A new one", "--format", "png"])
    assert (tmp_path / "one" / "report" / "report.md").read_text().startswith("# A new one\n\n|")
    capsys.readouterr()
    for options, message in (
        (["--names", "first"], "1 names for 2 entries"),
        (["--y", "cubic"], "unknown y 'cubic'; one of linear, log"),
        (["--format", "gif"], "unknown format 'gif'; one of svg, pdf, png"),
    ):
        assert message in error_of(capsys, *report, *options)
    told = error_of(capsys, "report", folders[0], "--names", "first")
    assert "names=('first',) has no effect: a study has the names of its file" in told
