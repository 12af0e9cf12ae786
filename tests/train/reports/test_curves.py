"""Figures over training time: their axis, their legends and what their lines are."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from train.commands.main import main
from train.experiments.figures import Drawing, draw_stages
from train.experiments.rows import StudyRows
from train.experiments.study import Layout
from train.reports import curves
from train.reports.curves import Level, Panel, Series, draw_panels
from train.runs.folder import read_metrics
from train.runs.pictures import curriculum_panel


@pytest.mark.parametrize(
    ("scale", "columns", "beside"),
    [("linear", 1, False), ("from 0", 3, True), ("log", 1, True), ("gap", 3, False)],
)
def test_labels_cover_no_axes_and_no_others(
    scale: str, columns: int, beside: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(curves, "save", lambda figure, *given, **named: drawn.append(figure))
    times, values = np.linspace(0, 9, 30), np.random.default_rng(0).uniform(1, 99, (8, 30))
    series = [Series([(times, row)], f"a long label of line {n}") for n, row in enumerate(values)]
    panel = Panel(series, "value", scale=scale, levels=[Level(50.0, "a reference")])
    draw_panels(tmp_path / "c.png", [[panel] * columns] * 2, "frames", "title", beside=beside)
    (figure,) = drawn
    figure.draw_without_rendering()
    axes = [axis.get_window_extent() for axis in figure.axes]
    legends = [*figure.legends, *(axis.get_legend() for axis in figure.axes)]
    shown = [legend.get_window_extent() for legend in legends if legend is not None]
    for axis in figure.axes:
        beside_it = [text.get_window_extent() for text in axis.texts]
        assert beside or len(beside_it) == len(series) + 1
        assert not any(one.overlaps(other) for one, other in combinations(beside_it, 2))
        shown += beside_it
    assert shown and not any(one.overlaps(box) for one in shown for box in axes)
    page = figure.bbox.padded(1.0)
    assert all(page.contains(*corner) for one in shown for corner in one.corners())


SMALL = ["--maze", "3x3", "--max-steps", "9", "--num-games", "16", "--rollout-steps", "4"]
SMALL += ["--minibatch-size", "32", "--width", "8"]


@pytest.mark.parametrize(
    ("kind", "budget", "label"),
    [
        ("train", ["--frames", "600"], "frames (millions)"),
        ("self-play", ["--seconds", "0.05"], "training time (s)"),
    ],
)
def test_the_axis_has_the_unit_of_the_budget(
    kind: str, budget: list[str], label: str, tmp_path: Path
) -> None:
    main([kind, *SMALL, *budget, "--episodes", "4", "--out", str(tmp_path / "run")])
    drawn = (tmp_path / "run" / "learning_curve.svg").read_text()
    assert label in drawn
    assert len(re.findall(r"frames \(millions\)|training time \(s\)", drawn)) == 1


def test_the_log_says_how_many_episodes_its_means_are_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["train", *SMALL, "--frames", "640", "--no-report", "--out", str(tmp_path / "run")])
    lines = [line for line in capsys.readouterr().out.splitlines() if "episodes" in line]
    rows = read_metrics(tmp_path / "run")
    assert len(rows) == len(lines) == 10
    said = [re.search(r" (\d+) episodes(  return)?", line) for line in lines]
    assert [int(each[1]) for each in said if each] == [row["episodes"] for row in rows]
    assert all(
        bool(each and each[2]) == (row["episodes"] > 0)
        for each, row in zip(said, rows, strict=True)
    )
    frames = sum(row["episodes"] * row.get("episode_length", 0.0) for row in rows)
    assert 640 - 16 * 9 <= frames <= 640  # all but the running episodes


def test_the_lines_of_a_curriculum_are_named() -> None:
    rows = [{"frames": n, "seconds": n, "mean": n, "low": 0.0, "high": 2 * n} for n in range(3)]
    ranged = curriculum_panel(rows, 3.0, "goal-spread", "seconds")
    assert [series.label for series in ranged.series] == ["mean", "least and largest", None]
    even = curriculum_panel([{**row, "low": 1, "high": 1} for row in rows], 3.0, "x", "seconds")
    assert [series.label for series in even.series] == [None]


def test_the_figure_of_variants_says_what_its_lines_are(tmp_path: Path) -> None:
    study = StudyRows(Layout("title", control="none", variants=["none", "annealed"]))
    for variant in study.layout.variants:
        for seed in range(2):
            run = f"{variant}-{seed}"
            study.rows.append({"run": run, "variant": variant, "seed": seed, "_x": ""})
            study.curves[run] = [
                {"frames": 1e5 * n, "optimality_gap": 1.0 / n, "stage": n // 4}
                for n in range(1, 10)
            ]
    assert draw_stages(tmp_path, study, Drawing()) == ["variants.png"]
    texts = " ".join(re.findall(r">([^<>]+)</t", (tmp_path / "variants.svg").read_text()))
    for what in ("Thick: mean", "thin: single runs", "Grey: the control", "optimum", "last stage"):
        assert what in texts
