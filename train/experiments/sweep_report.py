"""The tables and figures of a sweep."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.forms import Hints
from train.experiments.measures import GAP, STEPS, Measure, measure_of, size_of
from train.experiments.statistics import interquartile_mean
from train.experiments.tables import FinishedStudy
from train.reports.curves import Level, Panel, Series, draw_panels
from train.reports.figures import PALETTE, Estimate, Look, draw_intervals, time_scale
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
"""What stands beside the measure in tables, where the runs have it: means over seeds."""
HEADS = {
    "floor": "floor of the objective, %",
    "success": "success, %",
    "less": "less than at the start, %",
    "least": "of the worst seed, %",
}
COLUMNS = 4
"""Panels side by side, at most."""


def sweep_report(
    study: FinishedStudy, folder: Path, look: Look
) -> tuple[ResultTable, list[str], list[str]]:
    """Draw the figures of a sweep.

    Returns:
        The table, sentences about it, and the names of the figures.
    """
    rows, title = study.rows, study.hints.title
    x = put_groups(rows, study.hints, study.columns)
    groups = list(dict.fromkeys(row["_group"] for row in rows))
    colors = {name: PALETTE[place % len(PALETTE)] for place, name in enumerate(groups)}
    figures = []
    if x and len({row["_x"] for row in rows}) > 1:
        draw_final(folder / "final.png", rows, x, colors, title, look)
        figures.append("final.png")
    for unit in units_of(rows) if look.x is None else (look.x,):
        name = f"learning_curves_{unit}.png"
        draw_curves(folder / name, study, unit, x, colors, look)
        figures.append(name)
    table = table_of(rows, summary(rows, x), x)
    return table, sentences(rows, table, figures), figures


def units_of(rows: list[Row]) -> tuple[str, str]:
    """The units of the learning curves' axes, that of the budget first; seconds if it is mixed."""
    in_frames = all(row["budget_frames"] is not None for row in rows)
    return ("frames", "seconds") if in_frames else ("seconds", "frames")


def put_groups(rows: list[Row], hints: Hints, columns: Collection[str]) -> str | None:
    """Say in every row which curve it belongs to ("_group"), and where on the axis ("_x").

    Returns:
        The column on the axis, if there is one.
    """
    x = hints.x if hints.x in columns else None
    group = [name for name in hints.group if name in columns]
    for row in rows:
        usual = ["algorithm"] if row["kind"] == RUN else ["kind"]
        row["_group"] = ", ".join(_word(name, row[name]) for name in group or usual)
        row["_x"] = row[x] if x else ""
    return x


