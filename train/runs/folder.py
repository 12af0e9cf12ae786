"""The folder of a run of any kind.

It contains `config.json`, `metrics.csv`, `results.json`, `checkpoint.pt`, `learning_curve.png`,
`replay.gif`, `replays.json`, `report.html`, TensorBoard events, and `.lock` while it is in use;
with the setting `checkpoints` also `checkpoints.json`, and the policies in `checkpoints/FRAMES`.
"""

from __future__ import annotations

import contextlib
import hashlib
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
    RUN_FILES,
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

CONFIG, METRICS, RESULTS, CHECKPOINT, KEPT_LIST = RUN_FILES
CURVE, REPLAY = "learning_curve.png", "replay.gif"
FINAL, RESOLVED = "final", "resolved"
REPORT, REPLAYS = "report.html", "replays.json"
FORMAT = 6
"""Version of `config.json` and `checkpoint.pt`; raised when older ones can no longer be read."""
RESULTS_FORMAT = 2
"""Version of `results.json`. 2: success in escapes is that at an exit alone."""

RUN, SIDE, SELF_PLAY, KEPT = "single", "side", "self-play", "checkpoint"
"""Kinds of runs: a single agent; one role of self-play, saved as a policy; self-play; a policy that
is kept at some time of training."""
KEPT_IN, BEST = "checkpoints", "best"
"""The subfolder of the policies that are kept, and the name of the best of them."""
FRAME_DIGITS = 9
"""Digits of frames in names of files; the names of earlier snapshots were their numbers, of 5."""


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
    init_sha256: str | None = None,
    final: forms.Final | None = None,
    resolved: Plain | None = None,
) -> None:
    """Write `config.json`: the kind of run, its settings, the maze as text if there is one, the
    digest of the weights that it starts from, the settings of the final results, what "auto" meant
    where the run began, user-defined parts with hashes of their source, and the command."""
    plain = {"format": FORMAT, "kind": kind, **asdict(settings), "maze_text": maze_text}
    # `resolved` is beside the settings: these stay "auto" for a run resumed on another machine.
    more = {"init_sha256": init_sha256, FINAL: msgspec.to_builtins(final), RESOLVED: resolved}
    plain |= {name: value for name, value in more.items() if value is not None}
    write_json(folder / CONFIG, {**plain, PARTS: provenance(settings), COMMAND: command_line()})


def learned_state(algorithm: str, seat: Any, learner: Plain) -> Plain:
    """The state of a learner as `check_learned` takes it."""
    return {"algorithm": algorithm, "game": game_digest(seat), "learner": learner}


def write_kept(folder: Path, name: str, algorithm: Any, seat: Any, learner: Plain) -> None:
    """Keep a policy of a run, or of one side of self-play, as a folder of its own in `checkpoints`,
    which commands read as they read that of the run.

    Args:
        folder: of the run or the side.
        name: of the folder.
        algorithm, seat, learner: the `Algorithm`, the `Seat` and the state of the learner.
    """
    kept = folder / KEPT_IN / name
    kept.mkdir(parents=True, exist_ok=True)
    write_json(kept / CONFIG, read_json(folder / CONFIG) | {"kind": KEPT})
    state = algorithm.policy_state(learner)
    save_checkpoint(kept, {"trainee": learned_state(algorithm.name, seat, state)})


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
    for name in ("kind", "maze_text", FINAL, "init_sha256", "longer", RESOLVED, PARTS, COMMAND):
        plain.pop(name, None)
    maze = found.task.get("maze")
    known = "\n" in str(maze) or maze in library_names() or is_suite(maze)
    if found.maze_text is not None and not known:
        plain["task"]["maze"] = titled(str(maze), found.maze_text)
    return found.kind, plain


def load_config(folder: Path) -> forms.Config:
    """What `config.json` holds beside the settings; the defaults where nothing is recorded."""
    path = folder / CONFIG
    return read_as(forms.Config, read_json(path), path, forms.RESTORE)


def sha256_in(folder: Path) -> str:
    """The digest of the checkpoint of a policy; of self-play of those of all sides."""
    found = hashlib.sha256()
    for path in [folder / CHECKPOINT, *sorted(folder.glob(f"*/{CHECKPOINT}"))]:
        if path.exists():
            found.update(path.read_bytes())
    return found.hexdigest()


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


def kept_policies(folder: Path) -> dict[int, Path]:
    """What is kept of the policy in a folder, in order, by the frames of the whole run: folders of
    `checkpoints`, and of one side of self-play also its snapshots in the pool (.pt)."""
    snapshots = (folder.parent / "pool" / folder.name).glob(f"{'[0-9]' * FRAME_DIGITS}*.pt")
    found = {int(path.stem): path for path in snapshots if path.stem.isdecimal()}
    for each in read_kept_list(run_of(folder)).kept:
        found[int(each["frames"])] = folder / KEPT_IN / frames_name(each["frames"])
    return dict(sorted(found.items()))


def frames_name(frames: float) -> str:
    """The name of what is kept at so many frames."""
    return f"{int(frames):0{FRAME_DIGITS}d}"


def run_of(folder: Path) -> Path:
    """The run of a policy: its folder, or of one side of self-play the folder around it."""
    return folder if (folder / KEPT_LIST).exists() else folder.parent


def policy_at(folder: Path, at: int | str | None) -> Path:
    """Where a policy is saved as it was at a time of training.

    Args:
        folder: of a run of one agent, or of one side of self-play.
        at: frames of the whole run, as a number or text ("2e5"); "best", the one of `checkpoints`
            with the best evaluation during training; None for the last.

    Raises:
        ValueError: nothing is kept of this time.
    """
    if at is None:
        return folder
    kept, frames = kept_policies(folder), -1.0
    best = read_kept_list(run_of(folder)).best
    with contextlib.suppress(ValueError, TypeError):
        frames = float(best or -1 if at == BEST else at)
    if frames not in kept:
        names = [*map(str, kept)]
        names = names if len(names) <= 10 else [*names[:4], "...", *names[-4:]]
        have = f"policies of {', '.join(names)} frames; give one of them" + ", or best" * bool(best)
        none = "no policies; leave at out, or train with --checkpoints"
        raise ValueError(f"{folder}: at={at!r}, but it keeps {have if kept else none}")
    return kept[int(frames)]


def read_kept_list(folder: Path) -> forms.KeptList:
    """The content of `checkpoints.json` in the folder of a run; that of none without one."""
    path = folder / KEPT_LIST
    content = read_json(path) if path.exists() else {}
    return read_as(forms.KeptList, content, path, forms.RESTORE)


def load_checkpoint(folder: Path | str, at: int | str | None = None) -> Plain:
    """Read `checkpoint.pt`, or what is kept of another time, without running code from the file.

    Args:
        folder: of the run.
        at: as of `policy_at`.

    Raises:
        ValueError: missing, damaged, of another version, or not only tensors and plain values.
    """
    from train.tensors import read_tensors  # torch is slow to import

    folder = Path(folder)
    found = policy_at(folder, at)
    if found.is_file():  # a snapshot of self-play, which has weights only
        state = load_checkpoint(folder)
        state["trainee"]["learner"] = read_tensors(found)
        return state
    path = found / CHECKPOINT
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
