"""The folder of a run, of whatever kind.

`config.json`, `metrics.csv`, `results.json`, `checkpoint.pt`, `learning_curve.png`, `replay.gif`,
TensorBoard events.
"""

from __future__ import annotations

import csv
import pickle
import zipfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from pursuit.maze import Maze, library_names
from pursuit.parts import check_trusted
from train.files import read_json, write_beside, write_csv, write_json
from train.runs.provenance import COMMAND, PARTS, command_line, provenance
from train.settings.checks import check

CONFIG, METRICS, RESULTS, CHECKPOINT = (
    "config.json",
    "metrics.csv",
    "results.json",
    "checkpoint.pt",
)
FORMAT = 4
"""Of `config.json` and `checkpoint.pt`; raised whenever older ones can no longer be read."""

RUN, SIDE, SELF_PLAY = "single", "side", "self-play"
"""Kinds: a run of a single agent; one side of self-play, saved as a policy; both sides together."""


def check_new(path: Path) -> None:
    """ValueError where a run cannot begin in a folder: a file, or one that holds anything."""
    if path.is_file():
        raise ValueError(f"{path}: a file; give a new folder")
    if (path / CONFIG).exists():
        raise ValueError(
            f"{path}: holds a run already; give another folder, or go on with it by --resume {path}"
        )
    if path.exists() and any(path.iterdir()):
        raise ValueError(f"{path}: not empty; give a new folder")


def new_folder(path: Path) -> Path:
    """An empty folder for a run; ValueError as `check_new`."""
    check_new(path)
    path.mkdir(parents=True, exist_ok=True)
    return path


def save_config(folder: Path, kind: str, settings: Any, maze: Maze) -> None:
    """Write `config.json`: the kind of run, its settings, the maze as text, users' own parts with
    the hashes of their source, and the command that runs."""
    plain = {"format": FORMAT, "kind": kind, **asdict(settings), "maze_text": maze.to_text()}
    write_json(folder / CONFIG, {**plain, PARTS: provenance(settings), COMMAND: command_line()})


def load_config(folder: Path) -> tuple[str, dict[str, Any]]:
    """The kind of run in a folder, and its settings; a maze that was a file is its text.

    Raises:
        ValueError: no run in this folder, a damaged one, or one that names parts which are neither
            ours nor allowed.
    """
    kind, plain = read_config(folder)
    check_trusted(folder / CONFIG, plain)
    return kind, plain


def read_config(folder: Path) -> tuple[str, dict[str, Any]]:
    """`load_config` for whoever makes nothing of the settings, and so need not trust them."""
    path = folder / CONFIG
    if not path.exists():
        raise ValueError(f"{folder}: no run here ({CONFIG} is missing)")
    plain = read_json(path)
    check(
        isinstance(plain, dict) and isinstance(plain.get("task"), dict),
        f"{path}: damaged, not the settings of a run",
    )
    check(
        plain.pop("format", None) == FORMAT,
        f"{folder}: written by another version of pursuit (format {FORMAT} needed); use that "
        "version, or a new folder",
    )
    kind, text = plain.pop("kind", None), plain.pop("maze_text", None)
    for name in (PARTS, COMMAND):
        plain.pop(name, None)
    check(isinstance(kind, str), f"{path}: damaged, a run of kind {kind!r}")
    if isinstance(text, str) and plain["task"].get("maze") not in library_names():
        plain["task"]["maze"] = text
    return kind, plain


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


MISFITS = (KeyError, RuntimeError, TypeError, AttributeError)
"""What loading the checkpoint of other settings leads to."""


def misfit(folder: Path) -> ValueError:
    """The error that says so."""
    return ValueError(
        f"{folder}: the checkpoint does not fit the settings in {CONFIG}; one of the two is from "
        "another run"
    )


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
        write_csv(self.path, self.rows)


def read_metrics(folder: Path) -> list[dict[str, float]]:
    """The rows of `metrics.csv`; cells without a number are left out."""
    with (folder / METRICS).open(newline="", encoding="utf-8") as file:
        rows: Iterable[dict[str, str]] = csv.DictReader(file)
        return [{name: float(text) for name, text in row.items() if text} for row in rows]
