"""The table and figure of an ablation of self-play: NashConv of every variant against the control.

With several mazes in the grid the mazes are the random units: a variant and the control are paired
by maze, after the mean over seeds. With one maze the runs are the units.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.ablation_report import COLORS
from train.experiments.statistics import (
    LEVEL,
    Interval,
    difference_interval,
    holm,
    mean_interval,
    permutation_p,
    sign_flip_p,
)
from train.experiments.tables import FinishedStudy
from train.reports.figures import GREY, Estimate, draw_intervals
from train.reports.tables import Column, ResultTable, Row, numeric
from train.settings.checks import check

LEAST = 1e-3
"""Smaller NashConvs, in discounted steps, count as this one: ratios to 0 are not defined."""
NAN = float("nan")


def self_play_ablation_report(
    study: FinishedStudy, folder: Path, unit: str | None, log: bool
) -> tuple[ResultTable, list[str], list[str]]:
    """Draw the figure of an ablation of self-play; see `sweep_report` for the return values.

    Args:
        study: the runs.
        folder: of the figure.
        unit, log: unused, as there are no curves over training time.

    Raises:
        ValueError: a run without exact NashConv.
    """
    control = str(study.hints.control)
    values = values_by_variant(study)
    rows = [summary(name, values, control) for name in values]
    compared = [row for row in rows if row["variant"] != control]
    for row, p in zip(compared, holm([row["p"] for row in compared]), strict=True):
        row["p_holm"] = p
    estimates = []
    for place, row in enumerate(rows):
        logs = np.log(unit_means(values[row["variant"]]))
        low, high = np.exp(mean_interval([logs.tolist()])).tolist()
        color = GREY if row["variant"] == control else COLORS[place % len(COLORS)]
        estimate = (row["variant"], row["nash_conv"], low, high, np.exp(logs).tolist(), color)
        estimates.append(Estimate(*estimate))
    label = "NashConv (discounted steps)"
    draw_intervals(folder / "final.png", {label: ("log", estimates)}, study.hints.title)
    return table_of(rows, control), sentences(study, values), ["final.png"]


def values_by_variant(study: FinishedStudy) -> dict[str, dict[str, list[float]]]:
    """NashConv of the policies that each variant plays, by variant and maze, one for each seed."""
    names = study.hints.variants
    found: dict[str, dict[str, list[float]]] = {name: {} for name in names}
    for row in sorted(study.rows, key=lambda row: (names.index(row["variant"]), row["seed"])):
        value = row.get("played_nash_conv")
        check(value is not None, f"{row['run']}: no exact NashConv; use duels of at most 49 cells")
        found[row["variant"]].setdefault(str(row["_x"]), []).append(max(float(value or 0), LEAST))
    return {name: mazes for name, mazes in found.items() if mazes}


def unit_means(mazes: dict[str, list[float]]) -> Any:
    """[units]: the mean over seeds of each maze; of one maze the value of each run."""
    if len(mazes) == 1:
        return np.array(next(iter(mazes.values())))
    return np.array([np.mean(runs) for runs in mazes.values()])


def summary(name: str, values: dict[str, dict[str, list[float]]], control: str) -> Row:
    """One variant as a flat row; ratios are of geometric means, to the control."""
    own, other = values[name], values.get(control, {})
    means = unit_means(own)
    row: Row = {"variant": name, "mazes": len(own), "runs": sum(map(len, own.values()))}
    row |= {"nash_conv": float(np.exp(np.log(means).mean())), "worst": float(means.max())}
    ratio: float = NAN
    ends: Interval = (NAN, NAN)
    p, lower = NAN, ""
    if name != control and list(own) == list(other):
        theirs = unit_means(other)
        if len(own) > 1:
            differences = np.log(means) - np.log(theirs)
            ratio, ends = float(differences.mean()), mean_interval([differences.tolist()])
            p, lower = sign_flip_p(differences), f"{(differences < 0).sum()} of {len(own)}"
        else:
            logs = [np.log(means).tolist()], [np.log(theirs).tolist()]
            ratio = float(np.mean(logs[0]) - np.mean(logs[1]))
            ends, p = difference_interval(*logs), permutation_p(*logs)
    low, high = (float(np.exp(end)) for end in ends)
    row |= {"ratio": float(np.exp(ratio)), "ratio_low": low, "ratio_high": high}
    return row | {"lower_in": lower, "p": p, "p_holm": NAN}


def verdict(row: Row, control: str) -> str:
    """The verdict on a variant against the control."""
    if row["variant"] == control:
        return "control"
    if np.isnan(row["p_holm"]):
        return "not compared: other mazes than the control"
    note = f"p = {row['p_holm']:.3g}"
    if row["p_holm"] < LEVEL:
        return f"{'lower' if row['ratio'] < 1.0 else 'higher'} NashConv ({note})"
    return f"no difference shown ({note})"


def table_of(rows: list[Row], control: str) -> ResultTable:
    """The table of all variants."""
    columns = [
        Column("variant", lambda row: str(row["variant"]), left=True),
        Column("verdict", partial(verdict, control=control), left=True),
        numeric("runs", "runs"),
        numeric("NashConv, geometric mean", "nash_conv", ".3f"),
        numeric("worst", "worst", ".3f"),
        Column(f"ratio to {control} [95 %]", _ratio),
        Column(f"mazes below {control}", lambda row: str(row["lower_in"])),
    ]
    return ResultTable(rows, columns)


def _ratio(row: Row) -> str:
    if np.isnan(row["ratio"]):
        return ""
    return f"{row['ratio']:.2f} [{row['ratio_low']:.2f}, {row['ratio_high']:.2f}]"


def sentences(study: FinishedStudy, values: dict[str, dict[str, list[float]]]) -> list[str]:
    """The explanation of the table."""
    budgets = {(row["budget_seconds"], row["budget_frames"]) for row in study.rows}
    budget = "; ".join(f"{s:g} s" if s is not None else f"{f:,} frames" for s, f in budgets)
    several = max(len(mazes) for mazes in values.values()) > 1
    units = (
        "Mazes are the random units: a maze's value is the mean over its seeds. Ratios are paired "
        "by maze, with Student's interval on a logarithmic scale; p is of a two-sided test that "
        "flips the signs of the differences"
        if several
        else "Runs are the units, on one maze: the result holds for that maze. Ratios have Welch's "
        "interval on a logarithmic scale; p is of a two-sided permutation test"
    )
    return [
        f"Budget per run: {budget}.",
        f"{units}, corrected for the number of variants (Holm). The verdict needs p < {LEVEL:g}.",
        "NashConv is exact, in discounted steps, of the policies that a method plays: the last "
        "ones, or the mixture of the snapshots with --sampling uniform, double-oracle and psro "
        "(the lower bound of its interval, which favours these). Values below "
        f"{LEAST:g} count as {LEAST:g}.",
    ]
