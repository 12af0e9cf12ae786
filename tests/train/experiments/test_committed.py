"""Rows beside results pages as those of a study file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from train.experiments.committed import (
    ablation_of,
    chosen_trials,
    committed_rows,
    grouped,
    has_all_runs,
    read_table,
    tried_settings,
)

ABLATION = """
title = "made"
control = "none"
seeds = [0, 1]
settings = { task = "chase", role = "chaser", frames = 1000 }
grid = { maze = ["3x3", "4x4"] }
variants = [{ name = "none" }, { name = "n = 100", curriculum = "none" }, { name = "same" }]

[tuning]
mazes = ["5x5", "6x6"]
like = { same = "none" }
short = { samples = 1, frames = 100 }
full = { samples = 2, frames = 100, rungs = 2 }

[tuning.space.all]
learning_rate = { low = 0.001, high = 0.01, scale = "log" }
"""
Row = dict[str, Any]


def row(variant: str, maze: str, seed: int, **more: Any) -> Row:
    found: Row = {"run": "", "kind": "single", "status": "complete", "variant": variant}
    found |= {"maze": maze, "seed": seed, "budget_frames": 1000, "played_nash_conv": None}
    return found | more


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "made.toml"
    path.write_text(ABLATION)
    return path


def test_rows_are_matched_by_settings(path: Path) -> None:
    file = ablation_of(path)
    own = [
        row(variant, maze, seed)
        for variant in ("none", "n = 100", "same")
        for maze in ("3x3", "4x4")
        for seed in (0, 1)
    ]
    others = [row("none", "3x3", 0, budget_frames=2000), row("none", "5x5", 0), row("x", "3x3", 0)]
    own[0]["status"] = "failed"
    study = committed_rows(file, [*others, *own])
    assert study.everything == [one | {"_x": one["maze"]} for one in own]
    assert study.rows == study.everything[1:] and study.x == study.layout.x == "maze"
    assert study.layout.variants == ["none", "n = 100", "same"] and study.layout.control == "none"
    assert has_all_runs(file, study)
    assert not has_all_runs(file, committed_rows(file, own[1:]))


def test_the_chosen_trial_has_the_best_score_of_the_last_rung(path: Path) -> None:
    def trial(variant: str, number: int, gap: float, frames: int = 200, **more: Any) -> list[Row]:
        return [
            {"run": "", "kind": "single", "status": "complete", "maze": maze, "variant": variant}
            | {"trial": number, "rung": 1, "learning_rate": 0.1 * number, "clip": None, "seed": 0}
            | {"budget_frames": frames, "optimality_gap": gap, **more}
            for maze in ("5x5", "6x6")
        ]

    rows = trial("none", 0, 0.1) + trial("none", 1, 0.01) + trial("none", 2, 0.001, frames=100)
    rows += trial("n = 100", 3, 0.2) + trial("n = 100", 0, 0.001)
    rows[-1]["status"] = "failed"
    rows += trial("same", 0, 0.1)
    found = chosen_trials(ablation_of(path), rows)
    assert {name: runs[0]["trial"] for name, runs in found.items()} == {"none": 1, "n = 100": 3}
    assert [len(runs) for runs in found.values()] == [2, 2]
    assert tried_settings(found["none"][0]) == {"learning_rate": 0.1}
    path.write_text(ABLATION.partition("[tuning]")[0])
    assert chosen_trials(ablation_of(path), rows) == {}


def test_cells_of_a_table_have_the_type_of_their_column(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("a,b,c,d\n1,0.5,True,x\n2,,,\n")
    first, second = read_table(path)
    assert first == {"a": 1, "b": 0.5, "c": True, "d": "x"}
    assert second == {"a": 2, "b": None, "c": None, "d": None}
    assert grouped([first, second], "a") == {1: [first], 2: [second]}
    assert grouped([second, first], "a", "b") == {(2, None): [second], (1, 0.5): [first]}
    path.write_text("a,b\n")
    assert read_table(path) == []
