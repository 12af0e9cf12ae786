"""Runs of every kind, of one agent and of self-play: started, opened and resumed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from pursuit.plugins import reading
from pursuit.validation import as_path, check, one_of, shortened
from scripted_agents.exact.long_work import Tell
from train.files import Plain, hold, remove_leftovers
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
    is_complete,
    load_checkpoint,
    load_final,
    load_results,
    read_config,
    save_config,
)
from train.runs.forms import Final
from train.runs.loop import Run, build_parts, build_run
from train.runs.parts import parts_of, settings_of
from train.runs.provenance import check_parts, check_sources
from train.runs.saved import from_plain
from train.runs.single import single_agent
from train.runs.unused_settings import check_unused_settings
from train.self_play.parts import self_play_from_plain, self_play_parts, self_play_settings_of
from train.self_play.trainee import SelfPlay
from train.settings.mazes import as_text, names_in
from train.settings.run import TrainSettings
from train.settings.self_play import SelfPlayBase, WholeSettings


@dataclass(frozen=True)
class Kind:
    """One kind of run.

    Attributes:
        settings: their class.
        settings_of: makes and validates settings from values by command line name.
        from_plain: makes settings from `config.json`.
        parts_of: checks settings, and builds the parts of a run; ValueError if it cannot run.
        run_of: makes the run from parts, folder and the state of a checkpoint (None for a new run).
        again: the command that resumes a run.
        pictures: the files that this command draws from the results.
    """

    settings: type[Any]
    settings_of: Callable[..., Any]
    from_plain: Callable[[Plain, str], Any]
    parts_of: Callable[[Any], Any]
    run_of: Callable[[Any, Path, Plain | None], Any]
    again: str
    pictures: tuple[str, ...]


KINDS: dict[str, Kind] = {
    RUN: Kind(
        TrainSettings,
        settings_of,
        from_plain,
        partial(build_parts, parts_of),
        partial(build_run, single_agent),
        "pursuit train",
        (CURVE, REPLAY, REPORT),
    ),
    SELF_PLAY: Kind(
        SelfPlayBase,
        self_play_settings_of,
        self_play_from_plain,
        partial(build_parts, self_play_parts),
        partial(build_run, SelfPlay),
        "pursuit self-play",
        (CURVE, REPORT),
    ),
}


NAMES = {RUN: "TrainSettings", SELF_PLAY: "SelfPlaySettings"}
"""The settings of each kind, for messages."""


def start(kind: str, settings: WholeSettings, path: Path | str, final: Final | None = None) -> Run:
    """Make a run in a new folder, lock the folder, and write `config.json`.

    Args:
        kind: "single" for one learning agent, or "self-play".
        settings: `TrainSettings` or `SelfPlaySettings`.
        path: of the folder.
        final: options of the final results, also used after resuming; None for the defaults.

    Returns:
        The run: `train()` learns, `results()` evaluates and writes `results.json`.

    Raises:
        ValueError: an unknown kind, settings that cannot run here or have no effect (then no folder
            is made), or the folder is not empty or used by another process.
    """
    one_of("kind of run", kind, (RUN, SELF_PLAY))
    own = KINDS[kind]
    check(isinstance(settings, own.settings), f"settings={shortened(settings)}; give {NAMES[kind]}")
    path = as_path("path", path)
    check_new(path)
    parts = own.parts_of(settings)
    check_unused_settings(settings)
    lock = hold(path, "run", shared=True)
    check_new(path)
    remove_leftovers(path)
    run: Run = own.run_of(parts, path, None)
    run.lock = lock
    write_config(kind, settings, path, final)
    return run


def write_config(
    kind: str, settings: WholeSettings, folder: Path, final: Final | None = None
) -> None:
    """Write `config.json`, with maze files replaced by their text."""
    own: Any = with_mazes(settings)
    plain = replace(own, task=settings.task)
    save_config(folder, kind, plain, settings.task.maze_text, final)


def with_mazes(settings: WholeSettings) -> WholeSettings:
    """The same settings with maze files replaced by their text."""
    changed: Plain = {"task": settings.task.frozen()}
    own: Any = settings.curriculum_settings
    if (given := own.curriculum_mazes) is not None:
        texts = ",".join(map(as_text, names_in(given)))
        changed["curriculum_settings"] = replace(own, curriculum_mazes=texts)
    return replace(settings, **changed)


def read_settings(folder: Path | str) -> tuple[str, WholeSettings]:
    """The kind of a run and its settings; ValueError without a run, or for a side of self-play."""
    folder = Path(folder)
    kind, plain = read_config(folder)
    check(kind in KINDS, f"{folder}: one side of self-play, not a whole run; give {folder.parent}")
    check_parts(folder / CONFIG, plain)
    with reading(folder / CONFIG):
        return kind, KINDS[kind].from_plain(plain, str(folder / CONFIG))


def open_run(folder: Path | str) -> Run:
    """Lock the run in a folder and load it from its checkpoint, or make it new without one.

    Raises:
        ValueError: there is no run, it is damaged, or it is used by another process.
    """
    folder = as_path("folder", folder)
    kind, settings = read_settings(folder)
    own = KINDS[kind]
    check_sources(folder / CONFIG, settings, resuming=True)
    lock = hold(folder, "run", shared=True)
    remove_leftovers(folder)
    state = load_checkpoint(folder) if (folder / CHECKPOINT).exists() else None
    try:
        with reading(folder / CONFIG):
            run: Run = own.run_of(own.parts_of(settings), folder, state)
    except ValueError as error:
        raise error if str(folder) in str(error) else ValueError(f"{folder}: {error}") from None
    run.lock = lock
    return run


def resume(folder: Path | str, kind: str) -> Run:
    """Open the run in `folder` for resuming, also if only results or figures are missing.

    Raises:
        ValueError: there is no run, or it is damaged, of another kind, or complete.
    """
    folder = Path(folder)
    check(folder.is_dir(), f"{folder}: no such folder")
    found, _ = read_settings(folder)
    check(
        found == kind,
        f"{folder}: a run of kind {found!r}; resume it by `{KINDS[found].again} --resume {folder}`",
    )
    drawn = all((folder / name).exists() for name in KINDS[kind].pictures)
    check(
        not is_complete(folder) or not drawn,
        f"{folder}: complete; its budget is spent. See {folder / RESULTS}",
    )
    return open_run(folder)


def evaluate_runs(folders: Iterable[Path], tell: Tell) -> None:
    """Write the results of those runs that have none, or those of an earlier checkpoint.

    Args:
        folders: of runs.
        tell: as in `Run.results`.

    Raises:
        ValueError: a run without results and checkpoint, or that cannot be opened. All are checked
            before the first is evaluated.
    """
    missing = []
    for folder in folders:
        if not (folder / RESULTS).exists() or load_results(folder).get("outdated"):
            missing.append(folder)
            again = f"{KINDS[read_settings(folder)[0]].again} --resume {folder}"
            check(
                (folder / CHECKPOINT).exists(), f"{folder}: no checkpoint yet; go on with {again}"
            )
    for folder in missing:
        run = open_run(folder)
        with contextlib.closing(run.trainee), run.lock or contextlib.nullcontext():
            run.results(**load_final(folder).arguments(), tell=tell)
