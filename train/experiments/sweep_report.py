"""The tables and the report of a sweep."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.forms import Hints, read_hints
from train.experiments.measures import GAP, STEPS, measure_of, size_of
from train.experiments.methods import METHODS_LINE, methods
from train.experiments.statistics import interquartile_mean
from train.experiments.sweep_figures import draw_curves, draw_final
from train.experiments.tables import collect
from train.figures import PALETTE, PLAIN, Look
from train.files import write_text
from train.result_table import Column, ResultTable, in_markdown
from train.runs.folder import RUN
from train.settings.checks import check

REFERENCES = {
    "random": "random_steps",
    "scripted": "scripted_steps",
    "optimal": "optimal_steps",
    "learned": "mean_steps",
    "chaser vs A*": "chaser_vs_astar",
    "evader vs A*": "evader_vs_astar",
}
"""What stands beside the measure in tables, where the runs have it: means over seeds."""


def sweep_report(out: Path, look: Look = PLAIN) -> Path:
    """Collect the runs of a sweep, draw its figures and write its tables.

    Returns:
        The folder: `report.md`, `methods.md`, `table.csv`, `table.tex`, and the figures.

    Raises:
        ValueError: no sweep in `out`, or none of its runs has results.
    """
    hints = read_hints(out)
    runs, curves = collect(out)
    rows = [row for row in runs.to_dicts() if row["status"] == "complete"]
    check(bool(rows), f"{out}: no run is complete yet; `pursuit sweep` goes on with it")
    x = put_groups(rows, hints, runs.columns)
    groups = list(dict.fromkeys(row["_group"] for row in rows))
    colors = {name: PALETTE[number % len(PALETTE)] for number, name in enumerate(groups)}
    by_run: dict[str, list[dict[str, Any]]] = {}
    for row in curves.to_dicts():
        by_run.setdefault(row["run"], []).append(row)
    folder = out / "report"
    folder.mkdir(exist_ok=True)
    title = hints.title
    figures = []
    for unit in units_of(rows) if look.x is None else (look.x,):
        name = f"learning_curves_{unit}.png"
        draw_curves(folder / name, rows, by_run, unit, x, colors, title, look)
        figures.append(name)
    if x and len({row["_x"] for row in rows}) > 1:
        draw_final(folder / "final.png", rows, x, colors, title, look)
        figures.insert(0, "final.png")
    table = table_of(rows, summary(rows, x), x)
    table.write(folder)
    write_text(folder / "methods.md", methods([out / "runs" / row["run"] for row in rows]))
    write_text(folder / "report.md", markdown(title, rows, table, figures, runs.to_dicts()))
    return folder


def units_of(rows: list[dict[str, Any]]) -> tuple[str, str]:
    """The units of the learning curves' axes, that of the budget first; seconds if it is mixed."""
    in_frames = all(row["budget_frames"] is not None for row in rows)
    return ("frames", "seconds") if in_frames else ("seconds", "frames")


def put_groups(rows: list[dict[str, Any]], hints: Hints, columns: Collection[str]) -> str | None:
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


def reduction(before: float, after: float) -> float:
    """By how many per cent it became less; nothing where it was 0."""
    return 100.0 * (1.0 - after / before) if before else 0.0


def summary(rows: list[dict[str, Any]], x: str | None) -> list[dict[str, Any]]:
    """One row for each x and group: means over seeds with their intervals, gaps in per cent."""
    measure = measure_of(rows)
    table = []
    keys = dict.fromkeys((row["_x"], row["_group"]) for row in rows)
    for value, name in sorted(keys, key=lambda key: size_of(key[0])):
        chosen = [row for row in rows if (row["_x"], row["_group"]) == (value, name)]
        line: dict[str, Any] = {x: value} if x else {}
        line |= {"group": name, "seeds": len(chosen)}

        def mean(column: str, chosen: list[dict[str, Any]] = chosen) -> float:
            return float(np.mean([row[column] for row in chosen]))

        for word, column in REFERENCES.items():
            if all(row.get(column) is not None for row in rows):
                line[word] = mean(column)
        values = [measure.scale * row[measure.final] for row in chosen]
        low, high = measure.interval(values)
        line[measure.name] = float(np.mean(values))
        line |= {f"{measure.name}_low": low, f"{measure.name}_high": high}
        line[f"{measure.name}_iqm"] = interquartile_mean(values)
        before = f"{measure.final}_at_start"
        if all(row.get(before) is not None for row in rows):
            less = [reduction(row[before], row[measure.final]) for row in chosen]
            line |= {"less": float(np.mean(less)), "least": min(less)}
        if measure is GAP and all(row.get("objective_floor") is not None for row in rows):
            line["floor"] = 100.0 * mean("objective_floor")
        if all(row.get("success_rate") is not None for row in rows):
            line["success"] = 100.0 * mean("success_rate")
        line |= {"seconds": mean("seconds"), "frames": mean("frames")}
        table.append(line)
    return table


