"""The kinds of runs: how settings become each, by name or from a folder, and how they go on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from train.files import hold, remove_leftovers
from train.runs.folder import (
    CHECKPOINT,
    CONFIG,
    CURVE,
    REPLAY,
    REPORT,
    RESULTS,
    RUN,
    SELF_PLAY,
    check_new,
    load_checkpoint,
    load_config,
    load_results,
    save_config,
)
from train.runs.forms import Final
from train.runs.loop import Run
from train.runs.parts import parts_of, settings_of
from train.runs.provenance import check_sources
from train.runs.saved import from_plain
from train.runs.single import make_run
from train.runs.tasks import maze_text_of
from train.runs.threads import check_device
from train.runs.unused_settings import check_unused_settings
from train.self_play.learners import complete
from train.self_play.parts import (
    self_play_from_plain,
    self_play_parts,
    self_play_settings_of,
)
from train.self_play.trainee import make_self_play
from train.settings.checks import check
from train.teaching.mazes import as_text, names_in


@dataclass(frozen=True)
class Kind:
    """One kind of run.

    Attributes:
        settings_of: settings by their names on the command line, checked.
        from_plain: settings from `config.json`.
        check: ValueError for settings that cannot run.
        complete: the same settings with all that a run would fill in.
        make: the run of settings in a folder, from its beginning (None) or from a checkpoint.
        again: the command that goes on with one.
        pictures: what that command draws of the results.
    """

    settings_of: Callable[..., Any]
    from_plain: Callable[[dict[str, Any], str], Any]
    check: Callable[[Any], object]
    complete: Callable[[Any], Any]
    make: Callable[[Any, Path, dict[str, Any] | None], Run]
    again: str
    pictures: tuple[str, ...]


KINDS = {
    RUN: Kind(
        settings_of,
        from_plain,
        parts_of,
        lambda settings: settings,
        make_run,
        "pursuit train",
        (CURVE, REPLAY, REPORT),
    ),
    SELF_PLAY: Kind(
        self_play_settings_of,
        self_play_from_plain,
        self_play_parts,
        complete,
        make_self_play,
        "pursuit self-play",
        (CURVE, REPORT),
    ),
}


def start(kind: str, settings: Any, path: Path | str, final: Final | None = None) -> Run:
    """A new run in a new folder, held: its settings are on disk before anything is learned.

    Args:
        kind: "single", one agent that learns, or "self-play".
        settings: `TrainSettings` of the one, `SelfPlaySettings` of the other.
        path: of the folder.
        final: what its final results are to be made with, also after it was resumed;
            None for the defaults.

    Returns:
        The run: `train()` learns, `results()` evaluates and writes `results.json`.

    Raises:
        ValueError: settings that cannot run here or have no effect (no folder is made then), or a
            folder that holds something, or that another process has begun to fill.
    """
    path = Path(path)
    check_new(path)
    check_device(settings.device)
    KINDS[kind].check(settings)
    check_unused_settings(settings)
    settings = KINDS[kind].complete(settings)
    lock = hold(path, "run", shared=True)
    check_new(path)
    remove_leftovers(path)
    run = KINDS[kind].make(settings, path, None)
    run.lock = lock
    write_config(kind, settings, path, final)
    return run


def write_config(kind: str, settings: Any, folder: Path, final: Final | None = None) -> None:
    """Write `config.json`; the mazes of a curriculum that were files stand in it as their texts."""
    plain = replace(with_mazes(settings), task=settings.task)
    save_config(folder, kind, plain, maze_text_of(settings.task), final)


def with_mazes(settings: Any) -> Any:
    """The same settings with the texts of all mazes that were files, which they need no more."""
    task = settings.task
    if hasattr(task, "maze"):
        task = replace(task, maze=as_text(task.maze))
    lessons = getattr(settings, "lessons", None)
    given = getattr(lessons, "curriculum_mazes", None)
    if lessons is None or given is None:
        return replace(settings, task=task)
    texts = ",".join(map(as_text, names_in(given)))
    return replace(settings, task=task, lessons=replace(lessons, curriculum_mazes=texts))


def read_settings(folder: Path | str) -> tuple[str, Any]:
    """The kind of a run and its settings; ValueError for no run, or a side of self-play."""
    folder = Path(folder)
    kind, plain = load_config(folder)
    check(
        kind in KINDS,
        f"{folder}: one side of self-play, which trains with the other; give {folder.parent}",
    )
    return kind, KINDS[kind].from_plain(plain, str(folder / CONFIG))


def open_run(folder: Path | str) -> Run:
    """The run in a folder, held, where it was left: at its checkpoint, or without one at the start.

    Raises:
        ValueError: no run there, a damaged one, or one that another process works on.
    """
    folder = Path(folder)
    kind, settings = read_settings(folder)
    check_sources(folder / CONFIG, settings, resuming=True)
    lock = hold(folder, "run", shared=True)
    remove_leftovers(folder)
    begun = (folder / CHECKPOINT).exists()
    state = load_checkpoint(folder) if begun else None
    try:
        run = KINDS[kind].make(settings, folder, state)
    except ValueError as error:
        raise error if str(folder) in str(error) else ValueError(f"{folder}: {error}") from None
    run.lock = lock
    return run


def is_complete(folder: Path) -> bool:
    """Whether the budget of a run is spent and its results are written."""
    return (folder / RESULTS).exists() and not load_results(folder)["interrupted"]


def is_drawn(folder: Path, kind: str) -> bool:
    """Whether the pictures of its results are there."""
    return all((folder / name).exists() for name in KINDS[kind].pictures)


def resume(folder: Path | str, kind: str) -> Run:
    """Go on with the run in `folder`; one that has only its results or pictures to write does that.

    Raises:
        ValueError: no run there, a damaged one, one of another kind, or complete.
    """
    folder = Path(folder)
    check(folder.is_dir(), f"{folder}: no such folder")
    found, _ = read_settings(folder)
    check(
        found == kind,
        f"{folder}: a run of kind {found!r}; go on with it by `{KINDS[found].again} --resume "
        f"{folder}`",
    )
    check(
        not is_complete(folder) or not is_drawn(folder, kind),
        f"{folder}: complete; its budget is spent. See {folder / RESULTS}",
    )
    return open_run(folder)
