"""Rows of finished runs: what they hold, and that a run with a row is not executed again."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of
from executed_here import executed_here
from hypothesis import given
from hypothesis import strategies as st

from train.commands.main import main
from train.experiments import executors
from train.experiments.recorded import TEXTS, read_recorded, record, typed_column
from train.experiments.stages import stages_of
from train.files import read_json

FILE = """
title = "Rows"
kind = "self-play"
control = "latest"
episodes = 20
seeds = [1]
variants = [{ name = "latest" }, { name = "last", average = false, learning_rate = 0.001 }]
[report]
x = "game"
[settings]
frames = 2000
num_games = 32
minibatch_size = 256
width = 8
[grid]
game = ["soccer(rows=2,columns=4)", "goofspiel(cards=2)"]
"""


def study(folder: Path) -> list[str]:
    """The command of the study above, and its file."""
    path = folder / "rows.toml"
    path.write_text(FILE)
    return ["ablate", str(path), "--rows", str(folder / "rows"), "--workers", "1"]


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study that was executed once."""
    folder = tmp_path_factory.mktemp("executed")
    with executed_here():
        main([*study(folder), "--out", str(folder / "first")])
    return folder


def test_a_row_has_the_results_of_its_run(executed: Path) -> None:
    rows = read_recorded(executed / "rows" / "runs.csv")
    assert len(rows) == 4
    for name, row in rows.items():
        results = read_json(executed / "first" / "runs" / name / "results.json")
        found = results["evaluation"]
        assert row["status"] == "complete" and row["frames"] == results["frames"]
        assert row["nash_conv"] == found["nash_conv"]
        assert row["played_nash_conv"] == found["played_nash_conv"]
        convs = results["nash_conv_of"]
        assert {f"nash_conv_{k}": v for k, v in convs.items()}.items() <= row.items()
        assert row["payoff_range"] == results["payoff_range"]
        assert row["mixed_share"] == results["mixed_share"]
        assert float(row["curve"].split()[-1]) == pytest.approx(row["nash_conv"], rel=1e-4)
        assert not [column for column in row if column.startswith(("A_", "player_"))]
    last = [row for row in rows.values() if row["variant"] == "last"]
    assert {row["learning_rate"] for row in last} == {0.001}
    assert {row["seed"] for row in last} == {1}


def test_runs_with_a_row_are_not_executed_again(
    executed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executors, "start_worker", None)  # a run would raise
    main([*study(executed), "--out", str(executed / "second")])
    assert not (executed / "second" / "runs").exists() or not list(
        (executed / "second" / "runs").iterdir()
    )
    first, second = (executed / name / "report" / "table.csv" for name in ("first", "second"))
    assert first.read_text() == second.read_text()


def test_a_failed_run_has_a_row_and_is_executed_again(
    tmp_path: Path, executed: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rows" / "runs.csv"
    rows = read_recorded(executed / "rows" / "runs.csv")
    names = list(rows)
    for name, row in rows.items():
        if name != names[1]:
            record(path, {**row, "status": "failed"} if name == names[0] else row)
    with executed_here():
        main([*study(tmp_path), "--out", str(tmp_path / "out")])
    assert sorted(run.name for run in (tmp_path / "out" / "runs").iterdir()) == sorted(names[:2])
    found = read_recorded(path)
    assert found.keys() == rows.keys()
    for name, row in found.items():  # equal settings have equal results
        assert row["status"] == "complete"
        assert row["nash_conv"] == rows[name]["nash_conv"]


def test_a_run_that_ended_without_its_row_gets_one(tmp_path: Path, executed: Path) -> None:
    out, path = executed / "first", executed / "rows" / "runs.csv"
    rows = read_recorded(path)
    path.unlink()
    main([*study(executed), "--out", str(out)])
    assert read_recorded(path).keys() == rows.keys()


VALUES: dict[str, st.SearchStrategy[Any]] = {
    "whole": st.none() | st.integers(-(2**60), 2**60),
    "number": st.none() | st.floats(allow_nan=False),
    "flag": st.none() | st.booleans(),
    "commit": st.from_regex(r"[0-9a-f]{7}", fullmatch=True),
    "game": st.sampled_from(["goofspiel(cards=4)", 'a "b", c', "1"]),
}


@given(st.lists(st.fixed_dictionaries(VALUES), min_size=1, max_size=4))
def test_values_are_read_as_they_were(rows: list[dict[str, Any]]) -> None:
    for name in VALUES:
        values = [row[name] for row in rows]
        text = ["" if value is None else str(value) for value in values]
        read = typed_column(name, text)
        assert read == values or (name == "number" and read == [*values])
        assert name not in TEXTS or all(isinstance(value, str) for value in read)


def test_rows_of_several_processes_are_all_kept(tmp_path: Path) -> None:
    path = tmp_path / "runs.csv"
    first = {"run": "", "kind": "run", "status": "complete"}

    def add(number: int) -> None:
        own = {"width": number} if number % 2 else {"gamma": 0.5}
        record(path, {**first, "run": f"run-{number}", **own, "seed": number, "frames": 10})

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(add, range(24)))
    rows = read_recorded(path)
    assert {row["seed"] for row in rows.values()} == set(range(24))
    assert rows["run-3"]["width"] == 3 and rows["run-3"]["gamma"] is None
    with path.open(newline="") as file:
        heads = next(csv.reader(file))
    assert heads[:3] == ["run", "kind", "status"] and heads[-2:] == ["seed", "frames"]


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "run,kind,status,seed\n1,2\n", "run\n\xff"])
def test_a_file_without_rows_of_runs_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "runs.csv"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match=r"runs\.csv.*give"):
        read_recorded(path)


