"""The folder of a run, of whatever kind.

`config.json`, `metrics.csv`, `results.json`, `checkpoint.pt`, `learning_curve.png`, `replay.gif`,
`replays.json`, `report.html`, TensorBoard events; `.lock` while a process works on it.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from pursuit.mazes.maze import library_names
from pursuit.mazes.suite_files import is_suite
from pursuit.plugins import check_trusted
from train.files import LOCK, check_utf8, is_leftover, read_json, write_csv, write_json
from train.runs import forms
from train.runs.provenance import COMMAND, PARTS, command_line, provenance
from train.schemas import read_as
from train.settings.checks import check

CONFIG, METRICS, RESULTS, CHECKPOINT = (
    "config.json",
    "metrics.csv",
    "results.json",
    "checkpoint.pt",
)
CURVE, REPLAY = "learning_curve.png", "replay.gif"
FINAL = "final"
REPORT, REPLAYS = "report.html", "replays.json"
FORMAT = 5
"""Of `config.json` and `checkpoint.pt`; raised whenever older ones can no longer be read."""

RUN, SIDE, SELF_PLAY = "single", "side", "self-play"
"""Kinds: a run of a single agent; one side of self-play, saved as a policy; both sides together."""


def check_new(path: Path) -> None:
    """ValueError where a run cannot begin in a folder: a file, or one that holds anything.

    What a process left that ended before it wrote `config.json` is nothing.
    """
    check_utf8(path)
    if path.is_file():
        raise ValueError(f"{path}: a file; give a new folder")
    if (path / CONFIG).exists():
        raise ValueError(
            f"{path}: holds a run already; give another folder, or go on with it by --resume {path}"
        )
    if path.exists() and any(p.name != LOCK and not is_leftover(p) for p in path.iterdir()):
        raise ValueError(f"{path}: not empty; give a new folder")


def new_folder(path: Path) -> Path:
    """An empty folder for a run; ValueError as `check_new`."""
    check_new(path)
    path.mkdir(parents=True, exist_ok=True)
    return path


def save_config(
    folder: Path,
    kind: str,
    settings: Any,
    maze_text: str | None,
    final: forms.Final | None = None,
) -> None:
    """Write `config.json`: the kind of run, its settings, the maze as text where there is one, what
    its final results are made with, users' own parts with the hashes of their source, and the
    command that runs."""
    plain = {"format": FORMAT, "kind": kind, **asdict(settings), "maze_text": maze_text}
    if final is not None:
        plain[FINAL] = {"episodes": final.episodes}
    write_json(folder / CONFIG, {**plain, PARTS: provenance(settings), COMMAND: command_line()})


def load_config(folder: Path | str) -> tuple[str, dict[str, Any]]:
    """The kind of run in a folder, and its settings; a maze that was a file is its text.

    Raises:
        ValueError: no run in this folder, a damaged one, or one that names parts which are neither
            ours nor allowed.
    """
    folder = Path(folder)
    kind, plain = read_config(folder)
    check_trusted(folder / CONFIG, plain)
    return kind, plain


def read_config(folder: Path) -> tuple[str, dict[str, Any]]:
    """`load_config` for whoever makes nothing of the settings, and so need not trust them."""
    path = folder / CONFIG
    if not path.exists():
        raise ValueError(f"{folder}: no run here ({CONFIG} is missing)")
    plain = read_json(path)
    check(isinstance(plain, dict), f"{path}: damaged, not the settings of a run; {forms.RESTORE}")
    check(
        plain.pop("format", None) == FORMAT,
        f"{folder}: written by another version of pursuit (format {FORMAT} needed); use that "
        "version, or a new folder",
    )
    found = read_as(forms.Config, plain, path, forms.RESTORE)
    for name in ("kind", "maze_text", FINAL, PARTS, COMMAND):
        plain.pop(name, None)
    maze = found.task.get("maze")
    if found.maze_text is not None and maze not in library_names() and not is_suite(maze):
        plain["task"]["maze"] = found.maze_text
    return found.kind, plain


def load_final(folder: Path) -> forms.Final:
    """What the final results of a run are made with; the defaults where nothing is recorded."""
    path = folder / CONFIG
    return read_as(forms.Config, read_json(path), path, forms.RESTORE).final


def load_results(folder: Path | str) -> dict[str, Any]:
    """What `results.json` holds; ValueError where it is missing or damaged."""
    return forms.read_results(Path(folder) / RESULTS, RUN)


def save_checkpoint(folder: Path, state: dict[str, Any]) -> None:
    """Write `checkpoint.pt`: tensors and plain values only."""
    from train.tensors import write_tensors  # torch is slow to import

    write_tensors(folder / CHECKPOINT, {"format": FORMAT, **state})


def load_checkpoint(folder: Path | str) -> dict[str, Any]:
    """Read `checkpoint.pt` without running any code that it may hold.

    Raises:
        ValueError: missing, damaged, holding more than tensors and plain values, or of another
            version.
    """
    from train.tensors import read_tensors  # torch is slow to import

    folder = Path(folder)
    path = folder / CHECKPOINT
    if not path.exists():
        raise ValueError(
            f"{path}: no checkpoint; the run was stopped before its first one. Begin it with "
            f"--resume {folder}"
        )
    state = read_tensors(path)
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        raise ValueError(f"{path}: written by another version of pursuit (format {FORMAT} needed)")
    return state


MISFITS = (ValueError, KeyError, IndexError, RuntimeError, TypeError, AttributeError, OverflowError)
"""What loading the checkpoint of other settings leads to."""


def misfit(folder: Path, error: Exception) -> ValueError:
    """The error that says so."""
    how = f" ({error})" if isinstance(error, ValueError) else ""
    return ValueError(
        f"{folder / CHECKPOINT}: does not fit the settings in {CONFIG}{how}; one of the two is "
        "from another run, or damaged: restore it from a copy"
    )


class MetricsFile:
    """`metrics.csv`: one row per evaluation, readable at any moment.

    Args:
        folder: of the run.
        up_to_frames: rows beyond are dropped (they will be made again); None starts anew.
            Before every checkpoint there is a row: without the file a run cannot go on.
        column: that every row has, what the run is judged by.
    """

    def __init__(self, folder: Path, up_to_frames: int | None = None, column: str = "") -> None:
        self.path = folder / METRICS
        self.rows: list[dict[str, float]] = []
        if up_to_frames is not None:
            rows = read_metrics(folder, *([column] if column else []))
            self.rows = [row for row in rows if row["frames"] <= up_to_frames]

    def add(self, row: dict[str, float]) -> None:
        """Append a row and write the file anew, atomically."""
        self.rows.append(row)
        write_csv(self.path, self.rows)


def read_metrics(folder: Path | str, *columns: str) -> list[dict[str, float]]:
    """The rows of `metrics.csv`; cells without a number are left out.

    Raises:
        ValueError: it cannot be read, or has other columns than "frames", "seconds" and `columns`.
    """
    folder = Path(folder)
    return forms.read_numbers(folder / METRICS, ("frames", "seconds", *columns))