HEADS = {
    "floor": "floor of the objective, %",
    "success": "success, %",
    "less": "less than at the start, %",
    "least": "of the worst seed, %",
}


def table_of(rows: list[dict[str, Any]], table: list[dict[str, Any]], x: str | None) -> ResultTable:
    """`summary` of runs as people read it."""
    measure = measure_of(rows)
    unit = measure.name
    heads = HEADS | {unit: f"{measure.head} [95 %]", f"{unit}_iqm": "interquartile mean"}
    hidden = (f"{unit}_low", f"{unit}_high", "frames")
    columns = []
    for name in (name for name in table[0] if name not in hidden):
        if name == unit:
            show = partial(_with_interval, name)
        elif name in ("success", "seconds"):
            show = partial(_rounded, name, "{:.0f}")
        else:  # a setting is told as it was set
            show = partial(_rounded, name, "{:g}" if name == x or name == "group" else "{:.2f}")
        columns.append(Column(heads.get(name, name.replace("_", " ")), show, name in (x, "group")))
    return ResultTable(table, columns)


def _rounded(name: str, form: str, row: dict[str, Any]) -> str:
    value = row[name]
    return form.format(value).replace("-0.00", "0.00") if isinstance(value, float) else str(value)


def _with_interval(name: str, row: dict[str, Any]) -> str:
    text = f"{row[name]:.2f}"
    if not np.isnan(row[f"{name}_low"]):
        text += f" [{row[f'{name}_low']:.2f}, {row[f'{name}_high']:.2f}]"
    return text.replace("-0.00", "0.00")


def markdown(
    title: str,
    rows: list[dict[str, Any]],
    table: ResultTable,
    figures: list[str],
    everything: list[dict[str, Any]],
) -> str:
    """The report as Markdown."""
    measure = measure_of(rows)
    unit = measure.name
    lines = [f"# {in_markdown(title)}", "", table.markdown()]
    machines = sorted({f"{row['machine']}" for row in rows})
    seeds = sorted({row["seed"] for row in rows})
    lines += [
        "",
        f"{len(rows)} runs, seeds {', '.join(map(str, seeds))}, "
        f"on {in_markdown('; '.join(machines))}.",
    ]
    single = all(row["kind"] == RUN for row in rows)
    lines.append(
        "Intervals: 95 %, Student's, of the mean over seeds. Nothing is tested here: whether "
        "intervals overlap is no test of a difference"
        + (" (`pursuit ablate` makes one)." if single else ".")
    )
    if measure in (GAP, STEPS):
        kinds = " or ".join(sorted({str(row["evaluate"]) for row in rows}))
        lines.append(
            f"Steps are those of the {kinds} policy"
            + (", as `evaluate` says in the settings of each run" if " or " in kinds else "")
            + "; an episode that runs out of time counts with all its steps."
        )
    elif unit == "nash_conv":
        lines.append(
            "NashConv is exact, of the two policies as they are at that moment; 0 is an "
            "equilibrium. Against A*: expected steps until capture."
        )
    if "floor" in table.rows[0]:
        lines.append(
            "The floor of the objective is the gap of the policy that is best by the discounted "
            "rewards: exact, over all starts."
        )
    other = f"learning_curves_{units_of(rows)[1]}.png"
    if other in figures:
        lines.append(f"A curve in {other} ends where the shortest of its runs ends.")
    missing = [row for row in everything if row["status"] != "complete"]
    if missing:
        lines += ["", f"Not complete: {len(missing)} runs.", ""]
        failed = [f"{r['run']}: {r['status']} {r['error'] or ''}" for r in missing]
        lines += [f"- {in_markdown(line)}" for line in failed]
    lines += ["", METHODS_LINE, ""] + [f"![{name}]({name})\n" for name in figures]
    return "\n".join(lines)
