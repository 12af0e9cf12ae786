"""The tables and the report of a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.forms import read_hints
from train.experiments.measures import GAP, STEPS, measure_of, size_of
from train.experiments.statistics import bootstrap_interval, interquartile_mean
from train.experiments.sweep_figures import draw_curves, draw_final
from train.experiments.tables import collect
from train.figures import PALETTE
from train.files import write_csv, write_text
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


def sweep_report(out: Path) -> Path:
    """Collect the runs of a sweep, draw its figures and write its tables.

    Returns:
        The folder: `report.md`, `table.csv`, and the figures as .png.

    Raises:
        ValueError: no sweep in `out`, or none of its runs has results.
    """
    hints = read_hints(out)
    runs, curves = collect(out)
    rows = [row for row in runs.to_dicts() if row["status"] == "complete"]
    check(bool(rows), f"{out}: no run is complete yet; `pursuit sweep` goes on with it")
    x = hints.x if hints.x in runs.columns else None
    group = [name for name in hints.group if name in runs.columns]
    for row in rows:
        row["_group"] = ", ".join(_word(name, row[name]) for name in group or ["algorithm"])
        row["_x"] = row[x] if x else ""
    groups = list(dict.fromkeys(row["_group"] for row in rows))
    colors = {name: PALETTE[number % len(PALETTE)] for number, name in enumerate(groups)}
    by_run: dict[str, list[dict[str, Any]]] = {}
    for row in curves.to_dicts():
        by_run.setdefault(row["run"], []).append(row)
    folder = out / "report"
    folder.mkdir(exist_ok=True)
    title = hints.title
    figures = []
    for unit in ("seconds", "frames"):
        name = f"learning_curves_{unit}.png"
        draw_curves(folder / name, rows, by_run, unit, x, colors, title)
        figures.append(name)
    if x and len({row["_x"] for row in rows}) > 1:
        draw_final(folder / "final.png", rows, x, colors, title)
        figures.insert(0, "final.png")
    table = summary(rows, x)
    write_csv(folder / "table.csv", table)
    write_text(folder / "report.md", markdown(title, rows, table, figures, runs.to_dicts()))
    return folder


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
        low, high = bootstrap_interval(values)
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


def markdown(
    title: str,
    rows: list[dict[str, Any]],
    table: list[dict[str, Any]],
    figures: list[str],
    everything: list[dict[str, Any]],
) -> str:
    """The report as Markdown."""
    measure = measure_of(rows)
    unit = measure.name
    names = [n for n in table[0] if n not in (f"{unit}_low", f"{unit}_high", "frames")]
    heads = {
        unit: f"{measure.head} [95 %]",
        f"{unit}_iqm": "interquartile mean",
        "floor": "floor of the objective, %",
        "success": "success, %",
        "less": "less than at the start, %",
        "least": "of the worst seed, %",
    }
    lines = [f"# {title}", ""]
    lines.append("| " + " | ".join(heads.get(n, n.replace("_", " ")) for n in names) + " |")
    lines.append("|" + "---|" * len(names))
    for line in table:
        cells = []
        for name in names:
            value = line[name]
            text = f"{value:.2f}" if isinstance(value, float) else str(value)
            if isinstance(value, float) and name == names[0]:  # a setting: told as it was set
                text = f"{value:g}"
            text = text.replace("-0.00", "0.00")
            if name in ("success", "seconds"):
                text = f"{value:.0f}"
            if name == unit and not np.isnan(line[f"{unit}_low"]):
                ends = f" [{line[f'{unit}_low']:.2f}, {line[f'{unit}_high']:.2f}]"
                text += ends.replace("-0.00", "0.00")
            cells.append(text)
        lines.append("| " + " | ".join(cells) + " |")
    machines = sorted({f"{row['machine']}" for row in rows})
    seeds = sorted({row["seed"] for row in rows})
    lines += [
        "",
        f"{len(rows)} runs, seeds {', '.join(map(str, seeds))}, on {'; '.join(machines)}.",
    ]
    lines.append("Intervals: 95 % bootstrap of the mean over seeds.")
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
    if "floor" in table[0]:
        lines.append(
            "The floor of the objective is the gap of the policy that is best by the discounted "
            "rewards: exact, over all starts."
        )
    missing = [row for row in everything if row["status"] != "complete"]
    if missing:
        lines += ["", f"Not complete: {len(missing)} runs.", ""]
        lines += [f"- {r['run']}: {r['status']} {r['error'] or ''}".rstrip() for r in missing]
    lines += [""] + [f"![{name}]({name})\n" for name in figures]
    return "\n".join(lines)
