"""Ablations: statistics against other libraries and published formulas, files and reports."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.stats import mannwhitneyu

from train.commands.main import main
from train.experiments import ablation_report
from train.experiments.ablation import ABLATIONS, load_ablation
from train.experiments.ablation_report import correct, same_results, summary, verdict
from train.experiments.forms import Hints
from train.experiments.learning_curves import Curve
from train.experiments.report import report_on
from train.experiments.statistics import (
    first_below,
    improvement,
    interquartile_mean,
    mean_interval,
    mean_over,
    permutation_p,
    probability_of_improvement,
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
max_steps = 40
num_games = 32
minibatch_size = 128

[[variants]]
name = "none"

[[variants]]
name = "near first"
curriculum = "goal-spread-start"

[[variants]]
name = "fewer goals first"
curriculum = "num-goals"
"""


NEAR = """[[variants]]
name = "near first"
curriculum = "goal-spread-start"

"""


def test_two_variants_of_equal_settings_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "tiny.toml"
    path.write_text(TINY + '[[variants]]\nname = "again"\ncurriculum = "num-goals"\n')
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


def test_the_interquartile_mean_allows_infinite_values() -> None:
    assert interquartile_mean([1.0, 2.0, 3.0, float("inf")]) == 2.5
    assert interquartile_mean([1, 2, 3, 100]) == 2.5


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
    assert probability_of_improvement([[2.0] * 3], [[2.0] * 3])[0] == 0.5
    assert np.isnan(probability_of_improvement([[1.0]], [[2.0]])[1][0])


def test_times_and_areas() -> None:
    assert first_below([1, 2, 3], [9.0, 5.0, 7.0], 5.0) == 2
    assert first_below([1, 2, 3], [9.0, 5.0, 7.0], 4.0) == float("inf")
    assert mean_over([0, 1, 3], [0.0, 1.0, 1.0]) == pytest.approx(2.5 / 3)
    assert mean_over([2], [7.0]) == 7.0


def curve(shortfalls: list[float], seed: int, task: str = "") -> Curve:
    places = np.arange(1.0, len(shortfalls) + 1)
    values = np.array(shortfalls)
    optimality = 1 / (1 + values / 100)
    stages = (values * 0, values * np.nan)
    return Curve(places, 1e6 * places, values, optimality, *stages, values[-1], seed, task)


def test_gaps_not_reached_count_as_infinite_times() -> None:
    reaching = curve([50.0, 4.0, 1.0], 0)
    never = [curve([50.0, 40.0, 30.0], seed) for seed in (1, 2)]
    row = summary("variant", [reaching, *never], never)
    assert (row["reached_5"], row["runs"]) == (1, 3)
    assert row["seconds_to_5"] == float("inf")  # the median of 2 s and twice never
    row = summary("variant", [reaching, curve([3.0, 2.0, 1.0], 1), never[0]], never)
    assert (row["seconds_to_5"], row["frames_to_5"], row["reached_2"]) == (2.0, 2e6, 2)


def test_areas_and_times_of_several_tasks_are_compared_within_them() -> None:
    easy = [curve([50.0, value], seed, "easy") for seed, value in enumerate((1.0, 1.1, 1.2))]
    hard = [curve([900.0, 900.0, 900.0 - seed, 4.0], seed, "hard") for seed in range(3)]
    row = summary("variant", easy + hard, easy + hard)
    areas = [[mean_over(c.frames, c.optimality) for c in task] for task in (easy, hard)]
    # Runs of one task are nearly equal; differences between tasks are no uncertainty.
    low, high = mean_interval(areas)
    assert (row["area_low"], row["area_high"]) == pytest.approx((low, high))
    assert row["area"] == pytest.approx((low + high) / 2) and high - low < 0.01
    # One run more of the easy task does not move the mean over tasks towards it.
    more = summary("variant", [*easy, easy[1], *hard], easy + hard)
    assert more["area"] == pytest.approx(row["area"], abs=1e-3)

    sooner = [curve([50.0, 1.0, 1.0], seed, "easy") for seed in range(3)]
    later = [curve([50.0, 50.0, 1.0], seed, "easy") for seed in range(3)]
    never = [curve([900.0, 900.0], seed, "hard") for seed in range(30)]
    alone = summary("variant", sooner, later)["p_to_5"]
    # A task in which no run reaches the gap has no effect.
    assert summary("variant", sooner + never, later + never)["p_to_5"] == pytest.approx(alone)
    assert summary("variant", sooner + never, later)["p_to_5"] == pytest.approx(alone)
    assert np.isnan(summary("variant", sooner, [])["p_to_5"])


