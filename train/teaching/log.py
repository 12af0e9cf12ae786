"""`curriculum.csv`: what was taught when, and why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from curricula import Change, Progress
from train.files import number_in, read_csv, write_csv
from train.settings.checks import check

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


def read_log(folder: Path) -> list[dict[str, Any]]:
    """The rows of `curriculum.csv`; none where a run has no curriculum.

    Raises:
        ValueError: it cannot be read, or has other columns.
    """
    path = folder / LOG
    if not path.exists():
        return []
    rows: list[dict[str, Any]] = []
    for number, texts in enumerate(read_csv(path), start=1):
        missing = [name for name in (*NUMBERS, REASON) if name not in texts]
        check(not missing, f"{path}: no column {missing[:1]}; restore it from a copy")
        where = f"{path}: row {number}, column"
        numbers = {name: number_in(texts[name], f"{where} {name}") for name in NUMBERS}
        rows.append({**numbers, REASON: texts[REASON]})
    return rows
