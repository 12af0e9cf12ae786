"""Ablations: statistics against third parties and published formulas; files; reports that tell."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import mannwhitneyu

from train.commands.main import main
from train.experiments.ablation import ABLATIONS, load_ablation
from train.experiments.ablation_figures import Curve
from train.experiments.ablation_report import summary, verdict
from train.experiments.statistics import (
    first_below,
    improvement,
    interquartile_mean,
    interquartile_means,
    mean_over,
    permutation_p,
    probability_of_improvement,
    stratified_interval,
)
from train.experiments.sweep import shipped
from train.experiments.tables import CURVES, RUNS

TINY = """
title = "Tiny"
control = "none"
episodes = 20
seeds = [0, 1]

[settings]
task = "maze"
maze = "3x3"
frames = 6000
num_games = 32
minibatch_size = 128

[[arms]]
name = "none"

[[arms]]
name = "near first"
curriculum = "goal-spread-start"

[[arms]]
name = "fewer goals first"
curriculum = "num-goals"
"""


def test_two_arms_of_equal_settings_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "tiny.toml"
    path.write_text(TINY + '[[arms]]\nname = "again"\ncurriculum = "num-goals"\n')
    with pytest.raises(ValueError, match=r"'fewer goals first'.* and .*'again' have equal"):
        load_ablation(str(path))


def write(path: Path, text: str = TINY) -> str:
    path.write_text(text)
    return str(path)


# -- statistics ------------------------------------------------------------------------------------


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40))
def test_the_interquartile_mean_is_scipys_trimmed_mean(values: list[float]) -> None:
    four = np.repeat(values, 4)  # a multiple of four: nothing is cut in two
    assert interquartile_mean(list(four)) == pytest.approx(stats.trim_mean(four, 0.25), abs=1e-9)
    assert min(values) - 1e-9 <= interquartile_mean(values) <= max(values) + 1e-9


def test_the_interquartile_mean_bears_what_never_got_there() -> None:
    assert interquartile_mean([1.0, 2.0, 3.0, float("inf")]) == 2.5
    assert interquartile_means([[1, 2, 3, 100], [4, 4, 4, 4]]).tolist() == [2.5, 4.0]


@given(
    st.lists(st.integers(0, 6), min_size=1, max_size=9),
    st.lists(st.integers(0, 6), min_size=1, max_size=9),
)
def test_improvement_is_mann_and_whitneys_u(ours: list[int], theirs: list[int]) -> None:
    u = stats.mannwhitneyu(theirs, ours).statistic  # pairs in which ours is lower, ties half
    found = improvement(np.array(ours, float), np.array(theirs, float))
    assert float(found) == pytest.approx(u / (len(ours) * len(theirs)))


def test_the_probability_of_improvement_over_tasks_is_their_mean() -> None:
    point, (low, high) = probability_of_improvement([[1, 2, 3], [5, 6]], [[4, 5, 6], [5, 6]])
    assert point == pytest.approx((1.0 + 0.5) / 2) and low < point < high
    assert probability_of_improvement([[1.0] * 3], [[2.0] * 3]) == (1.0, (1.0, 1.0))
    assert probability_of_improvement([[2.0] * 3], [[2.0] * 3]) == (0.5, (0.5, 0.5))
    assert np.isnan(probability_of_improvement([[1.0]], [[2.0]])[1][0])


def test_the_stratified_interval_is_scipys_where_there_is_one_stratum() -> None:
    values = np.random.default_rng(1).exponential(size=30)
    theirs = stats.bootstrap(
        (values,), np.mean, method="percentile", n_resamples=20_000, rng=np.random.default_rng(2)
    ).confidence_interval
    ours = stratified_interval([values.tolist()], lambda x: np.asarray(x).mean(axis=-1))
    width = theirs.high - theirs.low
    assert ours == pytest.approx((theirs.low, theirs.high), abs=0.06 * width)


def test_strata_are_never_mixed() -> None:
    def seen(values: NDArray[np.float64]) -> Any:
        assert set(np.unique(values[..., :2])) <= {1.0, 2.0}
        assert set(np.unique(values[..., 2:])) <= {100.0, 200.0, 300.0}
        return values.mean(axis=-1)

    low, high = stratified_interval([[1.0, 2.0], [100.0, 200.0, 300.0]], seen)
    assert 60.0 < low < high < 182.0
    # Two tasks of very different size, each with equal seeds: nothing is uncertain.
    assert stratified_interval([[1.0, 1.0], [9.0, 9.0]]) == (5.0, 5.0)
    # One seed tells nothing of the spread of its task.
    assert np.isnan(stratified_interval([[1.0, 2.0], [9.0]])).all()


def test_the_interval_covers_the_truth_about_as_often_as_it_says() -> None:
    rng, covered = np.random.default_rng(0), 0
    for _ in range(200):
        low, high = stratified_interval([rng.standard_normal(20).tolist()])
        covered += low <= 0.0 <= high
    assert 0.85 < covered / 200 <= 1.0


def test_times_and_areas() -> None:
    assert first_below([1, 2, 3], [9.0, 5.0, 7.0], 5.0) == 2
    assert first_below([1, 2, 3], [9.0, 5.0, 7.0], 4.0) == float("inf")
    assert mean_over([0, 1, 3], [0.0, 1.0, 1.0]) == pytest.approx(2.5 / 3)
    assert mean_over([2], [7.0]) == 7.0


def curve(shortfalls: list[float], seed: int, task: str = "") -> Curve:
    places = np.arange(1.0, len(shortfalls) + 1)
    values = np.array(shortfalls)
    optimality = 1 / (1 + values / 100)
    ends = (values[-1], values[-1], values[-1] + 1.0)
    return Curve(places, 1e6 * places, values, optimality, values * 0, *ends, seed, task)


def test_what_was_never_reached_counts_as_late_not_as_missing() -> None:
    reaching = curve([50.0, 4.0, 1.0], 0)
    never = [curve([50.0, 40.0, 30.0], seed) for seed in (1, 2)]
    row = summary("arm", [reaching, *never], never)
    assert (row["reached_5"], row["runs"]) == (1, 3)
    assert row["seconds_to_5"] == float("inf")  # the median of 2 s and twice never
    row = summary("arm", [reaching, curve([3.0, 2.0, 1.0], 1), never[0]], never)
    assert (row["seconds_to_5"], row["frames_to_5"], row["reached_2"]) == (2.0, 2e6, 2)


def test_the_p_value_is_mann_and_whitneys_where_there_are_no_ties() -> None:
    rng = np.random.default_rng(0)
    for ours, theirs in ((3, 3), (4, 4), (5, 3), (7, 6)):
        own, other = rng.normal(size=ours), rng.normal(0.8, size=theirs)
        exact = mannwhitneyu(own, other, method="exact").pvalue
        assert permutation_p([list(own)], [list(other)]) == pytest.approx(exact)
    assert permutation_p([[1, 2, 3]], [[4, 5, 6]]) == pytest.approx(0.1)
    assert permutation_p([[1, 2, 3, 4]], [[5, 6, 7, 8]]) == pytest.approx(2 / 70)
    assert permutation_p([[1.0]], [[2.0, 3.0]]) == pytest.approx(2 / 3, abs=0.02)
    # Two tasks: both must be apart in the same sense to count.
    alike = permutation_p([[1, 2, 3], [4, 5, 6]], [[4, 5, 6], [1, 2, 3]])
    apart = permutation_p([[1, 2, 3], [1, 2, 3]], [[4, 5, 6], [4, 5, 6]])
    assert alike == pytest.approx(1.0) and apart == pytest.approx(2 / 400, abs=0.003)


def test_the_p_value_of_several_tasks_is_that_of_all_splits_within_them() -> None:
    rng = np.random.default_rng(3)
    ours = [rng.normal(size=size).round(1).tolist() for size in (4, 3)]
    theirs = [rng.normal(0.8, size=4).round(1).tolist() for _ in range(2)]
    every = []
    for own, other in zip(ours, theirs, strict=True):
        pool = np.array([*own, *other])
        splits = [list(chosen) for chosen in combinations(range(len(pool)), len(own))]
        every.append([float(improvement(pool[s], np.delete(pool, s))) for s in splits])
    apart = abs(np.add.outer(*map(np.array, every)) / 2 - 0.5)
    found = abs(probability_of_improvement(ours, theirs)[0] - 0.5)
    exact = float(np.mean(apart >= found - 1e-9))
    assert 0.01 < exact < 0.5 and permutation_p(ours, theirs) == pytest.approx(exact, abs=0.01)


def test_a_verdict_needs_more_than_chance() -> None:
    control = [curve([50.0, 20.0 + seed], seed) for seed in range(5)]
    for shift, wanted in ((-15.0, "better"), (15.0, "worse"), (0.0, "no difference shown")):
        arm = [curve([50.0, 20.0 + seed + shift], seed) for seed in range(5)]
        assert verdict(summary("arm", arm, control), "none").startswith(wanted)
    three = summary("arm", [curve([1.0], seed) for seed in range(3)], control[:3])
    assert verdict(three, "none") == "no difference shown (p = 0.10)"
    assert verdict(summary("none", control, control), "none") == "control"
    one = summary("arm", control[:1], control[:1])
    assert verdict(one, "none") == "nothing can be said"


# -- files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] * (n == "mazes")) for n in shipped(ABLATIONS)],
)
def test_every_shipped_ablation_is_sound_in_both_versions(name: str) -> None:
    for version in ("short", "full"):
        plan = load_ablation(name, version)
        arms, seeds = plan.report["arms"], {run.settings.seed for run in plan.runs}
        assert len(plan.runs) == len(arms) * len(seeds) and len(seeds) >= 3
        control = [r for r in plan.runs if r.label["variant"] == plan.report["control"]]
        assert all(run.settings.curriculum == "none" for run in control)
        # Equal budgets, and the same task to be evaluated on.
        assert len({(run.settings.seconds, run.settings.frames) for run in plan.runs}) == 1
        assert len({run.settings.task for run in plan.runs}) == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('control = "none"', "", "control=None is none of the arms"),
        ('control = "none"', 'control = "nobody"', "control='nobody' is none of the arms"),
        ('name = "near first"', 'name = "none"', "all different"),
        ('name = "near first"', 'name = "near first"\nframes = 10', "sets frames; arms have equal"),
        ('name = "near first"', 'name = "near first"\nseed = 7', "sets seed; arms have equal"),
        ("num-goals", "num-stars", "unknown curriculum 'num-stars'"),
        ("[[arms]]", "[[variants]]", r"called \[\[arms\]\]"),
        ('curriculum = "num-goals"', 'curriculum = "opponent-epsilon"', "needs opponents"),
        ('task = "maze"', 'task = "heist"', "exact optimum of task 'heist' .* is not known"),
    ],
)
def test_bad_files_are_refused_before_anything_runs(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        load_ablation(write(tmp_path / "bad.toml", TINY.replace(old, new)))


@pytest.fixture(scope="module")
def ablated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a complete ablation."""
    folder = tmp_path_factory.mktemp("ablated")
    file = write(folder / "tiny.toml")
    main(["ablate", file, "--out", str(folder / "out")])
    return folder