def _word(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"no {name}"
    return f"{name} {value:g}" if isinstance(value, int | float) else str(value)


# -- figures ---------------------------------------------------------------------------------------


def series_of(
    rows: list[Row], by_run: Mapping[str, list[Row]], unit: str, measure: Measure, **style: Any
) -> Series:
    """The curves of runs that belong together; `style` is that of `Series`."""
    scale = measure.scale if measure.curve == measure.final else 1.0
    curves = []
    for row in rows:
        known = [e for e in by_run.get(row["run"], ()) if e.get(measure.curve) is not None]
        times = np.array([e[unit] for e in known]) * time_scale(unit)
        curves.append((times, scale * np.array([e[measure.curve] for e in known])))
    return Series([curve for curve in curves if len(curve[0])], interval=measure.interval, **style)


def draw_curves(
    path: Path, study: FinishedStudy, unit: str, x: str | None, colors: dict[str, str], look: Look
) -> None:
    """The measure over seconds or frames: a panel for each x, a colour for each group."""
    measure = measure_of(study.rows)
    panels: list[Panel] = []
    for value in sorted({row["_x"] for row in study.rows}, key=size_of):
        here = [row for row in study.rows if row["_x"] == value]
        series = [
            series_of(
                [row for row in here if row["_group"] == name],
                study.by_run, unit, measure, label=name, color=color,
            )
            for name, color in colors.items()
        ]  # fmt: skip
        levels = []
        for column, word, style in (
            ("optimal_steps", "optimal", ":"),
            ("scripted_steps", "scripted", "--"),
        ):
            known = [row[column] for row in here if row.get(column) is not None]
            if known and measure.curve == "mean_steps":
                levels.append(Level(float(np.mean(known)), word, style=style))
        title = f"{x.replace('_', ' ')} {value}" if x else ""
        first = measure.curve_label if not len(panels) % COLUMNS else ""
        panels.append(
            Panel([one for one in series if one.curves], first, title, measure.curve_scale, levels)
        )
    grid = [panels[first : first + COLUMNS] for first in range(0, len(panels), COLUMNS)]
    draw_panels(path, grid, unit, look, study.hints.title, beside=True)


def draw_final(
    path: Path, rows: list[Row], x: str, colors: dict[str, str], title: str, look: Look
) -> None:
    """The final measure for every x, with intervals."""
    measure = measure_of(rows)
    keys = sorted(
        {(row["_x"], row["_group"]) for row in rows},
        key=lambda key: (size_of(key[0]), list(colors).index(key[1])),
    )
    several = len(keys) > len({value for value, _ in keys})
    estimates = []
    for key in keys:
        final = [measure.scale * row[measure.final] for row in rows
                 if (row["_x"], row["_group"]) == key]  # fmt: skip
        ends = measure.interval(final)
        group = key[1] if several else None
        estimates.append(
            Estimate(str(key[0]), float(np.mean(final)), *ends, final, colors[key[1]], group)
        )
    scale = "gap" if measure is GAP else "linear"
    panels = {measure.label: (scale, estimates)}
    draw_intervals(path, panels, title, look, x.replace("_", " "))


# -- the table -------------------------------------------------------------------------------------


def reduction(before: float, after: float) -> float:
    """By how many per cent it became less; nothing where it was 0."""
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
        values = [measure.scale * row[measure.final] for row in chosen]
        low, high = measure.interval(values)
        unit = measure.name
        line |= {unit: float(np.mean(values)), f"{unit}_low": low, f"{unit}_high": high}
        line[f"{unit}_iqm"] = interquartile_mean(values)
        before = f"{measure.final}_at_start"
        if before in known:
            less = [reduction(row[before], row[measure.final]) for row in chosen]
            line |= {"less": float(np.mean(less)), "least": min(less)}
        if measure is GAP and "objective_floor" in known:
            line["floor"] = 100.0 * mean("objective_floor")
        if "success_rate" in known:
            line["success"] = 100.0 * mean("success_rate")
        table.append(line | {"seconds": mean("seconds"), "frames": mean("frames")})
    return table


def table_of(rows: list[Row], table: list[Row], x: str | None) -> ResultTable:
    """`summary` of runs as people read it."""
    measure = measure_of(rows)
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


def sentences(rows: list[Row], table: ResultTable, figures: list[str]) -> list[str]:
    """What the table and the figures show."""
    measure, lines = measure_of(rows), []
    single = all(row["kind"] == RUN for row in rows)
    lines.append(
        "Intervals: 95 %, Student's, of the mean over seeds. Nothing is tested here: whether "
        "intervals overlap is no test of a difference"
        + (" (`pursuit ablate` makes one)." if single else ".")
    )
    if measure in (GAP, STEPS):
        kinds = " or ".join(sorted({str(row["evaluate"]) for row in rows}))
        lines.append(
            f"Steps are those of the {kinds} policy; an episode that runs out of time counts with "
            "all its steps."
        )
    elif measure.name == "nash_conv":
        lines.append(
            "NashConv is exact, of the two policies as they are at that moment; 0 is an "
            "equilibrium. Against A*: expected steps until capture."
        )
    if "floor" in table.rows[0]:
        lines.append(
            "The floor of the objective is the gap of the policy that is best by the discounted "
            "rewards: exact, over all starts."
        )
    if len(figures) > 1:
        lines.append("Mean curves end where the shortest of their runs ends.")
    return lines
