"""Sweeps: a small TOML file of settings, lists of values and seeds becomes a list of runs."""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pursuit.maze import load_maze
from pursuit.parts import check_trusted
from train.experiments.forms import (
    EXACT,
    HINTS,
    LABEL,
    REMEDY,
    VERSIONS,
    Exact,
    ReportHints,
    SweepFile,
    Version,
    check_keys,
    check_seeds,
    check_table,
    read_hints,
)
from train.experiments.identity import (
    INPUTS,
    Input,
    copy_of,
    fingerprint,
    frozen_mazes,
    inputs_of,
    with_policies,
)
from train.experiments.kinds import KINDS, is_complete, read_settings, write_config
from train.experiments.search import draw_samples
from train.files import LOCK, write_json
from train.runs.folder import CHECKPOINT, CONFIG, RUN
from train.runs.forms import Final
from train.schemas import read_as
from train.settings.checks import check
from train.settings.self_play import ROLES

EXPERIMENTS = Path(__file__).with_name("files")
ERROR, PROGRESS, STOPPED = "error.txt", "progress.txt", "stopped_early.json"
MAX_RUNS = 100_000
"""Of one sweep: beyond, a typing error is likelier than a machine to run them on."""
MEASURED = {"seconds": "budget_seconds", "frames": "budget_frames"}
"""Settings whose names mean what was measured in the table of runs, and what they are there."""

Told = Callable[[dict[str, str], dict[str, float]], None]
"""Called now and then with the status of every run by name, and the progress of those running."""

Change = Callable[[SweepFile], SweepFile]
"""What makes another sweep of one."""

FileForm = TypeVar("FileForm", bound=msgspec.Struct)


@dataclass(frozen=True)
class SweepRun:
    """One run of a sweep.

    Attributes:
        name: of its folder: readable, with a fingerprint of the complete settings at the end.
        kind: of run, one of `KINDS`.
        settings: all of them; mazes that were files are texts.
        label: what the sweep file says of this run: the names that vary, and `variant`.
        given: what reports call mazes and opponents that were files: as the sweep file does.
        inputs: the policies that it reads, by the setting's name.
    """

    name: str
    kind: str
    settings: Any
    label: dict[str, Any]
    given: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, Input] = field(default_factory=dict)


@dataclass(frozen=True)
class Sweep:
    """A sweep file, checked and multiplied out.

    Attributes:
        title: of the reports.
        runs: all combinations, seed by seed, in the order of the file.
        episodes: of each final evaluation.
        report: hints for `train.experiments.report`: "x", "group".
        exact: a table that needs no learning.
        scheduler: "asha" stops the worst early, on Ray; None runs everything to its end.
    """

    title: str
    runs: tuple[SweepRun, ...]
    episodes: int
    report: dict[str, Any]
    exact: Exact | None
    scheduler: str | None


