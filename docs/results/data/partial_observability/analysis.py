"""Tables of docs/results/partial_observability.md that follow from the rows of make_rows.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from train.experiments.committed import grouped, read_table
from train.reports.figures import PlottedEstimate, draw_intervals
from train.reports.tables import plain_table

Row = dict[str, Any]


def bounds(rows: list[Row]) -> list[Row]:
    """The proven bounds by view radius, and how much worse they are than the full view on 5x5."""
    full = next(row["lower"] for row in rows if row["radius"] is None)
    found = []
    for row in rows:
        more = [100.0 * (row[end] / full - 1.0) for end in ("lower", "upper")]
        texts = dict.fromkeys(f"{value:.1f}" for value in more)
        own = "full" if row["radius"] is None else str(row["radius"])
        other, width = row["maze"] != "5x5", 100.0 * row["width"]
        found.append({
            "view radius": f"{row['maze']}, radius {own}" if other else own,
            "lower": f"{row['lower']:.4f}",
            "upper": f"{row['upper']:.4f}",
            "width": f"{width:.2g} %" if width > 1e-6 else "0",
            "more than with full observation": "" if other else f"{' to '.join(texts)} %",
            "processor seconds": f"{row['seconds']:.0f}",
        })  # fmt: skip
    return found


def scripted(rows: list[Row]) -> list[Row]:
    """The mean steps of scripted chasers by view, with half the width of their interval."""
    names, found = [*grouped((r for r in rows if r["view"] == "radius 2"), "chaser")], list[Row]()
    for view, own in grouped(rows, "view").items():
        shown = {row["chaser"]: f"{row['mean_steps']:.2f} ({row['ci95']:.2f})" for row in own}
        found.append({"view": view} | {name: shown.get(name, "") for name in names})
    return found


def figures(data: Path, out: Path) -> None:
    """How much a limited view costs, as proven; a dot is the policy that was computed."""
    rows = [row for row in read_table(data / "bounds.csv") if row["maze"] == "5x5"]
    (full,) = (row["lower"] for row in rows if row["radius"] is None)
    found = []
    for row in rows:
        if row["radius"] is not None:
            low, high = (100.0 * (row[end] / full - 1.0) for end in ("lower", "upper"))
            name = f"{row['radius']:g}" if row["radius"] else "0 (own cell)"
            found.append(PlottedEstimate(name, high, low, high))
    label = "more discounted steps than with full view (%)"
    title = "Optimal chaser with a limited view, 5x5\nbar: proven interval, dot: computed policy"
    panels = {label: ("linear", found)}
    draw_intervals(out / "bounds.png", panels, title, "view radius", also="png")


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    found = {
        "bounds": bounds(read_table(data / "bounds.csv")),
        "scripted": scripted(read_table(data / "scripted.csv")),
    }
    return {title: plain_table(rows).markdown() for title, rows in found.items()}
