"""Shards of a study: their parts, their files of rows, and that killed ones lose nothing."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of
from executed_here import executed_here
from hypothesis import given
from hypothesis import strategies as st
from waiting import wait_until

from train.commands.main import main
from train.experiments.recorded import read_recorded, record
from train.experiments.shards import Shard, row_files
from train.files import hold
from train.reports.tables import Row
from train.runs.folder import read_metrics

SWEEP = """
title = "Shards"
episodes = 20
seeds = [0, 1, 2, 3, 4]
[settings]
task = "maze"
algorithm = "q_learning"
frames = 20000
max_steps = 40
num_games = 32
[grid]
maze = ["2x2", "3x3"]
gamma = [0.9, 1]
[report]
x = "maze"
"""
SHARDS = 10
NUMBERS = range(1, SHARDS + 1)
OF_THE_CLOCK = ("seconds", "per_second", "machine", "commit")
"""Parts of the names of columns that differ between equal runs."""


def results(rows: dict[str, Row]) -> dict[str, Row]:
    """Rows without what differs between equal runs."""
    return {
        run: {n: v for n, v in row.items() if not any(part in n for part in OF_THE_CLOCK)}
        for run, row in rows.items()
    }


def sweep(folder: Path, *options: str) -> list[str]:
    """The command of the study above in a folder."""
    (folder / "s.toml").write_text(SWEEP)
    rows, out = str(folder / "rows"), str(folder / "out")
    return ["sweep", str(folder / "s.toml"), "--rows", rows, "--out", out, *options]


@given(st.lists(st.sampled_from([1.0, 2.0, 30.0]), max_size=60), st.integers(1, 12))
def test_every_run_is_in_one_shard_and_shards_cost_about_the_same(
    costs: list[float], count: int
) -> None:
    names = {f"run-{place}": cost for place, cost in enumerate(costs)}
    parts = [Shard(number, count).chosen(names) for number in range(1, count + 1)]
    assert sorted(name for part in parts for name in part) == sorted(names)
    loads = [sum(names[name] for name in part) for part in parts]
    assert max(loads) - min(loads) <= max(costs, default=0.0)


def test_variants_and_seeds_mix_in_a_shard() -> None:
    """Runs of a study: seeds are the outer loop."""
    names = {f"{seed} {variant}": 60.0 for seed in range(5) for variant in range(5)}
    for number in range(1, 6):
        chosen = Shard(number, 5).chosen(names)
        for part in (0, 1):
            assert len({name.split()[part] for name in chosen}) == 5


def main_here(command: list[str]) -> None:
    """A command whose runs are executed in its process."""
    with executed_here():
        main(command)


class Forked:
    """A command in a process that is forked from one with torch, its runs in the same process."""

    def __init__(self, command: list[str]) -> None:
        context = get_context("forkserver")
        context.set_forkserver_preload(["train.commands.studies", "train.experiments.executors"])
        self.process = context.Process(target=main_here, args=(command,))
        self.process.start()

    def kill(self) -> None:
        self.process.kill()

    def wait(self) -> int | None:
        self.process.join()
        return self.process.exitcode


def started(command: list[str]) -> subprocess.Popen[bytes]:
    """A command as a user starts it."""
    module = [sys.executable, "-m", "train.commands.main"]
    return subprocess.Popen([*module, *command], stdout=subprocess.DEVNULL)


@pytest.mark.parametrize("start", [Forked, pytest.param(started, marks=pytest.mark.slow)])
def test_ten_shards_of_which_three_are_killed_give_the_rows_of_one_command(
    start: Callable[[list[str]], Any], tmp_path: Path
) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    whole.mkdir()
    parts.mkdir()
    commands = {n: sweep(parts, "--shard", f"{n}/{SHARDS}", "--workers", "1") for n in NUMBERS}
    shards = {number: start(command) for number, command in commands.items()}
    for number in (2, 5, 9):  # killed after the first of its two runs
        rows = parts / "rows" / f"runs-{number}-of-{SHARDS}.csv"
        wait_until(lambda rows=rows: rows.exists() and rows.read_bytes())
        shards[number].kill()
        shards[number].wait()
        shards[number] = start(commands[number])
    assert {shard.wait() for shard in shards.values()} == {0}
    files = row_files(parts / "rows" / "runs.csv")
    assert len(files) == SHARDS
    names = [row["run"] for path in files for row in csv.DictReader(path.open())]
    assert len(set(names)) == len(names) == 20
    report = parts / "out" / "report" / "table.csv"
    assert report.exists()  # by the last shard
    main_here(sweep(whole))
    main_here(sweep(parts))  # executes nothing
    assert not (parts / "rows" / "runs.csv").exists()
    expected, merged = (read_recorded(each / "rows" / "runs.csv") for each in (whole, parts))
    assert results(merged) == results(expected)
    for run in (parts / "out" / "runs").iterdir():
        frames = [row["frames"] for row in read_metrics(run)]
        assert len(set(frames)) == len(frames)


def test_a_shard_that_others_execute_is_refused_and_nothing_is_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main_here(sweep(tmp_path, "--shard", "1/10"))
    path = tmp_path / "rows" / "runs-1-of-10.csv"
    before, held = path.read_bytes(), hold(path.parent, "", name=".runs-1-of-10.lock")
    for options in (["--shard", "1/10"], []):  # and all runs, while a shard goes on
        told = error_of(capsys, *sweep(tmp_path, *options))
        assert f"{path.parent}: another shard (runs-1-of-10.csv) uses this folder" in told
    held.release()
    assert path.read_bytes() == before and len(read_recorded(path)) == 2
    main_here(sweep(tmp_path, "--shard", "1/10"))
    said = capsys.readouterr().out
    assert "shard 1/10: 2 of 20 runs" in said and "2 complete already" in said
    merge = f"pursuit {' '.join(sweep(tmp_path))}"
    assert "18 runs are missing; when the other shards have ended, make the " in said
    assert said.endswith(f"report by: {merge}\n")
    assert not (tmp_path / "out" / "report").exists()


@pytest.mark.parametrize("shard", ["11/10", "0/10", "x/y", "3/0", "3", "-1/2", "1/2/3", "²/3"])
def test_a_shard_that_is_none_is_an_error(
    shard: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = error_of(capsys, *sweep(tmp_path, f"--shard={shard}"))
    assert f"shard={shard!r}; give K/N, such as 3/10, with K from 1 to N" in told
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.toml"]


def test_a_shard_needs_a_folder_of_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["sweep", "maze_by_size", "--shard", "1/2"]
    assert "shard='1/2' without rows; give --rows FOLDER" in error_of(capsys, *command)


def test_rows_of_several_files_have_one_type_and_the_complete_row_counts(tmp_path: Path) -> None:
    first = {"run": "a", "kind": "run", "status": "failed", "gamma": 1, "seed": 0, "frames": 10}
    other = {"run": "b", "kind": "run", "status": "complete", "width": 8, "gamma": 0.5, "seed": 1}
    record(tmp_path / "runs.csv", first)
    record(tmp_path / "runs-2-of-2.csv", first | {"status": "complete"})
    record(tmp_path / "runs-1-of-2.csv", other)
    (tmp_path / "runs-1-of-3.csv").touch()  # of a shard that has only begun
    rows = read_recorded(tmp_path / "runs.csv")
    assert [*rows] == ["a", "b"] and rows["a"]["status"] == "complete"
    assert [*rows["a"]] == ["run", "kind", "status", "gamma", "width", "seed", "frames"]
    assert repr(rows["a"]["gamma"]) == "1.0" and rows["a"]["width"] is None


TUNED = """
title = "Tuned"
control = "a"
seeds = [0, 1]
episodes = 20
variants = [{ name = "a" }, { name = "b", entropy_coef = 0.1 }]
[settings]
task = "maze"
maze = "2x2"
algorithm = "a2c"
frames = 2000
max_steps = 40
num_games = 32
[tuning]
mazes = ["3x3"]
[tuning.space.all]
learning_rate = { low = 1e-3, high = 1e-2, scale = "log" }
[tuning.short]
samples = 2
frames = 1000
rungs = 2
[tuning.full]
samples = 2
frames = 1000
"""


def test_shards_search_settings_rung_by_rung(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every one ends where the next rung needs the trials of others; the last one goes on."""
    (tmp_path / "t.toml").write_text(TUNED)

    def said(out: str, *shard: str) -> list[str]:
        rows = [] if out == "whole" else ["--rows", str(tmp_path / "rows")]
        main_here(["ablate", str(tmp_path / "t.toml"), "--out", str(tmp_path / out), *rows, *shard])
        return [line for line in capsys.readouterr().out.splitlines() if "runs" in line]

    one, two = (["--shard", "1/2"], ["--shard", "2/2"])
    first = said("one", *one)
    assert len(first) == 2 and "rung 1, shard 1/2: 2 of 4 runs" in first[0]
    assert first[1] == "2 runs are missing; when the other shards have ended, start all again"
    assert ["rung 2" in line for line in said("two", *two)] == [False, True, False]
    assert "make the report by: pursuit ablate" in said("one", *one)[-1]
    assert "missing" not in said("two", *two)[-1]  # it also has the trial of rung 2 of the other
    said("whole")
    tables = [tmp_path / out / "report" / "trials.csv" for out in ("whole", "two")]
    assert tables[0].read_text() == tables[1].read_text()


def test_the_array_job_of_the_page_and_the_command_after_it_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = Path(__file__).parents[3] / "docs" / "guides" / "sweeps.md"
    slurm = page.read_text(encoding="utf-8").partition("\n## SLURM\n")[2]
    array, merge, *_ = re.findall(r"^pursuit (sweep .+)$", slurm, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    full = SWEEP.replace("seeds = [0, 1, 2, 3, 4]\n", "") + "[full]\nseeds = [0]\n"
    (tmp_path / "chasers.toml").write_text(full)
    for number in NUMBERS:  # of which six have nothing to do
        main_here(array.replace("$SLURM_ARRAY_TASK_ID", str(number)).split())
        reports = (tmp_path / "out" / "report" / "table.csv").exists()
        assert reports == (len(read_recorded(tmp_path / "rows" / "runs.csv")) == 4)
    main_here(merge.split())
