"""The kinds of runs, single-agent and self-play: creating, opening and resuming them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pursuit.validation import as_path, one_of, shortened
from train.experiments import contestant_runs
from train.experiments.contestant_runs import CONTESTANT, ContestantSettings
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
from train.self_play.parts import (
    self_play_from_plain,
    self_play_parts,
    self_play_settings_of,
)
from train.self_play.trainee import make_self_play
from train.settings.checks import check
from train.settings.run import TrainSettings
from train.settings.self_play import SelfPlaySettings
from train.teaching.mazes import as_text, names_in

AnySettings = TrainSettings[Any] | SelfPlaySettings | ContestantSettings
"""The settings of a run of any kind."""


@dataclass(frozen=True)
class Kind:
    """One kind of run.

    Attributes:
        settings: their class.
        settings_of: makes and validates settings from values by command line name.
        from_plain: makes settings from `config.json`.
        check: raises ValueError for settings that cannot run.
        make: makes a run from settings, folder, and the state of a checkpoint (None for a new run):
            a `Run`, or of a contestant an object that `train.experiments.worker` uses likewise.
        again: the command that resumes a run.
        pictures: the files that this command draws from the results.
    """

    settings: type[Any]
    settings_of: Callable[..., Any]
    from_plain: Callable[[dict[str, Any], str], Any]
    check: Callable[[Any], object]
    make: Callable[[Any, Path, dict[str, Any] | None], Any]
    again: str
    pictures: tuple[str, ...]


KINDS = {
    RUN: Kind(
        TrainSettings,
        settings_of,
        from_plain,
        parts_of,
        make_run,
        "pursuit train",
        (CURVE, REPLAY, REPORT),
    ),
    SELF_PLAY: Kind(
        SelfPlaySettings,
        self_play_settings_of,
        self_play_from_plain,
        self_play_parts,
        make_self_play,
        "pursuit self-play",
        (CURVE, REPORT),
    ),
    CONTESTANT: Kind(
        ContestantSettings,
        contestant_runs.settings_of,
        contestant_runs.from_plain,
        lambda settings: contestant_runs.world_and_contest(settings.task, 2),
        contestant_runs.make_run,
        "pursuit compare",
        (),
    ),
}


def start(kind: str, settings: Any, path: Path | str, final: Final | None = None) -> Run:
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
    form = KINDS[kind].settings
    check(isinstance(settings, form), f"settings={shortened(settings)}; give {form.__name__}")
    path = as_path("path", path)
    check_new(path)
    check_device(settings.device)
    KINDS[kind].check(settings)
    check_unused_settings(settings)
    lock = hold(path, "run", shared=True)
    check_new(path)
    remove_leftovers(path)
    run = KINDS[kind].make(settings, path, None)
    run.lock = lock
    write_config(kind, settings, path, final)
    return run


def write_config(kind: str, settings: Any, folder: Path, final: Final | None = None) -> None:
    """Write `config.json`, with maze files replaced by their text."""
    plain = replace(with_mazes(settings), task=settings.task)
    save_config(folder, kind, plain, maze_text_of(settings.task), final)


def with_mazes(settings: Any) -> Any:
    """The same settings with maze files replaced by their text."""
    task = settings.task
    if hasattr(task, "maze"):
        task = replace(task, maze=as_text(task.maze))
    own = getattr(settings, "curriculum_settings", None)
    given = getattr(own, "curriculum_mazes", None)
    if own is None or given is None:
        return replace(settings, task=task)
    texts = ",".join(map(as_text, names_in(given)))
    return replace(
        settings,
        task=task,
        curriculum_settings=replace(own, curriculum_mazes=texts),
    )


def read_settings(folder: Path | str) -> tuple[str, Any]:
    """The kind of a run and its settings; ValueError without a run, or for a side of self-play."""
    folder = Path(folder)
    kind, plain = load_config(folder)
    check(
        kind in KINDS,
        f"{folder}: one side of self-play, not a whole run; give {folder.parent}",
    )
    return kind, KINDS[kind].from_plain(plain, str(folder / CONFIG))


def open_run(folder: Path | str) -> Run:
    """Lock the run in a folder and load it from its checkpoint, or make it new without one.

    Raises:
        ValueError: there is no run, it is damaged, or it is used by another process.
    """
    folder = as_path("folder", folder)
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
    """Whether the figures of its results exist."""
    return all((folder / name).exists() for name in KINDS[kind].pictures)


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
    check(
        not is_complete(folder) or not is_drawn(folder, kind),
        f"{folder}: complete; its budget is spent. See {folder / RESULTS}",
    )
    return open_run(folder)
