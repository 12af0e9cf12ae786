"""The table and figures of an ablation: every variant against the control."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.forms import THRESHOLDS, Hints
from train.experiments.learning_curves import NAN, Curve, VariantCurves, curves_by_variant, strata
from train.experiments.statistics import (
    CUT_AT_0,
    LEVEL,
    Interval,
    difference_interval,
    distance_interval,
    first_below,
    holm,
    least_p,
    logrank_p,
    mean_over,
    permutation_p,
    probability_of_improvement,
)
from train.experiments.tables import FinishedStudy
from train.reports.curves import SINGLE_RUNS, Panel, Series, draw_panels
from train.reports.figures import GREY, PALETTE, Estimate, draw_intervals
from train.reports.tables import Column, ResultTable, Row, in_markdown

SPENT = 0.8
"""Variants with a smaller share of frames on the hardest stage are marked."""
LINES = (
    f"{SINGLE_RUNS.format('mean')}, or a band, their interval. Grey: the control. Dotted: the "
    "optimum (horizontal), and for each run the start of its last stage (vertical)"
)
COLORS = tuple(color for color in PALETTE if color != GREY)


def ablation_report(
    study: FinishedStudy, folder: Path, unit: str | None, log: bool
) -> tuple[ResultTable, list[str], list[str]]:
    """Draw the figures of an ablation; arguments and return values are those of `sweep_report`.

    Raises:
        ValueError: the folder is not that of an ablation.
    """
    hints, variants = study.hints, curves_by_variant(study)
    control = variants.get(str(hints.control), [])
    rows = [summary(name, curves, control) for name, curves in variants.items()]
    correct(rows, hints)
    if unit is None:  # without a budget in frames all runs have the same seconds
        in_frames = all(row.get("budget_frames") for row in study.rows)
        unit = "frames" if in_frames else "seconds"
    draw_final(folder / "final.png", rows, variants, hints)
    figures = ["final.png"]
    for task in dict.fromkeys(curve.task for curves in variants.values() for curve in curves):
        name = re.sub(r"[^A-Za-z0-9_.+-]+", "_", f"variants{'-' + task if task else ''}.png")
        here = {
            variant: [c for c in curves if c.task == task] for variant, curves in variants.items()
        }
        title = hints.title + (f" ({task})" if task else "")
        shown = {variant: curves for variant, curves in here.items() if curves}
        grid = panels_of(shown, str(hints.control), unit)
        draw_panels(folder / name, grid, unit, title, beside=True, log=log, note=LINES)
        figures.append(name)
    table = table_of(rows, hints)
    return table, [*same_results(variants), *sentences(study, hints)], figures


# -- figures ---------------------------------------------------------------------------------------


def draw_final(path: Path, rows: list[Row], variants: VariantCurves, hints: Hints) -> None:
    """Final gaps and probabilities of improvement with their intervals, one line per variant."""
    gaps, better = [], []
    for place, row in enumerate(rows):
        variant, own = row["variant"], row["variant"] == hints.control
        color = GREY if own else COLORS[place % len(COLORS)]
        finals = [curve.final for curve in variants[variant]]
        gaps.append(Estimate(variant, row["gap"], row["gap_low"], row["gap_high"], finals, color))
        ends = row["improvement"], row["improvement_low"], row["improvement_high"]
        value, low, high = (NAN, NAN, NAN) if own else ends
        better.append(Estimate(variant, value, low, high, color=color))
    panels = {
        "final gap to the optimum (%)": ("gap", gaps),
        f"P(better than {hints.control})": ("share", better),
    }
    draw_intervals(path, panels, hints.title)


def panels_of(variants: VariantCurves, control: str, unit: str) -> list[list[Panel]]:
    """Two panels per variant: the gaps, with the control in grey, and the stage of the curriculum.

    A dotted line marks the start of the last stage of a run.
    """
    names = [name for name in variants if name != control] or [control]
    grid: list[list[Panel]] = []
    for first in range(0, len(names), 4):
        upper: list[Panel] = []
        lower: list[Panel] = []
        for name in names[first : first + 4]:
            color = COLORS[list(variants).index(name) % len(COLORS)]
            series = [
                Series(
                    [(c.time(unit), c.shortfall) for c in variants.get(variant, [])],
                    variant if variant == control else None, shade,
                    interval=lambda values: distance_interval([values]),
                )
                for variant, shade in ((control, GREY), (name, color))
            ]  # fmt: skip
            marks = [(c.time(unit)[c.settled_at - 1], color) for c in variants[name]
                     if c.settled_at > 0]  # fmt: skip
            label = "" if upper else "gap to the optimum (%)"
            upper.append(Panel(series, label, name, "gap", marks=marks))
            stages = [Series([(c.time(unit), c.stage)], None, color, width=1.0)
                      for c in variants[name] if not np.isnan(c.stage).all()]  # fmt: skip
            label = "" if lower else "trained on"
            note = "the task itself" if name == control else "levels instead of stages"
            note = "" if stages else note
            lower.append(Panel(stages, label, marks=marks, note=note, height=1.5))
        grid += [upper, lower]
    return grid


# -- the table -------------------------------------------------------------------------------------


def finals_of(curves: Sequence[Curve]) -> list[list[float]]:
    """The final shortfalls of each task."""
    return [[curve.final for curve in task] for task in strata(curves)]


def summary(name: str, curves: list[Curve], control: list[Curve]) -> Row:
    """One variant as a flat row, with gaps in per cent, and times in seconds and frames.

    Times are medians over seeds; inf if at least half of the runs do not reach the gap.
    """
    finals = finals_of(curves)
    row: Row = {"variant": name, "runs": len(curves)}

    def put(name: str, value: float, interval: Interval) -> None:
        row.update({name: value, f"{name}_low": interval[0], f"{name}_high": interval[1]})

    def mean(tasks: list[list[float]]) -> float:
        return float(np.mean([np.mean(each) for each in tasks]))

    put("gap", mean(finals), distance_interval(finals))
    row |= {"best": min(map(min, finals)), "worst": max(map(max, finals))}
    for threshold in THRESHOLDS:
        for unit in ("seconds", "frames"):
            times = [first_below(getattr(c, unit), c.shortfall, threshold) for c in curves]
            row[f"reached_{threshold:g}"] = int(np.isfinite(times).sum())
            row[f"{unit}_to_{threshold:g}"] = _median(times)
    areas = [[mean_over(c.frames, c.optimality) for c in task] for task in strata(curves)]
    put("area", mean(areas), distance_interval(areas))
    row["settled"] = float(np.mean([c.settled for c in curves]))
    empty = (NAN, NAN)
    better: tuple[float, Interval] = (NAN, empty)
    p, apart = NAN, empty
    if control and {c.task for c in curves} == {c.task for c in control}:
        theirs = finals_of(control)
        better, p = probability_of_improvement(finals, theirs), permutation_p(finals, theirs)
        apart = difference_interval(finals, theirs, 1.0 - 2.0 * LEVEL)
    put("improvement", *better)
    row |= {"p": p, "apart_low": apart[0], "apart_high": apart[1]}
    for threshold in THRESHOLDS:
        row[f"p_to_{threshold:g}"] = _p_of_times(curves, control, threshold)
    return row


def _p_of_times(curves: list[Curve], control: list[Curve], threshold: float) -> float:
    """p of the log-rank test of frames to a gap, stratified by task; nan without a control."""
    tasks = {c.task for c in [*curves, *control]}
    times, ends = [], []
    for side in (strata(curves, tasks), strata(control, tasks)):
        times.append([[first_below(c.frames, c.shortfall, threshold) for c in t] for t in side])
        ends.append([[float(c.frames[-1]) for c in t] for t in side])
    return logrank_p(times[0], times[1], (ends[0], ends[1]))


def _median(times: Sequence[float]) -> float:
    """The median, with inf for runs that do not reach the gap."""
    ordered = sorted(times)
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def correct(rows: list[Row], hints: Hints) -> None:
    """Add `p_holm` and `p_time`: p corrected for the number of variants.

    The p of the primary variant is not corrected.
    """
    others = [row for row in rows if row["variant"] not in (hints.control, hints.primary)]
    for name, source in (("p_holm", "p"), ("p_time", f"p_to_{hints.threshold:g}")):
        for row in rows:
            row[name] = NAN if row["variant"] == hints.control else row[source]
        for row, p in zip(others, holm([row[source] for row in others]), strict=True):
            row[name] = p


def verdict(row: Row, hints: Hints) -> str:
    """The verdict on a variant against the control."""
    if row["variant"] == hints.control:
        return "control"
    p, margin = row["p_holm"], hints.margin
    if np.isnan(row["improvement_low"]):
        return "too few runs"
    note = f"p = {_p(p)}" + (", primary" if row["variant"] == hints.primary else "")
    if p < LEVEL:
        return f"{'better' if row['improvement'] > 0.5 else 'worse'} ({note})"
    if margin is not None and -margin < row["apart_low"] <= row["apart_high"] < margin:
        return f"equal within {margin:g} points ({note})"
    if least_p([(row["runs"], row["runs"])]) >= LEVEL:
        return f"too few runs for p < {LEVEL:g} ({note})"
    return f"no difference shown ({note})"


def table_of(rows: list[Row], hints: Hints) -> ResultTable:
    """The table of all variants, from rows of `summary` after `correct`."""
    control = hints.control
    columns = [
        Column("variant", lambda row: str(row["variant"]), left=True),
        Column("verdict", lambda row: verdict(row, hints), left=True),
        Column("runs", lambda row: str(row["runs"])),
        Column("final gap, mean, % [95 %]", partial(_with_interval, "gap")),
        Column(
            "best to worst", lambda row: " to ".join(map(_number, (row["best"], row["worst"])))
        ),
        *(
            Column(f"to {t:g} %: seconds, frames (runs)", partial(_time, f"{t:g}"))
            for t in THRESHOLDS
        ),
        Column(f"log-rank p, to {hints.threshold:g} %", lambda row: _p(row["p_time"])),
        Column("optimality over training [95 %]", partial(_with_interval, "area")),
        Column("frames on the hardest stage", lambda row: _settled(row["settled"])),
        Column(
            f"P(better than {control}) [95 %]",
            lambda row: "" if row["variant"] == control else _with_interval("improvement", row),
        ),
    ]  # fmt: skip
    return ResultTable(rows, columns)


def _p(p: float) -> str:
    return "" if np.isnan(p) else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def _settled(share: float) -> str:
    if np.isnan(share):
        return ""
    return f"{100 * share:.0f} %" + ("" if share >= SPENT else f", below {100 * SPENT:.0f} %")


def _time(threshold: str, row: Row) -> str:
    reached, runs = row[f"reached_{threshold}"], row["runs"]
    seconds, frames = row[f"seconds_to_{threshold}"], row[f"frames_to_{threshold}"]
    if not np.isfinite(seconds):
        return f"median not reached ({reached} of {runs})"
    scale, unit = (1e6, "M") if frames >= 1e6 else (1e3, "k")
    return f"{_number(seconds)}, {_number(frames / scale)} {unit} ({reached} of {runs})"


def _with_interval(name: str, row: Row) -> str:
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    ends = "" if np.isnan(low) else f" [{_number(low)}, {_number(high)}]"
    return _number(row[name]) + ends


def _number(value: float) -> str:
    if np.isinf(value):
        return "never"
    size = abs(value)
    return f"{value:.0f}" if size >= 100 else f"{value:.1f}" if size >= 10 else f"{value:z.2f}"


def same_results(variants: VariantCurves) -> list[str]:
    """A sentence for each pair of variants with equal results in all evaluations of all runs."""

    def results(curves: list[Curve]) -> list[Any]:
        found = [(c.task, c.seed, *c.frames.tolist(), *c.shortfall.tolist()) for c in curves]
        return sorted(found)

    return [
        f"{in_markdown(f'Variants {one} and {other}')} have equal results in all evaluations of "
        "all runs: their settings make no difference here, and they count as one variant. Change "
        "one of them, or leave it out."
        for one, other in combinations(variants, 2)
        if results(variants[one]) == results(variants[other])
    ]


def sentences(study: FinishedStudy, hints: Hints) -> list[str]:
    """The explanation of the table."""
    budgets = {(row["budget_seconds"], row["budget_frames"]) for row in study.rows}
    budget = "; ".join(f"{s:g} s" if s is not None else f"{f:,} frames" for s, f in budgets)
    kinds = " or ".join(sorted({str(row["evaluate"]) for row in study.rows}))
    lines = [
        f"Budget per run: {budget}.",
        "Every variant is evaluated on the same task at its final difficulty, throughout training. "
        f"The verdict compares its final gaps with those of the control and needs p < {LEVEL:g}. "
        "p: two-sided permutation test of P against 0.5, corrected for the number of variants "
        "(Holm), except for a primary variant. P: probability that a run of the variant ends "
        "closer to the optimum than a run of the control (Mann-Whitney, with Newcombe's interval).",
        f"Gap: per cent by which the {kinds} policy is worse than the exact optimum, mean over "
        f"runs with Student's interval. {CUT_AT_0} If only some runs solve the task, the mean "
        "says little: compare the numbers of runs that reached each gap instead. Times: the first "
        "evaluation at or below the gap, medians over runs, in brackets the number of runs that "
        "reached it; the others count as infinite, and are censored in the log-rank test (of "
        "frames, stratified by task). Optimality: optimum / steps (evaders: steps / optimum), "
        "averaged over the frames of training.",
        "Frames on the hardest stage: share of the training frames in that stage, which is the "
        "evaluated task unless the curriculum ends in another one; below "
        f"{100 * SPENT:.0f} % is marked, as such a variant had less of the budget for it.",
    ]
    if hints.primary is None:
        lines.append("The ablation file names no primary variant, so all p are corrected.")
    else:
        pair = in_markdown(f"{hints.primary} against {hints.control}")
        lines.append(f"Primary comparison, named before the runs: {pair}.")
    if hints.margin is not None:
        lines.append(
            "Variants are called equal if the 90 % interval of the difference of means (Welch) "
            f"lies within {hints.margin:g} points, a margin named before the runs."
        )
    return lines
