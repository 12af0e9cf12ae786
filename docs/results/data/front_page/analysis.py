"""Table of docs/results/front_page.md and README.md: single agents by default."""

from __future__ import annotations

from pathlib import Path
from statistics import fmean, median
from typing import Any

from train.experiments.committed import grouped
from train.experiments.recorded import read_recorded
from train.reports.tables import plain_table

Row = dict[str, Any]


def tables(data: Path) -> dict[str, str]:
    """The table by its title."""
    found = []
    rows = read_recorded(data / "runs.csv").values()
    for name, own in sorted(grouped(rows, "variant").items()):

        def middle(kind: str, own: list[Row] = own) -> str:
            return f"{median(row[f'{kind}_steps'] for row in own):.2f}"

        frames = fmean(row["frames"] for row in own) / 1e6
        gaps = sorted((100.0 * row["optimality_gap"] for row in own), key=abs)
        scripted = own[0]["scripted"].replace("A* chaser", "A*").replace("A* evader", "A*")
        ends = (gaps[0], median(gaps), gaps[-1])
        found.append({
            "task, opponent": name,
            "budget": f"{own[0]['budget_seconds']:.0f} s, {frames:.1f} M frames",
            "random": middle("random"),
            "scripted": f"{middle('scripted')} ({scripted})",
            "learned (median of ten seeds)": middle("mean"),
            "optimal": middle("optimal"),
            "gap: best, median, worst": ", ".join(f"{gap:.2f}" for gap in ends) + " %",
        })  # fmt: skip
    return {"gaps": plain_table(found).markdown()}
