"""The folder of a run of any kind.

It contains `config.json`, `metrics.csv`, `results.json`, `checkpoint.pt`, `learning_curve.png`,
`replay.gif`, `replays.json`, `report.html`, TensorBoard events, and `.lock` while it is in use.
"""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec

from pursuit.mazes.maze import library_names
from pursuit.mazes.suite_files import is_suite
from pursuit.validation import check
from train.files import (
    LOCK,
    Plain,
    check_utf8,
    is_leftover,
    number_in,
    read_csv,
    read_json,
    write_json,
)
from train.runs import forms
from train.runs.provenance import COMMAND, PARTS, command_line, provenance
from train.schemas import read_as
from train.settings.mazes import titled
from train.settings.self_play import WholeSettings

CONFIG, METRICS = "config.json", "metrics.csv"
RESULTS, CHECKPOINT = "results.json", "checkpoint.pt"
CURVE, REPLAY = "learning_curve.png", "replay.gif"
FINAL = "final"
REPORT, REPLAYS = "report.html", "replays.json"
FORMAT = 6
"""Version of `config.json` and `checkpoint.pt`; raised when older ones can no longer be read."""
RESULTS_FORMAT = 2
"""Version of `results.json`. 2: success in escapes is that at an exit alone."""

RUN, SIDE, SELF_PLAY = "single", "side", "self-play"
"""Kinds of runs: a single agent; one role of self-play, saved as a policy; self-play."""


def check_new(path: Path) -> None:
    """ValueError unless a run can start in a folder: it must be new or empty.

    Temporary files of a process that ended before it wrote `config.json` are ignored.
    """
    check_utf8(path)
    if path.is_file():
        raise ValueError(f"{path}: is a file; give a new folder")
    if (path / CONFIG).exists():
        raise ValueError(
            f"{path}: contains a run already; give another folder, or resume it by --resume {path}"
        )
    if path.exists() and any(p.name != LOCK and not is_leftover(p) for p in path.iterdir()):
        raise ValueError(f"{path}: is not empty; give a new folder")


def save_config(
    folder: Path,
    kind: str,
    settings: WholeSettings,
    maze_text: str | None,
    final: forms.Final | None = None,
) -> None:
    """Write `config.json`: the kind of run, its settings, the maze as text if there is one, the
    settings of the final results, user-defined parts with hashes of their source, and the
    command."""
    plain = {"format": FORMAT, "kind": kind, **asdict(settings), "maze_text": maze_text}
    if final is not None:
        plain[FINAL] = final.arguments()
    write_json(folder / CONFIG, {**plain, PARTS: provenance(settings), COMMAND: command_line()})


def read_config(folder: Path) -> tuple[str, Plain]:
    """The kind of a run, and its settings; a maze file is replaced by its text, with its name.

    User-defined parts are not checked: see `provenance.check_parts`.

    Raises:
        ValueError: no run in this folder, or a damaged one.
    """
    path = folder / CONFIG
    if not os.path.exists(path):  # unlike Path.exists() also for names that are too long
        raise ValueError(f"{folder}: no run here ({CONFIG} is missing); give the folder of a run")
    plain = read_json(path)
    check(isinstance(plain, dict), f"{path}: damaged, not settings of a run; {forms.RESTORE}")
    check(
        plain.pop("format", None) == FORMAT,
        f"{folder}: written by another version of pursuit (format {FORMAT} needed); use that "
        "version, or a new folder",
    )
    found = read_as(forms.Config, plain, path, forms.RESTORE)
    for name in ("kind", "maze_text", FINAL, PARTS, COMMAND):
        plain.pop(name, None)
    maze = found.task.get("maze")
    known = "\n" in str(maze) or maze in library_names() or is_suite(maze)
    if found.maze_text is not None and not known:
        plain["task"]["maze"] = titled(str(maze), found.maze_text)
    return found.kind, plain


def load_final(folder: Path) -> forms.Final:
    """The settings of the final results of a run; the defaults if none are recorded."""
    path = folder / CONFIG
    return read_as(forms.Config, read_json(path), path, forms.RESTORE).final


def load_results(folder: Path | str) -> Plain:
    """The content of `results.json` in the present form; ValueError if it is missing, damaged, or
    of a later version."""
    path = Path(folder) / RESULTS
    content = read_json(path)
    found = read_as(forms.Results, content, path, forms.AGAIN)
    check(
        found.format <= RESULTS_FORMAT,
        f"{path}: has format {found.format}, this version of pursuit reads up to {RESULTS_FORMAT}; "
        "use the version that wrote it",
    )
    if found.format == 1:
        upgrade(content)
        found = read_as(forms.Results, content, path, forms.AGAIN)
    content["format"] = RESULTS_FORMAT
    if found.kind == RUN:
        read_as(forms.Evaluation, content["evaluation"], f"{path}: evaluation", forms.AGAIN)
    column = found.objective.column
    check(
        type(found.evaluation.get(column)) in (int, float),
        f"{path}: evaluation has no number {column!r}, the column of its objective; {forms.AGAIN}",
    )
    lists = ("scores", "matches", "at_start", "approximate_best_response")
    return {**content, **{name: msgspec.to_builtins(getattr(found, name)) for name in lists}}


