"""`curriculum.csv`: what was taught when, and why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from curricula import Change, Progress
from train.files import write_csv

LOG = "curriculum.csv"
NUMBERS = ("frames", "episodes", "seconds", "progress", "mean", "low", "high")
REASON = "reason"


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
    write_csv(folder / LOG, rows, (*NUMBERS, REASON))
