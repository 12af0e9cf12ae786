"""The table and the figures of a sweep, or of several folders of runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.statistics import (
    CUT_AT_0,
    Interval,
    distance_interval,
    interquartile_mean,
    mean_interval,
)
from train.experiments.tables import FinishedStudy
from train.reports.curves import SINGLE_RUNS, Panel, Series, draw_panels
from train.reports.figures import PALETTE, Estimate, draw_intervals, time_scale
from train.reports.tables import Column, ResultTable, Row, numeric
from train.runs.folder import RUN

REFERENCES = {
    "random": "random_steps",
    "scripted": "scripted_steps",
    "optimal": "optimal_steps",
    "learned": "mean_steps",
    "chaser vs A*": "chaser_vs_astar",
    "evader vs A*": "evader_vs_astar",
}
"""Further columns of tables, if the runs have them: means over seeds."""
HEADS = {
    "objective_gap": "gap of the objective's optimum, %",
    "success": "success, %",
    "less": "less than at the start, %",
    "least": "of the worst seed, %",
}
COLUMNS = 4
"""Maximum number of panels per row."""


@dataclass(frozen=True)
class Measure:
    """The measure by which runs are compared.

    Attributes:
        name: in tables.
        column: in the tables of runs and of their evaluations, to be multiplied by `factor`.
        label: in figures and headers.
        scale: of its axis (`Panel.scale`).
    """

    name: str
    column: str
    label: str
    scale: str
    factor: float = 1.0

    def interval(self, values: Sequence[float]) -> Interval:
        """The 95 % interval of the mean over runs; other measures than returns are not negative."""
        signed = self.column == "mean_return"
        return mean_interval([values]) if signed else distance_interval([values])


GAP = Measure("gap", "optimality_gap", "gap to the optimum, %", "gap", 100.0)
STEPS = Measure("steps", "mean_steps", "steps", "log")


def measure_of(rows: list[Row]) -> Measure:
    """The gap if the optimum of every run is known, otherwise steps; the objective for self-play.

    Args:
        rows: complete runs of one kind. If only some games of self-play are exact, the measure is
            steps.
    """
    objectives = {(row["objective"], row["unit"]) for row in rows}
    column, unit = objectives.pop() if len(objectives) == 1 else ("steps", "steps")
    if column == "mean_steps":
        known = all(row.get("optimality_gap") is not None for row in rows)
        return GAP if known else STEPS
    name = "NashConv" if column == "nash_conv" else column.replace("_", " ")
    label = name if name.endswith(unit) else f"{name} ({unit})"
    return Measure(column, column, label, "linear" if column == "mean_return" else "from 0")


def sweep_report(
    study: FinishedStudy, folder: Path, unit: str | None, log: bool
) -> tuple[ResultTable, list[str], list[str]]:
    """Draw the figures of a sweep.

    Args:
        study: the runs.
        folder: of the figures.
        unit: of training time, frames or seconds; that of the budget if None.
        log: whether its axis is logarithmic.

    Returns:
        The table, sentences about it, and the names of the figures.
    """
    rows, x = study.rows, study.x
    groups = list(dict.fromkeys(row["_group"] for row in rows))
    colors = {name: PALETTE[place % len(PALETTE)] for place, name in enumerate(groups)}
    figures = []
    if x and len({row["_x"] for row in rows}) > 1:
        draw_final(folder / "final.png", study, colors)
        figures.append("final.png")
    if unit is None:
        in_frames = all(row["budget_frames"] is not None for row in rows)
        unit = "frames" if in_frames else "seconds"
    draw_curves(folder / "learning_curves.png", study, unit, colors, log)
    table = table_of(rows, x)
    return table, sentences(rows), [*figures, "learning_curves.png"]


def size_of(value: Any) -> tuple[Any, ...]:
    """A sort key that orders 3x3 before 10x10, and numbers by value."""
    text = str(value)
    digits = "".join(c if c.isdigit() or c == "." else " " for c in text).split()
    return (float(digits[0]) if digits else 0.0, text)


# -- figures ---------------------------------------------------------------------------------------


def draw_curves(
    path: Path, study: FinishedStudy, unit: str, colors: Mapping[str, str], log: bool
) -> None:
    """The measure over seconds or frames: one panel per x, one colour per group."""
    measure = measure_of(study.rows)
    panels: list[Panel] = []
    for value in sorted({row["_x"] for row in study.rows}, key=size_of):
        series = []
        for name, color in colors.items():
            curves = []
            for row in study.rows:
                if (row["_x"], row["_group"]) == (value, name):
                    evaluations = study.by_run.get(row["run"], [])
                    known = [e for e in evaluations if e.get(measure.column) is not None]
                    times = np.array([e[unit] for e in known]) * time_scale(unit)
                    values = measure.factor * np.array([e[measure.column] for e in known])
                    curves += [(times, values)] if known else []
            if curves:
                series.append(Series(curves, name, color, interval=measure.interval))
        title = f"{study.x.replace('_', ' ')} {value}" if study.x else ""
        first = measure.label if not len(panels) % COLUMNS else ""
        panels.append(Panel(series, first, title, measure.scale))
    grid = [panels[first : first + COLUMNS] for first in range(0, len(panels), COLUMNS)]
    note = f"{SINGLE_RUNS.format('mean')}, or a band, their interval"
    draw_panels(path, grid, unit, study.hints.title, beside=True, log=log, note=note)


def draw_final(path: Path, study: FinishedStudy, colors: Mapping[str, str]) -> None:
    """The final measure for every x, with intervals."""
    rows, measure = study.rows, measure_of(study.rows)
    keys = sorted(
        {(row["_x"], row["_group"]) for row in rows},
        key=lambda key: (size_of(key[0]), list(colors).index(key[1])),
    )
    several = len(keys) > len({value for value, _ in keys})
    estimates = []
    for x, group in keys:
        final = [measure.factor * row[measure.column] for row in rows
                 if (row["_x"], row["_group"]) == (x, group)]  # fmt: skip
        ends = measure.interval(final)
        legend = group if several else None
        mean = float(np.mean(final))
        estimates.append(Estimate(str(x), mean, *ends, final, colors[group], legend))
    panels = {measure.label: ("gap" if measure is GAP else "linear", estimates)}
    draw_intervals(path, panels, study.hints.title, str(study.x).replace("_", " "))


# -- the table -------------------------------------------------------------------------------------


def reduction(before: float, after: float) -> float:
    """The reduction in per cent; 0 if it was 0."""
    return 100.0 * (1.0 - after / before) if before else 0.0


def summary(rows: list[Row], x: str | None) -> list[Row]:
    """One row for each x and group: means over seeds with their intervals, gaps in per cent."""
    measure, table = measure_of(rows), []
    keys = dict.fromkeys((row["_x"], row["_group"]) for row in rows)
    known = {name for name in rows[0] if all(row.get(name) is not None for row in rows)}
    for value, name in sorted(keys, key=lambda key: size_of(key[0])):
        chosen = [row for row in rows if (row["_x"], row["_group"]) == (value, name)]

        def mean(column: str, chosen: list[Row] = chosen) -> float:
            return float(np.mean([row[column] for row in chosen]))

        line: Row = {x: value} if x else {}
        line |= {"group": name, "seeds": len(chosen)}
        line |= {word: mean(column) for word, column in REFERENCES.items() if column in known}
        values = [measure.factor * row[measure.column] for row in chosen]
        low, high = measure.interval(values)
        unit = measure.name
        line |= {unit: float(np.mean(values)), f"{unit}_low": low, f"{unit}_high": high}
        line[f"{unit}_iqm"] = interquartile_mean(values)
        before = f"{measure.column}_at_start"
        if before in known:
            less = [reduction(row[before], row[measure.column]) for row in chosen]
            line |= {"less": float(np.mean(less)), "least": min(less)}
        if measure is GAP and "objective_gap" in known:
            line["objective_gap"] = 100.0 * mean("objective_gap")
        if "success_rate" in known:
            line["success"] = 100.0 * mean("success_rate")
        table.append(line | {"seconds": mean("seconds"), "frames": mean("frames")})
    return table


def table_of(rows: list[Row], x: str | None) -> ResultTable:
    """The summary of runs as a table."""
    table, measure = summary(rows, x), measure_of(rows)
    unit = measure.name
    heads = HEADS | {unit: f"{measure.label} [95 %]", f"{unit}_iqm": "interquartile mean"}
    columns = []
    for name in table[0]:
        head = heads.get(name, name.replace("_", " "))
        if name in (x, "group"):
            columns.append(Column(head, partial(_setting, name), left=True))
        elif name == unit:
            columns.append(Column(head, partial(_with_interval, name)))
        elif name not in (f"{unit}_low", f"{unit}_high", "frames"):
            whole = name in ("seeds", "success", "seconds")
            columns.append(numeric(head, name, ".0f" if whole else "z.2f"))
    return ResultTable(table, columns)


def _setting(name: str, row: Row) -> str:
    return f"{row[name]:g}" if isinstance(row[name], float) else str(row[name])


def _with_interval(name: str, row: Row) -> str:
    ends = f" [{row[f'{name}_low']:z.2f}, {row[f'{name}_high']:z.2f}]"
    return f"{row[name]:z.2f}" + ("" if np.isnan(row[f"{name}_low"]) else ends)


def sentences(rows: list[Row]) -> list[str]:
    """The explanation of the table and the figures."""
    measure = measure_of(rows)
    single = all(row["kind"] == RUN for row in rows)
    lines = [
        "Intervals: 95 %, Student's, of the mean over seeds. Overlap of intervals is not a test of "
        "a difference"
        + (" (`pursuit ablate` makes one)." if single else ".")
        + " Mean curves end with their shortest run."
    ]
    if measure is GAP:
        lines.append(CUT_AT_0)
    if measure in (GAP, STEPS):
        kinds = " or ".join(sorted({str(row["evaluate"]) for row in rows}))
        lines.append(f"Steps are those of the {kinds} policy and include truncated episodes.")
    elif measure.name == "nash_conv":
        lines.append(
            "NashConv is exact, of the current policies; 0 is an equilibrium. Against A*: expected "
            "steps until capture."
        )
    if measure is GAP and all(row.get("objective_gap") is not None for row in rows):
        lines.append(
            "The gap of the objective's optimum is that of a policy with the best discounted "
            "return, not of the learner: exact, over all starts."
        )
    return lines
