"""The folder of a run: written beside and renamed, so that an interruption loses nothing.

`config.json`, `metrics.csv`, `results.json`, `checkpoint.pt`, `learning_curve.png`, `replay.gif`,
TensorBoard events.
"""

from __future__ import annotations

import csv
import json
import pickle
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch

from pursuit.maze import library_names
from train.files import write_beside as write_beside
from train.settings.checks import check
from train.settings.run import TrainSettings

CONFIG, METRICS, RESULTS, CHECKPOINT = (
    "config.json",
    "metrics.csv",
    "results.json",
    "checkpoint.pt",
)
FORMAT = 4
"""Of `config.json` and `checkpoint.pt`; raised whenever older ones can no longer be read."""


def write_json(path: Path, content: Any) -> None:
    """`content` as indented JSON, atomically."""
    text = json.dumps(content, indent=2) + "\n"
    write_beside(path, lambda beside: beside.write_text(text, encoding="utf-8"))


def read_json(path: Path) -> Any:
    """The JSON in `path`; ValueError naming the file where there is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:
        raise ValueError(f"{path}: damaged, not JSON") from None


def new_folder(path: Path) -> Path:
    """An empty folder for a run.

    Raises:
        ValueError: it is a file, or holds a run or anything else.
    """
    if path.is_file():
        raise ValueError(f"{path}: a file; give a new folder")
    if (path / CONFIG).exists():
        raise ValueError(
            f"{path}: holds a run already; give another folder, or go on with it by "
            f"`pursuit train --resume {path}`"
        )
    if path.exists() and any(path.iterdir()):
        raise ValueError(f"{path}: not empty; give a new folder")
    path.mkdir(parents=True, exist_ok=True)
    return path


def save_settings(folder: Path, settings: TrainSettings[Any]) -> None:
    """Write `config.json`: the settings, and the maze as text."""
    plain = settings.to_plain()
    write_json(
        folder / CONFIG,
        {"format": FORMAT, **plain, "maze_text": settings.task.build().mazes[0].to_text()},
    )


def load_settings(folder: Path) -> TrainSettings[Any]:
    """What `save_settings` wrote; a maze that was a file is taken from its text.

    Raises:
        ValueError: no run in this folder, or a damaged one.
    """
    if not (folder / CONFIG).exists():
        raise ValueError(f"{folder}: no run here ({CONFIG} is missing)")
    plain = read_json(folder / CONFIG)
    if not isinstance(plain, dict) or not isinstance(plain.get("task"), dict):
        raise ValueError(f"{folder / CONFIG}: damaged, not the settings of a run")
    check(
        plain.pop("format", None) == FORMAT,
        f"{folder}: written by another version of pursuit (format {FORMAT} needed); use that "
        "version, or a new folder",
    )
    text = plain.pop("maze_text", None)
    if isinstance(text, str) and plain["task"].get("maze") not in library_names():
        plain["task"]["maze"] = text
    return TrainSettings.from_plain(plain)


def save_checkpoint(folder: Path, state: dict[str, Any]) -> None:
    """Write `checkpoint.pt`: tensors and plain values only."""
    write_beside(
        folder / CHECKPOINT, lambda beside: torch.save({"format": FORMAT, **state}, beside)
    )


def load_checkpoint(folder: Path) -> dict[str, Any]:
    """Read `checkpoint.pt` without running any code that it may hold (`weights_only=True`).

    Raises:
        ValueError: missing, damaged, holding more than tensors and plain values, or of another
            version.
    """
    path = folder / CHECKPOINT
    if not path.exists():
        raise ValueError(f"{path}: no checkpoint; the run was stopped before its first one")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (
        OSError,
        RuntimeError,
        EOFError,
        ValueError,
        KeyError,
        pickle.UnpicklingError,
        zipfile.BadZipFile,
    ):
        raise ValueError(
            f"{path}: damaged, or no checkpoint of tensors and plain values; restore it from a copy"
        ) from None
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        raise ValueError(f"{path}: written by another version of pursuit (format {FORMAT} needed)")
    return state


class MetricsFile:
    """`metrics.csv`: one row per evaluation, readable at any moment.

    Args:
        folder: of the run.
        up_to_frames: rows beyond are dropped (they will be made again); None starts anew.
    """

    def __init__(self, folder: Path, up_to_frames: int | None = None) -> None:
        self.path = folder / METRICS
        self.rows: list[dict[str, float]] = []
        if up_to_frames is not None and self.path.exists():
            self.rows = [row for row in read_metrics(folder) if row["frames"] <= up_to_frames]

    def add(self, row: dict[str, float]) -> None:
        """Append a row and write the file anew, atomically."""
        self.rows.append(row)
        write_beside(self.path, self._write)

    def _write(self, path: Path) -> None:
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, names)
            writer.writeheader()
            writer.writerows(self.rows)


def read_metrics(folder: Path) -> list[dict[str, float]]:
    """The rows of `metrics.csv`; cells without a number are left out."""
    with (folder / METRICS).open(newline="", encoding="utf-8") as file:
        rows: Iterable[dict[str, str]] = csv.DictReader(file)
        return [{name: float(text) for name, text in row.items() if text} for row in rows]
