"""Runs of every kind, of one agent and of self-play: started, opened and resumed."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from pursuit.plugins import reading
from pursuit.validation import as_path, check, one_of, shortened
from scripted_agents.exact.long_work import Tell
from train.files import Plain, hold, read_json, remove_leftovers, write_json
from train.runs.budget import Budget
from train.runs.folder import (
    CHECKPOINT,
    CONFIG,
    CURVE,
    KEPT,
    REPLAY,
    REPORT,
    RESULTS,
    RUN,
    SELF_PLAY,
    check_new,
    is_complete,
    load_checkpoint,
    load_config,
    load_results,
    read_config,
    save_config,
    sha256_in,
)
from train.runs.forms import Final, Longer
from train.runs.loop import Run, build_parts, build_run
from train.runs.parts import parts_of, settings_of
from train.runs.provenance import check_parts, check_sources, command_line
from train.runs.saved import check_source, from_plain
from train.runs.single import single_agent
from train.runs.unused_settings import check_unused_settings, resolved_settings
from train.self_play.parts import self_play_from_plain, self_play_parts, self_play_settings_of
from train.self_play.trainee import SelfPlay
from train.settings.common import RunSettings
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
    check_source(settings)
    parts = own.parts_of(settings)
    check_unused_settings(settings)
    lock = hold(path, "run", shared=True)
    check_new(path)
    remove_leftovers(path)
    run: Run = own.run_of(parts, path, None)
    run.lock = lock
    write_config(kind, settings, path, final, resolved_settings(settings))
    return run


def write_config(kind: str, settings: WholeSettings, folder: Path, *how: Any) -> None:
    """Write `config.json`, with maze files replaced by their text; `how` is the end of the
    arguments of `save_config`: `final` and `resolved`."""
    own: Any = with_mazes(settings)
    plain = replace(own, task=settings.task)
    source = None if settings.init_from is None else sha256_in(Path(settings.init_from))
    save_config(folder, kind, plain, settings.task.maze_text, source, *how)


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
    whole = f"one side of self-play, not a whole run; give {folder.parent}"
    if kind == KEPT:
        whole = f"a policy that was kept; give its run, or start from it by --init-from {folder}"
    check(kind in KINDS, f"{folder}: {whole}")
    check_parts(folder / CONFIG, plain)
    with reading(folder / CONFIG):
        return kind, KINDS[kind].from_plain(plain, str(folder / CONFIG))


def open_run(
    folder: Path | str,
    frames: int | None = None,
    seconds: float | None = None,
    stretch: bool = False,
) -> Run:
    """Lock the run in a folder and load it from its checkpoint, or make it new without one.

    With `frames` or `seconds` the run goes on with this longer budget, from its checkpoint.
    Evaluations and kept policies are at even shares of the new budget from then on, snapshots of
    self-play in the same distances as before.

    Args:
        folder: of the run.
        frames, seconds: the new budget, in the unit of the run's.
        stretch: whether schedules extend over the new budget; by default they keep their end.

    Raises:
        ValueError: there is no run, it is damaged, or it is used by another process; a budget that
            is not longer, or in another unit.
    """
    folder = as_path("folder", folder)
    kind, settings = read_settings(folder)
    own = KINDS[kind]
    check_sources(folder / CONFIG, settings, resuming=True)
    lock = hold(folder, "run", shared=True)
    remove_leftovers(folder)
    state = load_checkpoint(folder) if (folder / CHECKPOINT).exists() else None
    longer: Sequence[Longer] = load_config(folder).longer
    new = {n: value for n, value in (("frames", frames), ("seconds", seconds)) if value is not None}
    check(
        state is not None or not (folder / RESULTS).exists(),
        f"{folder}: has results, but {CHECKPOINT} is missing; restore it from a copy",
    )
    check(bool(new) or not stretch, "--stretch needs a longer budget; add --frames or --seconds")
    if new:
        settings, longer, new = with_budget(folder, settings, longer, new, stretch)
    if longer and state is not None:  # checkpoints of earlier versions do not have it
        state.setdefault("budget", longer[0].budget)
    if state is None:
        check_init(folder, settings)
    how = {"budget": Budget.of(settings, longer)} if longer else {}
    try:
        with reading(folder / CONFIG):
            run: Run = own.run_of(own.parts_of(settings), folder, state, **how)
    except ValueError as error:
        raise error if str(folder) in str(error) else ValueError(f"{folder}: {error}") from None
    run.lock = lock
    if new:
        write_longer(run, settings, longer)
    return run


def with_budget(
    folder: Path, settings: WholeSettings, longer: Sequence[Longer], new: Plain, stretch: bool
) -> tuple[WholeSettings, Sequence[Longer], Plain]:
    """The settings with the new budget, the list of such changes, and the new budget; nothing new
    if it is the present one. ValueError as `open_run`."""
    check(
        isinstance(settings, RunSettings),
        f"{folder}: is a run of a comparison; its budget is that of the study file",
    )
    unit = settings.budget_unit
    check([*new] == [unit], f"{folder}: its budget is in {unit}; give a longer one by --{unit}")
    changed: Any = replace(settings, **new)
    before, after = (Budget.of(each).amount for each in (settings, changed))
    if after == before:  # the same command again, after an interruption
        return settings, longer, {}
    check(
        after > before,
        f"{folder}: {unit}={after:,.10g} is less than its budget of {before:,.10g} {unit}; give "
        "more, or leave it out to resume",
    )
    if not stretch and any(hyper.anneal for hyper in settings.learners):
        warnings.warn(
            f"{folder}: the learning rate is annealed to 0 at {before:,.10g} {unit}, its former "
            "budget, and stays there; add --stretch, or "
            f"start a new run from its weights by --init-from {folder}",
            stacklevel=3,
        )
    digest = sha256_in(folder) if (folder / CHECKPOINT).exists() else None
    return changed, [*longer, Longer(before, 0, stretch, digest, command_line())], new


def write_longer(run: Run, settings: WholeSettings, longer: Sequence[Longer]) -> None:
    """Write the new budget of a run into `config.json`; its results are outdated from then on."""
    folder = run.folder
    if (folder / RESULTS).exists():
        old = {"outdated": True, "interrupted": True}
        write_json(folder / RESULTS, load_results(folder) | old)
    last = msgspec.structs.replace(longer[-1], at=run.trainee.frames)
    changes: Plain = {settings.budget_unit: getattr(settings, settings.budget_unit)}
    changes["longer"] = msgspec.to_builtins([*longer[:-1], last])
    for path in [*folder.glob(f"*/{CONFIG}"), folder / CONFIG]:  # those of sides first
        write_json(path, read_json(path) | changes)


def check_init(folder: Path, settings: WholeSettings) -> None:
    """ValueError unless a run without a checkpoint can start from the same weights again."""
    before, source = load_config(folder).init_sha256, settings.init_from
    check(
        source is None or before == sha256_in(Path(source)),
        f"{folder}: has no checkpoint yet, and init_from={source!r} has other weights than when it "
        "was started; start a new run",
    )


def resume(folder: Path | str, kind: str, stretch: bool = False, **longer: Any) -> Run:
    """Open the run in `folder` for resuming, also if only results, figures or the policy of a side
    are missing, or with a longer budget, of "frames" or "seconds", as `open_run`.

    Raises:
        ValueError: there is no run, or it is damaged, of another kind, or complete.
    """
    folder = Path(folder)
    check(folder.is_dir(), f"{folder}: no such folder")
    found, settings = read_settings(folder)
    check(
        found == kind,
        f"{folder}: a run of kind {found!r}; resume it by `{KINDS[found].again} --resume {folder}`",
    )

    def lost(names: Sequence[str]) -> bool:
        return not all((folder / name).exists() for name in names)

    sides_lost = lost(getattr(settings, "learning", ()))
    check(
        bool(longer) or not is_complete(folder) or sides_lost or lost(KINDS[kind].pictures),
        f"{folder}: complete; its budget is spent. See {folder / RESULTS}, or go on with a longer "
        f"one: --resume {folder} --frames or --seconds",
    )
    run = open_run(folder, stretch=stretch, **longer)
    if sides_lost and (folder / CHECKPOINT).exists():
        run.trainee.save_beside(folder)
    return run


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
            run.results(**load_config(folder).final.arguments(), tell=tell)