def test_an_ablation_runs_reports_and_is_not_done_again(
    ablated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ablated / "out"
    text = (out / "report" / "report.md").read_text()
    for arm in ("none", "near first", "fewer goals first"):
        assert f"| {arm} | 2 |" in text
    assert "control |" in text and "P(better than none)" in text and "6,000 frames each" in text
    for name in ("final.png", "arms.png"):
        assert (out / "report" / name).stat().st_size > 15_000
    stamps = {p: p.stat().st_mtime_ns for p in out.glob("runs/*/results.json")}
    assert len(stamps) == 6
    main(["ablate", str(ablated / "tiny.toml"), "--out", str(out)])
    assert "6 complete already" in capsys.readouterr().out
    assert {p: p.stat().st_mtime_ns for p in stamps} == stamps
    main(["report", str(out)])
    assert "Tiny" in capsys.readouterr().out
    main(["report", str(out), "--x", "frames", "--log", "--out", str(ablated / "curves")])
    table = (ablated / "curves" / "table.csv").read_text().splitlines()
    names = ["none", "near first", "fewer goals first"]
    assert [row.split(",")[0] for row in table[1:]] == names
    assert "6 agents (runner)" in (out / "report" / "methods.md").read_text()


def test_all_arms_are_evaluated_at_the_same_final_difficulty(ablated: Path) -> None:
    out = ablated / "out"
    runs = polars.read_parquet(out / RUNS)
    assert runs["optimal_steps"].n_unique() == 1 and runs["random_steps"].n_unique() == 1
    curves = polars.read_parquet(out / CURVES)
    # The training difficulty stands beside: the lessons begin below the task's own.
    taught = runs.filter(polars.col("variant") == "fewer goals first")["run"].to_list()
    lessons: Any = curves.filter(polars.col("run").is_in(taught)).group_by("run").first()["lesson"]
    assert (lessons < 3).all()
