"""The kinds of runs: how settings become each, by name or from a folder, and how they go on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from train.files import read_json
from train.runs.by_name import settings_of
from train.runs.folder import (
    CHECKPOINT,
    CONFIG,
    RESULTS,
    RUN,
    SELF_PLAY,
    check_new,
    load_checkpoint,
    load_config,
    new_folder,
    save_config,
)
from train.runs.loop import Run
from train.runs.parts import parts_of
from train.runs.provenance import check_sources
from train.runs.saved import from_plain
from train.runs.single import make_run
from train.runs.tasks import task_of
from train.self_play.parts import (
    self_play_from_plain,
    self_play_parts,
    self_play_settings_of,
)
from train.self_play.trainee import make_self_play
from train.settings.checks import check


@dataclass(frozen=True)
class Kind:
    """One kind of run.

    Attributes:
        settings_of: settings by their names on the command line, checked.
        from_plain: settings from `config.json`.
        check: ValueError for settings that cannot run.
        make: the run of settings in a folder, from its beginning (None) or from a checkpoint.
        again: the command that goes on with one.
    """

    settings_of: Callable[..., Any]
    from_plain: Callable[[dict[str, Any]], Any]
    check: Callable[[Any], object]
    make: Callable[[Any, Path, dict[str, Any] | None], Run]
    again: str


KINDS = {
    RUN: Kind(settings_of, from_plain, parts_of, make_run, "pursuit train"),
    SELF_PLAY: Kind(
        self_play_settings_of,
        self_play_from_plain,
        self_play_parts,
        make_self_play,
        "pursuit self-play",
    ),
}


def start(kind: str, settings: Any, path: Path) -> Run:
    """A new run in a new folder: its settings are on disk before anything is learned.

    Raises:
        ValueError: settings that cannot run here (no folder is made then), or a folder that holds
            something.
    """
    check_new(path)
    KINDS[kind].check(settings)
    folder = new_folder(path)
    run = KINDS[kind].make(settings, folder, None)
    write_config(kind, settings, folder)
    return run


def write_config(kind: str, settings: Any, folder: Path) -> None:
    """Write `config.json`."""
    save_config(folder, kind, settings, task_of(settings.task).mazes[0])


def read_settings(folder: Path) -> tuple[str, Any]:
    """The kind of a run and its settings; ValueError for no run, or a side of self-play."""
    kind, plain = load_config(folder)
    check(
        kind in KINDS,
        f"{folder}: one side of self-play, which trains with the other; give {folder.parent}",
    )
    return kind, KINDS[kind].from_plain(plain)


def open_run(folder: Path) -> Run:
    """The run in a folder where it was left: at its checkpoint, or at the beginning without one."""
    kind, settings = read_settings(folder)
    check_sources(folder / CONFIG, settings, resuming=True)
    begun = (folder / CHECKPOINT).exists()
    return KINDS[kind].make(settings, folder, load_checkpoint(folder) if begun else None)


def is_complete(folder: Path) -> bool:
    """Whether the budget of a run is spent and its results are written."""
    results = folder / RESULTS
    return results.exists() and not read_json(results).get("interrupted")


def resume(folder: Path, kind: str) -> Run:
    """Go on with the run in `folder`; one that has only its results to write does that.

    Raises:
        ValueError: no run there, a damaged one, one of another kind, or complete.
    """
    check(folder.is_dir(), f"{folder}: no such folder")
    found, _ = read_settings(folder)
    check(
        found == kind,
        f"{folder}: a run of kind {found!r}; go on with it by `{KINDS[found].again} --resume "
        f"{folder}`",
    )
    check(
        not is_complete(folder),
        f"{folder}: complete; its budget is spent. See {folder / RESULTS}",
    )
    return open_run(folder)