def test_the_p_value_is_mann_and_whitneys_where_there_are_no_ties() -> None:
    rng = np.random.default_rng(0)
    for ours, theirs in ((3, 3), (4, 4), (5, 3), (7, 6)):
        own, other = rng.normal(size=ours), rng.normal(0.8, size=theirs)
        exact = mannwhitneyu(own, other, method="exact").pvalue
        assert permutation_p([list(own)], [list(other)]) == pytest.approx(exact)
    assert permutation_p([[1, 2, 3]], [[4, 5, 6]]) == pytest.approx(0.1)
    assert permutation_p([[1, 2, 3, 4]], [[5, 6, 7, 8]]) == pytest.approx(2 / 70)
    assert permutation_p([[1.0]], [[2.0, 3.0]]) == pytest.approx(2 / 3, abs=0.02)
    # Two tasks: differences of opposite sign cancel.
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


def verdicts(hints: Hints, **variants: list[Curve]) -> list[str]:
    rows = [summary(name, curves, variants["none"]) for name, curves in variants.items()]
    correct(rows, hints)
    return [verdict(row, hints) for row in rows]


def test_a_verdict_needs_a_significant_difference() -> None:
    hints = Hints("", control="none", variants=["none", "variant"])
    control = [curve([50.0, 20.0 + seed], seed) for seed in range(5)]
    for shift, wanted in ((-15.0, "better"), (15.0, "worse"), (0.0, "no difference shown")):
        variant = [curve([50.0, 20.0 + seed + shift], seed) for seed in range(5)]
        told = verdicts(hints, none=control, variant=variant)
        assert told[0] == "control" and told[1].startswith(wanted)
    three = verdicts(hints, none=control[:3], variant=[curve([1.0], seed) for seed in range(3)])
    assert three[1] == "too few runs for p < 0.05 (p = 0.10)"
    assert verdicts(hints, none=control[:1], variant=control[:1])[1] == "too few runs"


def test_p_is_corrected_except_for_the_primary_variant() -> None:
    control = [curve([50.0, 20.0 + seed], seed) for seed in range(5)]
    better = [curve([50.0, 5.0 + seed], seed) for seed in range(5)]
    variants = {"none": control, **{name: better for name in "abcdefg"}}
    told = verdicts(Hints("", control="none"), **variants)
    assert {*told[1:]} == {"no difference shown (p = 0.056)"}  # 7 times 2 of 252 splits
    told = verdicts(Hints("", control="none", primary="b"), **variants)
    assert told[2] == "better (p = 0.008, primary)" and told[1] == "better (p = 0.048)"


def test_variants_are_equal_only_within_the_given_margin() -> None:
    control = [curve([50.0, 20.0 + 0.1 * seed], seed) for seed in range(5)]
    variants = {"none": control, "variant": control}
    assert verdicts(Hints("", control="none"), **variants)[1].startswith("no difference")
    assert verdicts(Hints("", control="none", margin=1.0), **variants)[1][:15] == "equal within 1 "
    told = verdicts(Hints("", control="none", margin=0.1), **variants)[1]
    assert told.startswith("no difference shown")


def test_the_share_of_frames_on_the_hardest_stage() -> None:
    def taught(*shares: float) -> Curve:
        return replace(curve([5.0] * len(shares), 0), on_hardest=np.array(shares))

    assert taught(0.0, 0.0, 0.0, 0.0).settled == 0.0
    assert taught(0.0, np.nan, 0.5, 1.0).settled == 0.5
    assert np.isnan(taught(np.nan, np.nan).settled)


