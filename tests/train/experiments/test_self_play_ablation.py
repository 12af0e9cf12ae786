"""Ablations of self-play: NashConv of variants, paired by maze."""

from __future__ import annotations

import json
from collections import Counter
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ttest_rel

from train.commands.main import main
from train.experiments.ablation import load_ablation
from train.experiments.self_play_ablation import summary, verdict
from train.experiments.statistics import least_sign_flip_p, sign_flip_p

TINY = """
title = "Tiny"
kind = "self-play"
control = "latest"
seeds = [0]

[grid]
maze = ["2x2", "3x3-tree"]

[report]
x = "maze"

[settings]
frames = 16_000
num_games = 64
minibatch_size = 256
snapshots = 4

[[variants]]
name = "latest"

[[variants]]
name = "uniform"
sampling = "uniform"
"""


@pytest.mark.slow
def test_the_shipped_studies_of_methods_are_valid() -> None:
    for version, mazes, seeds in (("short", 6, 1), ("full", 20, 3)):
        by_seconds, by_frames = (
            load_ablation(f"self-play-methods{ending}", version) for ending in ("", "-frames")
        )
        for study in (by_seconds, by_frames):
            assert len(study.runs) == len(study.report["variants"]) * mazes * seeds
            assert len({(run.settings.seconds, run.settings.frames) for run in study.runs}) == 1
        alike = [
            [
                (run.seed, run.settings.task, run.settings.chaser, run.settings.sampling)
                for run in study.runs
            ]
            for study in (by_seconds, by_frames)
        ]
        assert alike[0] == alike[1]
    tuning = load_ablation("self-play-tuning", None)
    counts = Counter(name.rpartition(" ")[0] for name in tuning.report["variants"])
    assert counts == dict.fromkeys(by_seconds.report["variants"], 4)
    assert not any("test" in run.settings.task.maze for run in tuning.runs)


def test_the_sign_flip_test_counts_all_changes_of_signs() -> None:
    values = np.array([0.3, -0.1, 0.8, 0.2, 0.5])
    means = [abs(np.mean(values * signs)) for signs in product((-1, 1), repeat=5)]
    assert sign_flip_p(values) == pytest.approx(np.mean(np.array(means) >= abs(values.mean())))
    for count in (2, 8, 14, 15, 25):  # above 14 the changes are drawn
        assert sign_flip_p(np.ones(count)) == pytest.approx(least_sign_flip_p(count))
    assert least_sign_flip_p(14) == 2 / 2**14


def test_variants_are_paired_by_maze() -> None:
    rng = np.random.default_rng(0)
    hard = np.exp(rng.normal(0.0, 2.0, 8))  # mazes differ far more than the variants
    runs = {str(maze): [value, value] for maze, value in enumerate(hard.tolist())}
    half = {maze: [0.5 * rng.uniform(0.9, 1.1) * x for x in xs] for maze, xs in runs.items()}
    values = {"control": runs, "half": half}
    row = summary("half", values, "control")
    assert row["ratio"] == pytest.approx(0.5, rel=0.1) and row["lower_in"] == "8 of 8"
    assert row["ratio_low"] < row["ratio"] < row["ratio_high"] < 0.6
    logs = [np.log([np.mean(xs) for xs in mazes.values()]) for mazes in (half, runs)]
    test = ttest_rel(*logs)
    expected = np.exp(test.confidence_interval())
    assert [row["ratio_low"], row["ratio_high"]] == pytest.approx(list(expected))
    row["p_holm"] = row["p"]
    assert verdict(row, "control") == "lower NashConv (p = 0.00781)"
    assert np.isnan(summary("control", values, "control")["ratio"])


def test_an_ablation_of_self_play_reports_nash_conv(tmp_path: Path) -> None:
    file = tmp_path / "tiny.toml"
    file.write_text(TINY)
    main(["ablate", str(file), "--out", str(tmp_path / "out")])
    text = (tmp_path / "out" / "report" / "report.md").read_text()
    assert "| latest | control | 2 |" in text and "ratio to latest" in text
    assert (tmp_path / "out" / "report" / "final.png").stat().st_size > 10_000
    for folder in (tmp_path / "out" / "runs").iterdir():
        content = json.loads((folder / "results.json").read_text())
        evaluation = content["evaluation"]
        uniform = content["sampling"] == "uniform"
        expected = content["mixture_nash_conv"][0] if uniform else evaluation["nash_conv"]
        assert evaluation["played_nash_conv"] == expected


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seeds = [0]", "seeds = [0]\nmargin = 1.0", "margin=1.0 is for single-agent runs"),
        ('maze = ["2x2", "3x3-tree"]', "snapshots = [4]", "maze"),
        ("frames = 16_000", "frames = 16_000\nnum_chasers = 2", "no exact NashConv"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = tmp_path / "tiny.toml"
    file.write_text(TINY.replace(old, new))
    with pytest.raises(ValueError, match=message):
        load_ablation(str(file))