def test_a_report_from_another_folder_has_the_runs_of_the_rows(
    executed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The path of the rows is relative to the folder of the study, which may also be moved."""
    whole = tmp_path / "whole"
    shutil.copytree(executed / "rows", whole / "rows")
    monkeypatch.chdir(whole)
    (whole / "rows.toml").write_text(FILE)
    main(["ablate", "rows.toml", "--rows", "rows", "--out", "out"])
    expected = (whole / "out" / "report" / "table.csv").read_text()
    whole.rename(tmp_path / "elsewhere")
    monkeypatch.chdir("/")
    main(["report", str(tmp_path / "elsewhere" / "out")])
    assert (tmp_path / "elsewhere" / "out" / "report" / "table.csv").read_text() == expected
    (tmp_path / "elsewhere" / "rows" / "runs.csv").unlink()
    with pytest.raises(SystemExit):
        main(["report", str(tmp_path / "elsewhere" / "out")])
    assert (tmp_path / "elsewhere" / "out" / "report" / "table.csv").read_text() == expected


DAMAGE: dict[str, tuple[Callable[[list[dict[str, str]]], Any], str]] = {
    "text": (
        lambda rows: rows[1].update(nash_conv="high"),
        "line 3, column nash_conv: 'high'",
    ),
    "infinite": (lambda rows: rows[2].update(nash_conv="inf"), "line 4, column nash_conv: 'inf'"),
    "minus": (lambda rows: rows[0].update(steps="-Infinity"), "line 2, column steps"),
    "doubled": (lambda rows: rows.append(dict(rows[0])), "line 6: a second row of the run"),
    "game": (lambda rows: rows[0].update(game="soccer"), "line 2, column game: 'soccer', but"),
    "budget": (lambda rows: rows[3].update(budget_frames="9"), "line 5, column budget_frames: '9'"),
    "seed": (lambda rows: rows[0].update(seed="7"), "line 2, column seed: '7', but"),
    "kind": (lambda rows: rows[0].update(kind="single"), "line 2, column kind: 'single', but"),
    "variant": (lambda rows: rows[0].update(variant="first"), "line 2, column variant: 'first'"),
    "missing": (lambda rows: [row.pop("game") for row in rows], "the column game is missing"),
    "nameless": (lambda rows: [row.pop("seed") for row in rows], "line 2: no row of a run"),
    "later": (lambda rows: rows[1].update(format="99"), "line 3: has format 99, this version"),
    "no number": (lambda rows: rows[1].update(format="two"), "line 3, column format: 'two'"),
    "time-outs": (
        lambda rows: rows[2].update(format="", objective="outcome"),
        "line 4: has format 1, where time-outs of escapes counted as successes",
    ),
    "NUL": (lambda rows: rows[0].update(commit="\0"), "line 2, column commit: a NUL byte"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_or_contradictory_rows_are_refused_with_their_place(
    damage: str, executed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the command of the study and by its report; nothing that is there is changed."""
    shutil.copytree(executed / "rows", tmp_path / "rows")
    command = [*study(tmp_path), "--out", str(tmp_path / "out")]
    main(command)
    path = tmp_path / "rows" / "runs.csv"
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    change, told = DAMAGE[damage]
    change(rows)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    kept = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file() and p.suffix != ".lock"}
    for arguments in (command, ["report", str(tmp_path / "out")]):
        assert re.search(told, error_of(capsys, *arguments, longest=700)) is not None
    assert {p: p.read_bytes() for p in kept} == kept


@pytest.mark.parametrize("below", ["", "new/folder"])
def test_a_folder_of_rows_that_cannot_be_written_is_an_error_before_the_runs(
    below: str, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="file is no writable folder"):
        stages_of("maze-size", "ablation", None, tmp_path / "out", rows=tmp_path / "file" / below)
    assert not (tmp_path / "out").exists()
