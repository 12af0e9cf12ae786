"""The first table of docs/results/arm.md: learners on the arm with one joint."""

from __future__ import annotations

from math import nan
from pathlib import Path
from statistics import fmean, median
from typing import Any

from train.experiments.committed import grouped
from train.experiments.recorded import read_recorded
from train.reports.figures import PlottedEstimate, draw_intervals
from train.reports.tables import plain_table

Row = dict[str, Any]


def figures(data: Path, out: Path) -> None:
    """The gaps of all runs and their medians."""
    found = []
    for name, own in grouped(read_recorded(data / "runs.csv").values(), "variant").items():
        gaps = [100.0 * row["optimality_gap"] for row in own]
        found.append(PlottedEstimate(name.partition(", ")[2], median(gaps), nan, nan, gaps))
    panels = {"gap to the least steps (%)": ("log", found)}
    title = "Arm with one joint after 60 s: ten seeds and their median"
    draw_intervals(out / "gaps.png", panels, title, also="png")


def tables(data: Path) -> dict[str, str]:
    """The table by its title."""
    found: list[Row] = []
    for name, own in grouped(read_recorded(data / "runs.csv").values(), "variant").items():
        gaps = sorted(100.0 * row["optimality_gap"] for row in own)
        frames = fmean(row["frames"] for row in own) / 1e6
        ends = (gaps[0], median(gaps), gaps[-1])
        found.append({
            "learner": name.partition(", ")[2],
            "least": f"{own[0]['optimal_steps']:.2f}",
            "budget": f"{own[0]['budget_seconds']:.0f} s, {frames:.2f} M frames",
            "gap: best, median, worst of ten seeds": ", ".join(f"{g:.2f}" for g in ends) + " %",
        })  # fmt: skip
    return {"learners": plain_table(found).markdown()}