# -- files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.slow] * (n != "opponent-epsilon"))
        for n in shipped(ABLATIONS)
        if not n.startswith("self-play")
    ],
)
def test_both_versions_of_every_shipped_ablation_are_valid(name: str) -> None:
    for version in ("short", "full"):
        plan = load_ablation(name, version)
        variants, seeds = plan.report["variants"], {run.settings.seed for run in plan.runs}
        assert len(plan.runs) == len(variants) * len(seeds) and len(seeds) >= 3
        control = [r for r in plan.runs if r.label["variant"] == plan.report["control"]]
        assert all(run.settings.curriculum == "none" for run in control)
        # Equal budgets, and the same task to be evaluated on.
        assert len({(run.settings.seconds, run.settings.frames) for run in plan.runs}) == 1
        assert len({run.settings.task for run in plan.runs}) == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'control = "none"',
            'control = "none"\nprimary = "none"',
            "not a variant other",
        ),
        ('control = "none"', 'control = "none"\nmargin = 0', "margin=0"),
        ('control = "none"', 'control = "none"\nthreshold = 7', "threshold=7; give one of"),
        ('control = "none"', "", "control=None is not a variant"),
        ('control = "none"', 'control = "nobody"', "control='nobody' is not a variant"),
        ('name = "near first"', 'name = "none"', "a different name"),
        (
            'name = "near first"',
            'name = "near first"\nframes = 10',
            "sets frames; all variants have",
        ),
        ('name = "near first"', 'name = "near first"\nseed = 7', "sets seed; all variants have"),
        ("num-goals", "num-stars", "unknown curriculum 'num-stars'"),
        ("[[variants]]", "[[arms]]", r"\[\[arms\]\] was renamed"),
        ('curriculum = "num-goals"', 'curriculum = "opponent-epsilon"', "needs opponents"),
        ('task = "maze"', 'task = "heist"', "exact optimum of task 'heist' .* is not known"),
        ('task = "maze"', 'task = "race"\nnum_goals = 2', "'race' is scored by goals, but an abl"),
    ],
)
def test_bad_files_are_refused_before_anything_runs(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        load_ablation(write(tmp_path / "bad.toml", TINY.replace(old, new)))


def test_variants_with_equal_results_are_named() -> None:
    one, other = [curve([30.0, 5.0], seed) for seed in (1, 2)], [curve([30.0, 4.0], 1)]
    (said,) = same_results({"none": one, "shuffled": one[::-1], "linear": [*other, one[1]]})
    assert said.startswith("Variants none and shuffled have equal results")


@pytest.fixture(scope="module")
def ablated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a complete ablation: four runs, each a process."""
    folder = tmp_path_factory.mktemp("ablated")
    file = write(folder / "tiny.toml", TINY.replace(NEAR, ""))
    main(["ablate", file, "--out", str(folder / "out")])
    return folder


def test_an_ablation_runs_reports_and_is_not_repeated(
    ablated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ablated / "out"
    text = (out / "report" / "report.md").read_text()
    for variant in ("none", "fewer goals first"):
        assert re.search(rf"\| {variant} \| [^|]+ \| 2 \|", text)
    assert "control |" in text and "P(better than none)" in text
    assert "Budget per run: 6,000 frames." in text
    assert "frames on the hardest stage" in text and "below 80 % is marked" in text
    for name in ("final.png", "variants.png"):
        assert (out / "report" / name).stat().st_size > 15_000
    stamps = {p: p.stat().st_mtime_ns for p in out.glob("runs/*/results.json")}
    assert len(stamps) == 4
    main(["ablate", str(ablated / "tiny.toml"), "--out", str(out)])
    assert "4 complete already" in capsys.readouterr().out
    assert {p: p.stat().st_mtime_ns for p in stamps} == stamps
    main(["report", str(out)])
    assert "Tiny" in capsys.readouterr().out
    main(["report", str(out), "--x", "frames", "--log", "--out", str(ablated / "curves")])
    table = (ablated / "curves" / "table.csv").read_text().splitlines()
    names = ["none", "fewer goals first"]
    assert [row.split(",")[0] for row in table[1:]] == names
    methods = (out / "report" / "methods.md").read_text()
    assert "| runs | 4 |" in methods and "| role | runner |" in methods


@pytest.mark.parametrize(("asked", "drawn"), [(None, "frames"), ("seconds", "seconds")])
def test_variants_with_budgets_in_frames_are_drawn_over_frames(
    ablated: Path, monkeypatch: pytest.MonkeyPatch, asked: str | None, drawn: str
) -> None:
    units: list[Any] = []
    draw = ablation_report.draw_panels

    def panels(path: Path, grid: Any, unit: str, *rest: Any, **how: Any) -> None:
        units.append(unit)
        draw(path, grid, unit, *rest, **how)

    monkeypatch.setattr(ablation_report, "draw_panels", panels)
    report_on(ablated / "out", asked)
    assert units == [drawn]


def test_all_variants_are_evaluated_at_the_same_final_difficulty(ablated: Path) -> None:
    out = ablated / "out"
    runs = polars.read_parquet(out / RUNS)
    assert runs["optimal_steps"].n_unique() == 1 and runs["random_steps"].n_unique() == 1
    curves = polars.read_parquet(out / CURVES)
    # Training starts in easier stages than the task itself.
    taught = runs.filter(polars.col("variant") == "fewer goals first")["run"].to_list()
    stages: Any = curves.filter(polars.col("run").is_in(taught)).group_by("run").first()["stage"]
    assert (stages < 3).all()