def shipped(folder: Path = EXPERIMENTS) -> list[str]:
    """The names of the shipped files."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def load_sweep(name: str, version: str | None = None, change: Change = lambda file: file) -> Sweep:
    """Read a sweep file and multiply it out; nothing is run.

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full", where the file has both; short if left out.
        change: what is to be another in the file than what it says.

    Raises:
        ValueError: no such file, no TOML, an unknown key, a value of another type, an empty list, a
            version that the file does not have, or a combination that cannot run.
    """
    path, content = read_file(name, EXPERIMENTS, "sweep")
    file = read_form(SweepFile, content, path)
    try:
        return multiply_out(change(choose_version(file, version)), path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_file(name: str, folder: Path, kind: str) -> tuple[Path, dict[str, Any]]:
    """The path and the content of a TOML file, or of the one of that name in `folder`.

    Raises:
        ValueError: no such file, no TOML, or parts named that are neither ours nor allowed.
    """
    path, names = Path(name), shipped(folder)
    if not path.exists() and name in names:
        path = folder / f"{name}.toml"
    check(path.is_file(), f"{name}: no such {kind} file; shipped are {', '.join(names)}")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not TOML: {error}") from None
    check_trusted(path, content)
    return path, content


def read_form(form: type[FileForm], content: dict[str, Any], path: Path) -> FileForm:
    """The content of a file in its form; ValueError naming file, field and remedy."""
    try:
        check_keys(content, form, "")
        inner: dict[str, type[msgspec.Struct]] = {"report": ReportHints, "exact": Exact}
        inner |= dict.fromkeys(VERSIONS, Version)
        for name, table in content.items():
            if name in inner and isinstance(table, dict):
                check_keys(table, inner[name], f" in [{name}]")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return read_as(form, content, path, REMEDY)


def choose_version(file: SweepFile, version: str | None) -> SweepFile:
    """The file with the chosen version laid over it."""
    check(version in (None, *VERSIONS), f"unknown version {version!r}; short or full")
    has = [name for name in VERSIONS if getattr(file, name) is not None]
    check(version is None or version in has, f"no version {version!r}; it has {has or 'none'}")
    chosen = version or (has[0] if has else None)
    over: dict[str, Any] = dict.fromkeys(VERSIONS)
    for name in Version.__struct_fields__ if chosen else ():
        value, before = getattr(getattr(file, str(chosen)), name), getattr(file, name)
        both = isinstance(value, dict) and isinstance(before, dict)
        if value is not None:
            over[name] = {**before, **value} if both else value
    return msgspec.structs.replace(file, **over)


def multiply_out(file: SweepFile, stem: str) -> Sweep:
    """All combinations as checked settings."""
    kind = RUN if file.kind is None else file.kind
    check(kind in KINDS, f"unknown kind {kind!r}; one of {', '.join(KINDS)}")
    common, grid, search = file.settings or {}, file.grid or {}, dict(file.search or {})
    variants, seeds = file.variants, [0] if file.seeds is None else file.seeds
    check_table(common, "[settings]")
    check_table(grid, "[grid]", values=True)
    check_seeds(seeds)
    check_variants(variants)
    scheduler = search.pop("scheduler", None)
    check(scheduler in (None, "asha"), f"unknown scheduler {scheduler!r}; asha")
    count = math.prod(map(len, grid.values())) * len(variants or [{}]) * len(seeds)
    check(count <= MAX_RUNS, f"{count:,} runs; a sweep has at most {MAX_RUNS:,}: leave some out")
    drawn = draw_samples(search, MAX_RUNS // count)
    sources = [grid, drawn[0], {name: 0 for variant in variants or () for name in variant}]
    for one, two in itertools.combinations(sources, 2):
        for name in one.keys() & two.keys():
            raise ValueError(
                f"{name!r} is set by two of grid, search and variants; leave it to one"
            )
    has_runs = bool(common or grid or variants)
    runs: dict[str, SweepRun] = {}
    for values in itertools.product(*grid.values()) if has_runs else ():
        for variant, sample, seed in itertools.product(variants or [{}], drawn, seeds):
            label = dict(zip(grid, values, strict=True)) | variant | sample
            run = run_of(kind, common, label, seed, episodes_of(file))
            same = runs.setdefault(run.name.rsplit("-", 1)[1], run)
            check(  # a combination named twice runs once
                same.label == run.label,
                f"{told(same.label)} and {told(run.label)} have equal settings: they are one run; "
                "change one of them, or leave it out",
            )
    check(has_runs or file.exact is not None, "nothing to do; give [settings] and [grid]")
    for name in file.exact.mazes if file.exact else ():
        load_maze(name)
    return Sweep(
        stem if file.title is None else file.title,
        # Seeds outside: whatever changes on the machine meanwhile meets all that is compared alike.
        tuple(sorted(runs.values(), key=lambda run: seeds.index(run.settings.seed))),
        episodes_of(file),
        report_hints(file, tuple(runs.values()), [*grid, *drawn[0]]),
        file.exact,
        scheduler,
    )


def episodes_of(file: SweepFile) -> int:
    """Of each final evaluation; ValueError for too few to tell an interval."""
    episodes = 1000 if file.episodes is None else file.episodes
    check(episodes >= 2, f"episodes={episodes!r}; at least 2")
    return episodes


def check_variants(variants: list[dict[str, Any]] | None) -> None:
    """ValueError unless variants are tables of settings with a name each."""
    if variants is None:
        return
    check(bool(variants), "variants is an empty list; give at least one")
    names = [variant.get("name") for variant in variants]
    check(
        all(isinstance(name, str) for name in names) and len(set(map(str, names))) == len(names),
        f"variants need a name each, all different; these are {names}",
    )
    for variant in variants:
        check_table({k: v for k, v in variant.items() if k != "name"}, repr(variant["name"]))


def run_of(
    kind: str, common: Mapping[str, Any], label: dict[str, Any], seed: int, episodes: int
) -> SweepRun:
    """One combination, checked and named."""
    varying = {name: value for name, value in label.items() if name != "name"}
    try:
        asked = KINDS[kind].settings_of(**{"threads": 1, **common, **varying, "seed": seed})
        settings, given = frozen_mazes(asked)
        inputs = inputs_of(settings)
    except ValueError as error:
        which = told(label | {"seed": seed})
        raise ValueError(f"the combination {which} cannot run: {error}") from None
    if "name" in label:
        varying["variant"] = label["name"]
    print_ = fingerprint(kind, settings, episodes, inputs)
    name = run_name(kind, varying, seed, print_)
    return SweepRun(name, kind, settings, varying, given, inputs)


def told(label: Mapping[str, Any]) -> str:
    """What varies, in one line."""
    return ", ".join(f"{name}={value!r}" for name, value in label.items())


def flat_settings(settings: Any) -> dict[str, Any]:
    """Settings by their names, without the levels that they lie in; budgets as `MEASURED` says."""
    return flat_plain(asdict(settings))


def flat_plain(nested: Mapping[str, Any]) -> dict[str, Any]:
    """The same of plain values."""
    plain = dict(nested)
    flat = {"variant": None, "kind": None} | plain.pop("task")
    for name in ("hyper", "lessons"):
        plain |= {k: v for k, v in (plain.pop(name, None) or {}).items() if k not in plain}
    for role in ROLES:  # self-play by another algorithm than PPO
        own = plain.pop(f"{role}_hyper", None) or {}
        plain |= {f"{role}_{name}": value for name, value in own.items()}
    flat |= plain
    return {MEASURED.get(name, name): value for name, value in flat.items()}


def report_hints(file: SweepFile, runs: tuple[SweepRun, ...], varying: list[str]) -> dict[str, Any]:
    """What goes on the axis and what is a curve of its own; `variant` where there are variants.

    Raises:
        ValueError: a name that no run has.
    """
    hints = file.report or ReportHints()
    within = {name for variant in file.variants or () for name in variant} - {"name"}
    varying = sorted({*varying, *within})
    known = {name for run in runs for name in (*flat_settings(run.settings), *run.label)}
    if not file.variants:
        known.discard("variant")

    def column(name: str) -> str:
        column = MEASURED.get(name, name)
        check(
            column in known,
            f"{name!r} in [report] is no setting of these runs; what varies is "
            f"{', '.join(['variant'] * bool(file.variants) + varying) or 'nothing'}",
        )
        return column

    x, group = hints.x, hints.group
    if group is None:
        group = ["variant"] if file.variants else [name for name in varying if name != x]
    return {"x": None if x is None else column(x), "group": [column(name) for name in group]}


def run_name(kind: str, label: Mapping[str, Any], seed: int, print_: str) -> str:
    """A readable folder name that no other settings have."""
    parts = [str(value) for value in label.values()] or [kind]
    text = "-".join([*parts, f"seed{seed}"])
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", text)[:80] + "-" + print_


def prepare(sweep: Sweep, out: Path | str) -> list[tuple[SweepRun, Path]]:
    """Make the folders of all runs, with their `config.json`; those there already are checked.

    Returns:
        Every run with its folder.

    Raises:
        ValueError: `out` is something else, or holds a run of other settings or another version.
    """
    out = Path(out)
    check(not out.is_file(), f"{out}: a file; give a folder")
    there = [path.name for path in out.iterdir()] if out.is_dir() else []
    if set(there) - {LOCK, EXACT, INPUTS} and "runs" not in there:
        raise ValueError(f"{out}: not empty, and no sweep; give a new folder")
    folders = [(run, out / "runs" / run.name) for run in sweep.runs]
    before = {}
    for run, folder in folders:
        if (folder / CONFIG).exists():
            kind, before[run.name] = read_settings(folder)
            print_ = fingerprint(kind, before[run.name], sweep.episodes, run.inputs)
            check(
                run.name.endswith(print_),
                f"{folder}: holds a run of other settings than its name says; remove that folder",
            )
    names = [run.name for run in sweep.runs]
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / HINTS, {"title": sweep.title, **sweep.report, "runs": names})
    for run, folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
        copies = {name: str(copy_of(given, out)) for name, given in run.inputs.items()}
        settings = with_policies(run.settings, copies)
        if before.get(run.name) != settings:  # new, or the folder of the sweep was moved
            write_config(run.kind, settings, folder, Final(sweep.episodes))
        write_json(folder / LABEL, {**run.given, **run.label})
    return folders


def is_folder_of(sweep: Sweep, out: Path) -> bool:
    """Whether `out` was begun for this sweep or ablation, or for one of the same title."""
    if not (out / HINTS).exists():  # begun, and interrupted before any run
        return {path.name for path in out.iterdir()} <= {LOCK, EXACT, INPUTS}
    hints = read_hints(out)
    return (hints.title, hints.control) == (sweep.title, sweep.report.get("control"))


def status_of(folder: Path) -> str:
    """complete, failed, stopped (early, by a scheduler), interrupted or new."""
    if is_complete(folder):
        return "complete"
    if (folder / ERROR).exists():
        return "failed"
    if (folder / STOPPED).exists():
        return "stopped"
    return "interrupted" if (folder / CHECKPOINT).exists() else "new"


def to_do(folders: Mapping[str, Path], again: bool) -> list[str]:
    """The runs that have not ended, by name: what a scheduler stopped counts only with `again`."""
    ended = ("complete",) if again else ("complete", "stopped")
    return [name for name, folder in folders.items() if status_of(folder) not in ended]
