"""The second table of docs/results/arm.md: learners on the arm with one joint."""

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