def upgrade(content: Plain) -> None:
    """Bring a valid `results.json` of format 1 to the present form, in place.

    Success of one evader in escapes counted time-outs, and the interval of a team was that of the
    steps whatever the measure.
    """
    aim, team = content["objective"], content.get("team")
    if isinstance(team, dict) and team.get("measure") not in (None, "steps"):
        team["ci95"] = None
    if aim["column"] == "outcome" and aim["less_is_better"] and team is None:
        for each in (content["evaluation"], *content.get("scores", ())):
            if each.get("escape_rate") is not None:
                each["success_rate"] = each["escape_rate"]
        if content["evaluation"].get("success_rate") is not None:
            content["evaluation"]["unsolved_share"] = 1.0 - content["evaluation"]["success_rate"]


def is_complete(folder: Path) -> bool:
    """Whether the budget of a run is spent and its results are written."""
    return (folder / RESULTS).exists() and not load_results(folder)["interrupted"]


def save_checkpoint(folder: Path, state: Plain) -> None:
    """Write `checkpoint.pt`: tensors and plain values only."""
    from train.tensors import write_tensors  # torch is slow to import

    write_tensors(folder / CHECKPOINT, {"format": FORMAT, **state})


def load_checkpoint(folder: Path | str) -> Plain:
    """Read `checkpoint.pt` without running code from the file.

    Raises:
        ValueError: missing, damaged, of another version, or not only tensors and plain values.
    """
    from train.tensors import read_tensors  # torch is slow to import

    folder = Path(folder)
    path = folder / CHECKPOINT
    if not path.exists():
        raise ValueError(
            f"{path}: no checkpoint; the run was stopped before the first one. Start it again with "
            f"--resume {folder}"
        )
    state = read_tensors(path)
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        raise ValueError(f"{path}: written by another version of pursuit (format {FORMAT} needed)")
    return state


def game_digest(seat: Any) -> str | None:
    """The `SmallGame.digest` of the game of a seat; None in mazes and for arms."""
    game = getattr(seat.task, "game", None)
    return None if game is None else str(game.digest)


def check_learned(algorithm: str, trainee: Plain, seat: Any) -> None:
    """ValueError unless a saved learner is of this algorithm and of the game of this seat, and
    all its tensors are finite; `trainee` has "learner", and "algorithm" unless an older version
    wrote it."""
    check(
        trainee.get("game") == game_digest(seat),
        "the game has other states, actions, transitions or rewards than when it was trained, or "
        "in another order (of a set, which differs between processes)",
    )
    from train.tensors import first_not_finite  # torch is slow to import

    own = trainee.get("algorithm", algorithm)
    check(own == algorithm, f"it is of algorithm {own!r} instead of {algorithm!r}")
    where = first_not_finite(trainee["learner"])
    check(where is None, f"{where} is not finite")


MISFITS = (ValueError, KeyError, IndexError, RuntimeError, TypeError, AttributeError, OverflowError)
"""Exceptions that loading a checkpoint with other settings can raise."""


def misfit(folder: Path, error: Exception) -> ValueError:
    """The error for a checkpoint that does not match its settings."""
    how = f" ({error})" if isinstance(error, ValueError) else ""
    return ValueError(
        f"{folder / CHECKPOINT}: does not match the settings in {CONFIG}{how}; one of them is from "
        "another run or damaged: restore it from a copy"
    )


def read_metrics(folder: Path | str, *columns: str) -> list[dict[str, float]]:
    """The rows of `metrics.csv`; empty cells are left out.

    Raises:
        ValueError: it cannot be read, or lacks one of "frames", "seconds" and `columns`.
    """
    path, rows = Path(folder) / METRICS, []
    for number, texts in enumerate(read_csv(path), start=1):
        row: dict[str, float] = {}
        for name, text in texts.items():
            if text:
                row[name] = number_in(text, f"{path}: row {number}, column {name}")
        for name in ("frames", "seconds", *columns):
            check(name in row, f"{path}: row {number} has no {name!r}; {forms.RESTORE}")
            check(
                abs(row[name]) < float("inf"),
                f"{path}: row {number} has {name}={row[name]}; {forms.RESTORE}",
            )
        rows.append(row)
    return rows
