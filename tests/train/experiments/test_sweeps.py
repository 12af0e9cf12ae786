"""Sweeps: expansion of files, execution and resumption, and reports."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

import polars
import pytest

from train.commands.main import main
from train.commands.sweep import SweepWatch
from train.experiments.executors import run_locally
from train.experiments.identity import fingerprint
from train.experiments.report import report_on
from train.experiments.study import prepare, status_of
from train.experiments.sweep import load_sweep, shipped
from train.experiments.sweep_report import sentences
from train.experiments.tables import CURVES, RUNS, collect
from train.experiments.worker import progress_of, start_worker
from train.files import only_one

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
    main(["sweep", write(folder / "tiny.toml", TABULAR), "--out", str(folder / "out")])
    return folder / "out"


# -- files -----------------------------------------------------------------------------------------


def test_a_file_is_multiplied_out(tmp_path: Path) -> None:
    sweep = load_sweep(write(tmp_path / "tiny.toml"))
    assert len(sweep.runs) == 2 * 2 * 2 == len({run.name for run in sweep.runs})
    seen = {
        (r.settings.task.maze, r.settings.algorithm, r.settings.seed, r.settings.threads)
        for r in sweep.runs
    }
    assert seen == {
        (maze, algorithm, seed, 1)
        for maze in ("2x2", "3x3")
        for algorithm in ("a2c", "q_learning")
        for seed in (0, 1)
    }
    assert sweep.report == {"x": "maze", "group": ["algorithm"]}


def test_combinations_given_twice_are_run_once(tmp_path: Path) -> None:
    doubled = TINY.replace('["2x2", "3x3"]', '["2x2", "2x2"]').replace("[0, 1]", "[0, 0]")
    assert len(load_sweep(write(tmp_path / "tiny.toml", doubled)).runs) == 2


def test_two_names_of_equal_settings_are_refused_and_none_vanishes(tmp_path: Path) -> None:
    variants = (
        '[[variants]]\nname = "ours"\n[[variants]]\nname = "shorter"\nrollout_steps = 4\n[report]'
    )
    text = TINY.replace("[report]", variants).replace('["a2c", "q_learning"]', '["a2c"]')
    with pytest.raises(ValueError, match=r"variant='ours'.*and.*variant='shorter' have equal sett"):
        load_sweep(write(tmp_path / "tiny.toml", text))
    told_apart = text.replace("rollout_steps = 4", "rollout_steps = 8")
    assert len(load_sweep(write(tmp_path / "tiny.toml", told_apart)).runs) == 2 * 2 * 2


def test_the_fingerprint_depends_on_every_setting_and_the_maze_text(tmp_path: Path) -> None:
    base = load_sweep(write(tmp_path / "tiny.toml")).runs[0]
    maze = tmp_path / "own.txt"
    prints = {fingerprint(base.kind, base.settings, 20, {})}
    changes = ("stay_action = true", "gamma = 0.5", f'maze = "{maze}"', f'maze = "{maze}" # again')
    for number, line in enumerate(changes):
        middle = "+ + +" if number == 3 else "+-+ +"  # the same file name, another maze in it
        maze.write_text(f"+-+-+\n|   |\n{middle}\n|   |\n+-+-+\n")
        text = TINY.replace("num_games = 32", f"num_games = 32\n{line}")
        if "maze" in line:
            text = text.replace('maze = ["2x2", "3x3"]\n', "")
        run = load_sweep(write(tmp_path / "other.toml", text)).runs[0]
        prints.add(fingerprint(run.kind, run.settings, 20, {}))
    prints.add(fingerprint(base.kind, base.settings, 21, {}))
    assert len(prints) == 6


def test_versions_lie_over_the_common_part(tmp_path: Path) -> None:
    text = TINY.replace("seeds = [0, 1]\n", "") + (
        "[short]\nseeds = [7]\n[full]\nseeds = [1, 2, 3]\nsettings = {frames = 9000}\n"
    )
    path = write(tmp_path / "tiny.toml", text)
    short, full = load_sweep(path), load_sweep(path, "full")
    assert {run.settings.seed for run in short.runs} == {7}
    assert {run.settings.seed for run in full.runs} == {1, 2, 3}
    assert {run.settings.frames for run in full.runs} == {9000}


def test_a_random_search_is_drawn_once_and_in_its_ranges(tmp_path: Path) -> None:
    text = TINY + (
        "[search]\nsamples = 30\nseed = 3\n"
        'learning_rate = {low = 1e-4, high = 1e-2, scale = "log"}\n'
        "rollout_steps = {choices = [2, 4]}\nwidth = {low = 8, high = 64, whole = true}\n"
    )
    text = text.replace('["a2c", "q_learning"]', '["a2c"]').replace("seeds = [0, 1]\n", "")
    path = write(tmp_path / "tiny.toml", text)
    first, second = load_sweep(path), load_sweep(path)
    assert [run.name for run in first.runs] == [run.name for run in second.runs]
    rates = [run.settings.hyper.learning_rate for run in first.runs]
    assert len(set(rates)) == 30 and 1e-4 <= min(rates) < 1e-3 < max(rates) <= 1e-2
    assert {run.settings.hyper.rollout_steps for run in first.runs} == {2, 4}
    assert all(8 <= run.settings.hyper.width <= 64 for run in first.runs)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[grid]", "[grids]", "unknown field 'grids' .did you mean 'grid'"),
        ('["2x2", "3x3"]', "[]", "maze is an empty list"),
        ("[0, 1]", "[]", "seeds is an empty list"),
        ("num_games = 32", "num_gamse = 32", "did you mean 'num_games'"),
        ('["2x2", "3x3"]', '["2x2", "12x3"]', "unknown maze '12x3'"),
        ('["2x2", "3x3"]', '["2x2"]\nobservation = ["cells"]', "q_learning has a table"),
        ('["2x2", "3x3"]', '["9x9"]\nnum_goals = [5]', "fewer agents or goals"),
        ("num_games = 32", "num_games = 0", "num_games=0"),
        ("num_games = 32", 'num_games = "many"', "give a whole number"),
        ("frames = 2000", "frames = 2000\nseconds = 3", "one of the two"),
        ('x = "maze"', 'y = "maze"', "field report: unknown field 'y'"),
        (
            "[report]",
            "[full]\nseed = [1]\n[report]",
            "field full: .*'seeds'",
        ),
        ("[report]", "[[variants]]\ngamma = 0.5\n[report]", "a different name"),
        ("[report]", "[search]\nsamples = 3\n[report]", "names no setting"),
        ("[report]", "[search]\ngamma = {low = 1, high = 0}\n[report]", "not below"),
        ("[grid]", "[grid", "not TOML"),
    ],
)
def test_a_bad_file_is_one_clear_line_before_anything_runs(
    old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in TINY
    path = write(tmp_path / "tiny.toml", TINY.replace(old, new))
    with pytest.raises(ValueError, match=message):
        load_sweep(path)
    with pytest.raises(SystemExit) as exit_:
        main(["sweep", path, "--out", str(tmp_path / "out")])
    assert exit_.value.code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_every_shipped_file_is_sound_in_its_full_version() -> None:
    for name in shipped():
        assert len(load_sweep(name, "short").runs) <= len(load_sweep(name, "full").runs)


def test_every_shipped_file_is_valid(capsys: pytest.CaptureFixture[str]) -> None:
    assert {"tabular", "encodings", "rewards", "maze_by_size", "maze_by_goals"} <= set(shipped())
    assert {"chaser_by_size", "evader_by_size", "dqn_one_goal", "presets"} <= set(shipped())
    for name in shipped():
        assert load_sweep(name, "short").title
    main(["sweep", "--list"])
    assert "maze_by_size" in capsys.readouterr().out
    with pytest.raises(ValueError, match="no such sweep file"):
        load_sweep("chasers")


# -- running ---------------------------------------------------------------------------------------


def test_a_sweep_runs_reports_and_is_not_repeated(
    swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, curves = collect(swept)
    assert runs["status"].to_list() == ["complete"] * 4
    before = {path: path.stat().st_mtime_ns for path in swept.glob("runs/*/results.json")}
    main(["sweep", write(tmp_path / "tiny.toml", TABULAR), "--out", str(swept)])
    assert "4 complete already" in capsys.readouterr().out
    assert before == {path: path.stat().st_mtime_ns for path in before}
    assert set(curves["run"].to_list()) == set(runs["run"].to_list())
    assert (runs["frames"] >= 2000).all()


def test_the_tables_are_the_same_to_polars_pandas_and_duckdb(swept: Path) -> None:
    pandas = pytest.importorskip("pandas")
    duckdb = pytest.importorskip("duckdb")
    collect(swept)
    path = swept / RUNS
    ours = polars.read_parquet(path)
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
    assert polars.read_parquet(swept / CURVES)["run"].n_unique() == 4


def test_a_folder_of_other_settings_or_another_version_is_refused(
    swept: Path, tmp_path: Path
) -> None:
    sweep = load_sweep(write(tmp_path / "tiny.toml", TABULAR))
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
        collect(out)
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
    sweep = load_sweep(write(tmp_path / "tiny.toml"))
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
    sweep, out = load_sweep(path), tmp_path / "out"
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
    runs, _ = collect(out)
    assert runs["status"].to_list() == ["failed"] * 2
    assert "SIGKILL" in "".join(runs["error"].to_list())
    # Repeated: the killed run resumes from its checkpoint, the broken one fails again.
    with pytest.raises(SystemExit) as exit_:
        main(["sweep", path, "--out", str(out), "--workers", "2"])
    assert exit_.value.code == 1
    printed = capsys.readouterr()
    assert "failed" in printed.err and str(broken / "error.txt") in printed.err
    assert status_of(victim) == "complete" and not (victim / "error.txt").exists()
    assert "1 complete, 1 failed" in printed.out


@pytest.mark.slow
def test_control_c_saves_and_the_sweep_resumes(tmp_path: Path) -> None:
    text = TINY.replace("frames = 2000", "frames = 400000").replace("[0, 1]", "[0]")
    path = write(tmp_path / "tiny.toml", text.replace('"a2c", "q_learning"', '"a2c"'))
    out = tmp_path / "out"
    command = [sys.executable, "-m", "train.commands.main", "sweep", path, "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not list(out.glob("runs/*/checkpoint.pt")):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "Continue with: pursuit sweep" in errors
    assert "Traceback" not in errors
    states = [status_of(folder) for folder in out.glob("runs/*")]
    assert "interrupted" in states and "failed" not in states


def test_the_time_left_follows_what_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = SweepWatch()
    monkeypatch.setattr(time, "monotonic", lambda: watch.began + 30.0)
    statuses = {"a": "complete", "b": "running", "c": "new", "d": "new"}
    assert watch.seconds_left(statuses, {"b": 0.5}) == pytest.approx(30.0 / 1.5 * 2.5)
    watch.done_before = {"a"}  # before it began
    assert watch.seconds_left(statuses, {"b": 0.5}) == pytest.approx(30.0 / 0.5 * 2.5)
    assert watch.seconds_left(statuses, {"b": 0.0}) is None


# -- reports ---------------------------------------------------------------------------------------


def test_a_report_says_what_the_runs_found(swept: Path) -> None:
    from PIL import Image

    folder = report_on(swept)
    text = (folder / "report.md").read_text()
    assert text.startswith("# Tiny") and "4 runs, seeds 0, 1" in text
    runs, _ = collect(swept)
    table = polars.read_csv(folder / "table.csv")
    assert len(table) == 2
    for row in table.to_dicts():
        chosen = runs.filter(
            (polars.col("maze") == row["maze"]) & (polars.col("algorithm") == row["group"])
        )
        assert row["seeds"] == 2
        assert row["gap"] == pytest.approx(100 * chosen["optimality_gap"].mean())
    for name in ("final.png", "learning_curves.png"):
        with Image.open(folder / name) as picture:
            assert min(picture.size) > 300
        assert f"({name})" in text


def test_a_report_says_which_policy_was_evaluated(swept: Path) -> None:
    rows = [row | {"_x": "", "_group": ""} for row in collect(swept)[0].to_dicts()]
    for kinds, told in (
        (("greedy",), "Steps are those of the greedy policy and "),
        (("sampled",), "Steps are those of the sampled policy and "),
        (("sampled", "greedy"), "Steps are those of the greedy or sampled policy and "),
    ):
        given = [row | {"evaluate": kinds[n % len(kinds)]} for n, row in enumerate(rows)]
        assert told in " ".join(sentences(given))


def test_a_report_of_nothing_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(SystemExit) as exit_:
            main(["report", str(folder)])
        assert exit_.value.code == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
