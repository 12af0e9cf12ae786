"""The analysis "summary": a line for every setting of a sweep, with means over seeds."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from train.evaluation.scores import BY_OUTCOME, UNTIL_CAPTURE
from train.experiments import figures
from train.experiments.measures import (
    GAP,
    REGRET,
    evaluated_policies,
    interval_of,
    measure_of_rows,
    note,
    references_of,
    size_of,
)
from train.experiments.rows import Content, StudyRows
from train.experiments.statistics import bounded, interquartile_mean
from train.reports.tables import Column, ResultTable, Row, numeric, short, with_interval
from train.runs.folder import RUN

HEADS = {
    "objective_gap": "gap of the objective's optimum, %",
    "success": "success, %",
    "less": "less than at the start, %",
    "least": "of the worst seed, %",
}


# -- settings of a sweep ---------------------------------------------------------------------------


def summary(rows: list[Row], x: str | None) -> list[Row]:
    """One row for each x and group: means over seeds with their intervals, gaps in per cent."""
    measure, table = measure_of_rows(rows), []
    keys = dict.fromkeys((row["_x"], row["_group"]) for row in rows)
    known = {name for name in rows[0] if all(row.get(name) is not None for row in rows)}
    for value, name in sorted(keys, key=lambda key: size_of(key[0])):
        chosen = [row for row in rows if (row["_x"], row["_group"]) == (value, name)]

        def mean(column: str, chosen: list[Row] = chosen) -> float:
            return float(np.mean([row[column] for row in chosen]))

        line: Row = {x: value} if x else {}
        line |= {"group": name, "seeds": len(chosen)}
        shown = references_of(measure)
        line |= {word: mean(column) for word, column in shown.items() if column in known}
        values = [measure.factor * row[measure.column] for row in chosen]
        line |= bounded(measure.name, float(np.mean(values)), interval_of(measure, values))
        line[f"{measure.name}_iqm"] = interquartile_mean(values)
        line["each_run"] = values
        before = f"{measure.column}_at_start"
        if before in known:
            ratios = [row[measure.column] / row[before] if row[before] else 1.0 for row in chosen]
            less = [100.0 * (1.0 - ratio) for ratio in ratios]
            line |= {"less": float(np.mean(less)), "least": min(less)}
        if measure == GAP and "objective_gap" in known:
            line["objective_gap"] = 100.0 * mean("objective_gap")
        if "success_rate" in known and measure != REGRET:
            line["success"] = 100.0 * mean("success_rate")
        table.append(line | {"seconds": mean("seconds"), "frames": mean("frames")})
    return table


def sweep_table(rows: list[Row], x: str | None) -> ResultTable:
    """The summary of runs as a table."""
    table, measure = summary(rows, x), measure_of_rows(rows)
    unit = measure.name
    heads = HEADS | {unit: f"{measure.title} [95 %]", f"{unit}_iqm": "interquartile mean"}
    columns = []
    for name in table[0]:
        head = heads.get(name, name.replace("_", " "))
        if name in (x, "group"):
            columns.append(Column(head, partial(_setting, name), left=True))
        elif name == unit:
            columns.append(with_interval(head, name, "z.2f"))
        elif name not in (f"{unit}_low", f"{unit}_high", "frames", "each_run"):
            whole = name in ("seeds", "success", "seconds")
            columns.append(numeric(head, name, ".0f" if whole else "z.2f"))
    return ResultTable(table, columns)


def _setting(name: str, row: Row) -> str:
    return short(row[name])


def sweep_notes(rows: list[Row]) -> list[str]:
    """The explanation of the table and the figures."""
    measure, single = measure_of_rows(rows), all(row["kind"] == RUN for row in rows)
    lines = [note("sweep.intervals", test=" (`pursuit ablate` makes one)" if single else "")]
    lines += [note("gaps.cut")] if measure == GAP else []
    kinds = evaluated_policies(rows)
    if measure.name in ("gap", "steps") and kinds:
        lines.append(note("sweep.steps", kinds=kinds))
    elif measure.name == "nash_conv":
        games = any(row.get("game") is not None for row in rows)
        exits = any(row.get("outcome") is not None for row in rows)
        unit = (BY_OUTCOME if exits else UNTIL_CAPTURE).unit
        lines.append(note("sweep.game") if games else note("sweep.nash_conv", unit=unit))
    elif measure == REGRET:
        lines.append(note("sweep.regret"))
    if measure == GAP and all(row.get("objective_gap") is not None for row in rows):
        lines.append(note("sweep.objective"))
    return lines


def summary_content(study: StudyRows, folder: Path, how: figures.Drawing) -> Content:
    """The report of a sweep, and of several folders."""
    names, measure = ["learning_curves.png"], measure_of_rows(study.rows)
    table = sweep_table(study.rows, study.x)
    if study.x and len({row["_x"] for row in study.rows}) > 1:
        panels = {measure.title: (measure.scale, measure.name, "each_run")}
        figures.draw_final(folder / "final.png", study, table.rows, study.x, panels, how)
        names.insert(0, "final.png")
    figures.draw_curves(folder / "learning_curves.png", study, [measure], how)
    return table, sweep_notes(study.rows), names
