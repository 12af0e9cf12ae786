"""Variants against a control, from rows: tests, corrections, verdicts, and what can be decided."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_rel

from train.experiments.rows import StudyRows, curve_measures
from train.experiments.runs import Study
from train.experiments.statistics import (
    holm,
    least_sign_flip_p,
    mean_interval,
    mean_over,
    permutation_p,
    sign_flip_p,
)
from train.experiments.study import Layout
from train.experiments.variants import (
    HARDEST,
    against_control,
    equal_results,
    gap_row,
    hardest_row,
    of_logs,
    out_of_reach,
    paired_row,
    paired_verdict,
    times_row,
)

Row = dict[str, Any]


def run(shortfalls: list[float], seed: int, task: str = "") -> Row:
    """A run with an evaluation every second and million frames; "curve" are these."""
    curve = [
        {"seconds": n, "frames": 1e6 * n, "optimality_gap": value / 100.0}
        for n, value in enumerate(shortfalls, start=1)
    ]
    row: Row = {"kind": "single", "objective": "mean_steps", "seed": seed, "_x": task}
    row |= {"optimality_gap": shortfalls[-1] / 100.0, "frames": curve[-1]["frames"]}
    return row | curve_measures(row, curve) | {"curve": curve}


def study(layout: Layout, **variants: list[Row]) -> StudyRows:
    """A study of these runs."""
    layout.variants = list(variants)
    found = StudyRows(layout)
    for name, rows in variants.items():
        for number, row in enumerate(rows):
            found.rows.append(row | {"variant": name, "run": f"{name}-{number}"})
            found.curves[f"{name}-{number}"] = row["curve"]
    return found


def verdicts(layout: Layout, **variants: list[Row]) -> list[str]:
    return [row["verdict"] for row in against_control(study(layout, **variants))]


def control_of(**options: Any) -> Layout:
    return Layout("", control="none", **options)


def test_gaps_not_reached_count_as_infinite_times() -> None:
    reaching = run([50.0, 4.0, 1.0], 0)
    never = [run([50.0, 40.0, 30.0], seed) for seed in (1, 2)]
    row = gap_row("variant", [reaching, *never], never)
    assert (row["reached_5"], row["runs"]) == (1, 3)
    assert row["seconds_to_5"] == float("inf")  # the median of 2 s and twice never
    row = gap_row("variant", [reaching, run([3.0, 2.0, 1.0], 1), never[0]], never)
    assert (row["seconds_to_5"], row["frames_to_5"], row["reached_2"]) == (2.0, 2e6, 2)


def test_areas_and_times_of_several_tasks_are_compared_within_them() -> None:
    easy = [run([50.0, value], seed, "easy") for seed, value in enumerate((1.0, 1.1, 1.2))]
    hard = [run([900.0, 900.0, 900.0 - seed, 4.0], seed, "hard") for seed in range(3)]
    row = gap_row("variant", easy + hard, easy + hard)
    areas = [
        [
            mean_over(
                [e["frames"] for e in row["curve"]],
                [1.0 / (1.0 + e["optimality_gap"]) for e in row["curve"]],
            )
            for row in task
        ]
        for task in (easy, hard)
    ]
    # Runs of one task are nearly equal; differences between tasks are no uncertainty.
    low, high = mean_interval(areas)
    assert (row["area_low"], row["area_high"]) == pytest.approx((low, high))
    assert row["area"] == pytest.approx((low + high) / 2) and high - low < 0.01
    # One run more of the easy task does not move the mean over tasks towards it.
    more = gap_row("variant", [*easy, easy[1], *hard], easy + hard)
    assert more["area"] == pytest.approx(row["area"], abs=1e-3)

    sooner = [run([50.0, 1.0, 1.0], seed, "easy") for seed in range(3)]
    later = [run([50.0, 50.0, 1.0], seed, "easy") for seed in range(3)]
    never = [run([900.0, 900.0], seed, "hard") for seed in range(30)]
    alone = gap_row("variant", sooner, later)["p_to_5"]
    # A task in which no run reaches the gap has no effect.
    assert gap_row("variant", sooner + never, later + never)["p_to_5"] == pytest.approx(alone)
    assert gap_row("variant", sooner + never, later)["p_to_5"] == pytest.approx(alone)
    assert np.isnan(gap_row("variant", sooner, [])["p_to_5"])


def test_a_verdict_needs_a_significant_difference() -> None:
    control = [run([50.0, 20.0 + seed], seed) for seed in range(5)]
    for shift, wanted in ((-15.0, "better"), (15.0, "worse"), (0.0, "no difference shown")):
        variant = [run([50.0, 20.0 + seed + shift], seed) for seed in range(5)]
        told = verdicts(control_of(), none=control, variant=variant)
        assert told[0] == "control" and told[1].startswith(wanted)
    low = [run([1.0], seed) for seed in range(3)]
    three = verdicts(control_of(), none=control[:3], variant=low)
    assert three[1] == "p < 0.05 could not be reached, at best 0.1 (p = 0.10)"
    assert verdicts(control_of(), none=control[:1], variant=control[:1])[1] == "too few runs"


def test_p_is_corrected_except_for_the_primary_variant() -> None:
    control = [run([50.0, 20.0 + seed], seed) for seed in range(5)]
    better = [run([50.0, 5.0 + seed], seed) for seed in range(5)]
    variants = {"none": control, **{name: better for name in "abcdefg"}}
    told = verdicts(control_of(), **variants)
    beyond = "p < 0.05 could not be reached, at best 0.056 (p = 0.056)"  # 7 times 2 of 252 splits
    assert {*told[1:]} == {beyond}
    told = verdicts(control_of(primary="b"), **variants)
    assert told[2] == "better (p = 0.008, primary)" and told[1] == "better (p = 0.048)"


def test_intervals_that_span_three_orders_of_magnitude_are_left_out() -> None:
    assert of_logs("ratio", 0.0, (-1.0, 1.0))["ratio_low"] == pytest.approx(np.exp(-1.0))
    wide = of_logs("ratio", 0.0, (-8.0, 8.0))
    assert wide["ratio"] == 1.0 and np.isnan([wide["ratio_low"], wide["ratio_high"]]).all()


def test_variants_are_equal_only_within_the_given_margin() -> None:
    control = [run([50.0, 20.0 + 0.1 * seed], seed) for seed in range(5)]
    variants = {"none": control, "variant": control}
    assert verdicts(control_of(), **variants)[1].startswith("no difference")
    assert verdicts(control_of(margin=1.0), **variants)[1][:15] == "equal within 1 "
    told = verdicts(control_of(margin=0.1), **variants)[1]
    assert told.startswith("no difference shown")


def test_the_share_of_the_improvement_in_the_last_third() -> None:
    def share(*lengths: float) -> float | None:
        curve = [{"frames": n, "mean_steps": value} for n, value in enumerate(lengths, start=1)]
        found: float | None = curve_measures({}, curve)["last_share"]
        return found

    assert share(30.0, 20.0, 15.0, 12.0, 11.0, 10.0) == 0.1  # (12 - 10) / (30 - 10)
    assert share(30.0, 20.0, 10.0, 10.0, 12.0, 10.0) == 0.0
    assert share(10.0, 10.0, 10.0) is None
    assert share(10.0, 9.0) is None


def test_the_share_of_frames_on_the_hardest_stage() -> None:
    def share(*hardest: float | None) -> float | None:
        curve = [
            {"seconds": n, "frames": n, "on_hardest": value, "optimality_gap": 0.05}
            for n, value in enumerate(hardest, start=1)
        ]
        found: float | None = curve_measures({"optimality_gap": 0.05}, curve)["hardest_share"]
        return found

    assert share(0.0, 0.0, 0.0, 0.0) == 0.0
    assert share(0.0, None, 0.5, 1.0) == 0.5
    assert share(None, None) is None


def test_variants_that_never_reach_the_hardest_stage_are_marked() -> None:
    rows = [{"hardest_share": share} for share in (0.0, 0.6, 0.0)]
    row = hardest_row(rows) | {"runs": len(rows)}
    assert HARDEST.cell(row) == "20 %, below 80 %; none in 2 of 3 runs"
    assert HARDEST.cell(hardest_row(rows[1:2]) | {"runs": 1}) == "60 %, below 80 %"
    assert HARDEST.cell(hardest_row([{"hardest_share": 0.8}]) | {"runs": 1}) == "80 %"
    assert HARDEST.cell(hardest_row([{"hardest_share": None}, *rows]) | {"runs": 4}) == ""


def test_variants_with_equal_results_are_named() -> None:
    one, other = [run([30.0, 5.0], seed) for seed in (1, 2)], [run([30.0, 4.0], 1)]
    found = study(control_of(), none=one, shuffled=one[::-1], linear=[*other, one[1]])
    assert equal_results(found) == [("none", "shuffled")]


# -- self-play -------------------------------------------------------------------------------------


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

    def runs(factor: Any) -> list[Row]:
        return [
            {"_x": str(maze), "seed": seed, "run": "", "played_nash_conv": float(factor()) * value}
            for maze, value in enumerate(hard.tolist())
            for seed in range(2)
        ]

    control = runs(lambda: 1.0)
    half = runs(lambda: 0.5 * rng.uniform(0.9, 1.1))
    row = paired_row("half", half, control)
    assert row["ratio"] == pytest.approx(0.5, rel=0.1) and row["lower_in"] == "8 of 8"
    assert row["ratio_low"] < row["ratio"] < row["ratio_high"] < 0.6
    values = [np.array([each["played_nash_conv"] for each in own]) for own in (half, control)]
    logs = [np.log(each.reshape(8, 2).mean(axis=1)) for each in values]
    expected = np.exp(ttest_rel(*logs).confidence_interval())
    assert [row["ratio_low"], row["ratio_high"]] == pytest.approx(list(expected))
    row["p_holm"] = row["p"]
    assert paired_verdict(row, control_of()) == "lower NashConv (p = 0.00781)"
    assert np.isnan(paired_row("none", control, control)["ratio"])


def test_single_agents_in_several_mazes_are_paired_by_maze() -> None:
    hard = [0.4, 900.0, 3.0, 40.0, 7.0, 2.0, 88.0, 15.0]  # mazes differ far more than the variants

    def runs(*factors: float) -> list[Row]:
        return [
            run([2000.0, factor * value], seed, f"maze {maze}")
            for maze, value in enumerate(hard)
            for seed, factor in enumerate(factors)
        ]

    found = study(control_of(x="maze", primary="half"), none=runs(1.2, 0.8), half=runs(0.5, 0.4))
    for row in found.rows:
        row["_x"] = row["maze"] = row["_x"]
    found.x = "maze"
    none, half = against_control(found)
    assert none["verdict"] == "control" and none["distance"] == pytest.approx(
        np.exp(np.log(hard).mean())
    )
    assert half["ratio"] == pytest.approx(0.45) and half["lower_in"] == "8 of 8"
    assert half["verdict"] == "lower gap to the optimum (p = 0.00781, primary)"  # 2 of 256 signs
    assert (half["mazes"], half["runs"]) == (8, 16)
    for row in found.rows:  # all at the optimum: no ratio of zeros
        row["shortfall"] = 0.0
    assert against_control(found)[1]["ratio"] == 1.0
    found.rows[0] |= {"shortfall": None, "optimality_gap": None}
    with pytest.raises(ValueError, match="exact optimum of its task is not known"):
        against_control(found)


# -- beforehand ------------------------------------------------------------------------------------


def plan(
    variants: int, tasks: int, seeds: int, kind: str, primary: str | None, x: str = "maze"
) -> Study:
    names = ["control", *(f"v{number}" for number in range(variants))]
    runs: Any = [
        SimpleNamespace(label={"variant": name, x: str(task)}, seed=seed, kind=kind)
        for name in names
        for task in range(tasks)
        for seed in range(seeds)
    ]
    layout = Layout("a plan", variants=names, control="control", primary=primary, x=x)
    layout.analysis = "paired" if x == "maze" else "variants"
    return Study(layout, tuple(runs))


@pytest.mark.parametrize(
    ("kind", "x"), [("single", "num_goals"), ("single", "maze"), ("self-play", "maze")]
)
@pytest.mark.parametrize(("variants", "primary"), [(1, None), (3, None), (3, "v1"), (7, None)])
def test_p_is_out_of_reach_exactly_where_the_most_extreme_runs_do_not_reach_it(
    kind: str, x: str, variants: int, primary: str | None
) -> None:
    for tasks in (1, 2, 6, 9):
        for seeds in (2, 3, 4, 5):
            ours, theirs = [[0.0 + i for i in range(seeds)]], [[50.0 + i for i in range(seeds)]]
            if x == "maze" and tasks > 1:
                p = sign_flip_p(np.arange(1.0, 1.0 + tasks))
            else:
                p = permutation_p(ours * tasks, theirs * tasks)
            corrected = holm([p] * (variants - (primary is not None)))
            lines = " ".join(out_of_reach(plan(variants, tasks, seeds, kind, primary, x)))
            assert ("v0" in lines) == (corrected[0] >= 0.05), (tasks, seeds, lines)
            if primary:
                assert (primary in lines) == (p >= 0.05)
            if x != "maze" and lines and "or more" in lines:  # the remedy is one
                enough = max(int(part.split()[0]) for part in lines.split("give ")[1:])
                assert not out_of_reach(plan(variants, tasks, enough, kind, primary, x))


@pytest.mark.parametrize("seeds", [2, 3, 4, 5])
def test_a_comparison_of_libraries_says_so_too(seeds: int) -> None:
    p = permutation_p([[float(n) for n in range(seeds)]], [[9.0 + n for n in range(seeds)]])
    runs: Any = [SimpleNamespace(seed=seed) for seed in range(seeds)]
    assert bool(out_of_reach(Study(Layout("a plan"), tuple(runs), pinned=True))) == (p >= 0.05)


@pytest.mark.parametrize(
    ("times", "median"),
    [([40, 10, 30], 30.0), ([80, 10, 30, 40], 35.0), ([None, 10, 30, None], np.inf)],
)
def test_median_times_are_infinite_unless_most_runs_reach_the_gap(
    times: list[float | None], median: float
) -> None:
    row = times_row([{"frames_to_5": time} for time in times], [5])
    assert row["frames_to_5"] == median
    assert row["reached_5"] == len(times) - times.count(None)
