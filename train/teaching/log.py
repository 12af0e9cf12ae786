"""`curriculum.csv`: what was taught when, and why."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from curricula import Change, Progress
from train.files import write_csv

LOG = "curriculum.csv"


def row_of(change: Change, progress: Progress) -> dict[str, Any]:
    """One row."""
    return {
        "frames": int(progress.frames),
        "episodes": int(progress.episodes),
        "seconds": round(progress.seconds, 3),
        "progress": round(progress.share, 6),
        "mean": change.mean,
        "low": change.low,
        "high": change.high,
        "reason": change.reason,
    }


def write_log(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write `curriculum.csv`."""
    names = ("frames", "episodes", "seconds", "progress", "mean", "low", "high", "reason")
    write_csv(folder / LOG, rows, names)


def read_log(folder: Path) -> list[dict[str, Any]]:
    """The rows of `curriculum.csv`; none where a run has no curriculum."""
    path = folder / LOG
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: text if name == "reason" else float(text) for name, text in row.items()}
            for row in csv.DictReader(file)
        ]
