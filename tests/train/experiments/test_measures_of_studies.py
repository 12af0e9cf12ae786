"""Tables, curves and notes of a study hold one measure: references, optimum and results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from executed_here import executed_here

from train.commands.main import main
from train.experiments import figures
from train.experiments.measures import measure_of_rows
from train.experiments.rows import read_study
from train.experiments.summary import sweep_table

FILE = """
episodes = 20
seeds = [1, 2]
[settings]
{settings}
algorithm = "ppo"
maze = "3x3"
max_steps = 8
frames = 2000
num_games = 16
rollout_steps = 5
minibatch_size = 40
width = 8
"""
GAMES = {
    "outcome": 'task = "escape"\nrole = "{role}"\nnum_exits = 1',
    "mean_goals": 'task = "race"\nnum_goals = 1',
    "mean_return": 'task = "heist"\nrole = "{role}"\nnum_goals = 1',
}


@pytest.mark.parametrize(
    ("column", "role"),
    [("outcome", "chaser"), ("outcome", "evader"), ("mean_goals", ""), ("mean_return", "chaser")],
)
def test_references_of_a_study_are_in_its_measure(column: str, role: str, tmp_path: Path) -> None:
    path, out = tmp_path / "study.toml", tmp_path / "out"
    path.write_text(FILE.format(settings=GAMES[column].format(role=role)))
    with executed_here():
        main(["sweep", str(path), "--out", str(out), "--workers", "1"])
    study = read_study(out)
    measure = measure_of_rows(study.rows)
    assert measure.column == column
    (line,) = sweep_table(study.rows, study.x).rows
    runs: list[dict[str, Any]] = [
        json.loads((out / "runs" / str(row["run"]) / "results.json").read_text())
        for row in study.rows
    ]

    def mean(name: str) -> float:
        values = [score[column] for run in runs for score in run["scores"] if score["name"] == name]
        assert len(values) == 2
        return sum(values) / 2

    scripted = str(study.rows[0]["scripted"])
    assert line["random"] == pytest.approx(mean("random"))
    assert line["scripted"] == pytest.approx(mean(scripted))
    optimal = mean(f"optimal {column.removeprefix('mean_')}")
    assert line["optimal"] == pytest.approx(optimal)
    learned = sum(run["evaluation"][column] for run in runs) / 2
    assert line[measure.name] == pytest.approx(learned)
    sign = -1.0 if runs[0]["objective"]["less_is_better"] else 1.0
    assert line["behind the optimum"] == pytest.approx(sign * (optimal - learned), abs=1e-9)
    assert line["behind the optimum"] >= -1e-9 and "learned" not in line
    levels = figures.levels_of(measure, study.rows)
    assert [level.value for level in levels] == [
        line[name] for name in ("random", "scripted", "optimal")
    ]
    report = (out / "report" / "report.md").read_text()
    assert "steps until capture" not in report
