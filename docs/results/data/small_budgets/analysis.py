"""The last table of README.md: defaults for small budgets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from train.experiments.committed import grouped, read_table
from train.reports.tables import plain_table

Row = dict[str, Any]


def gaps(rows: list[Row]) -> str:
    """The gaps of all seeds in per cent."""
    percent = (100.0 * row["optimality_gap"] for row in rows)
    return ", ".join(f"{gap:+.0f}" if abs(gap) >= 99.95 else f"{gap:+.1f}" for gap in percent)


def tables(data: Path) -> dict[str, str]:
    """The table by its title."""
    found: list[Row] = []
    for (task, frames), own in grouped(read_table(data / "runs.csv"), "task", "frames").items():
        before, after = (
            [row for row in own if row["defaults"] == when] for when in ("before", "after")
        )
        found.append({
            "task": task,
            "frames": f"{frames:,}",
            "games before": before[0]["num_games"],
            "games after": after[0]["num_games"],
            "gap before": gaps(before),
            "gap after": gaps(after),
        })  # fmt: skip
    heads = {"games after": "after", "gap after": "after"}
    return {"gaps": plain_table(found, heads).markdown()}
