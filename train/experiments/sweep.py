"""Sweeps: TOML files of settings, lists of values and seeds, expanded to studies."""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import msgspec

from pursuit.plugins import check_trusted
from pursuit.validation import one_of
from train.experiments.forms import (
    REMEDY,
    VERSIONS,
    ReportHints,
    SweepFile,
    Version,
    check_seeds,
    check_table,
)
from train.experiments.identity import fingerprint, frozen_mazes, inputs_of
from train.experiments.search import draw_samples
from train.experiments.study import Study, TrainingRun, job_name
from train.kinds import KINDS
from train.runs.folder import RUN
from train.schemas import read_as
from train.settings.checks import check
from train.settings.self_play import LEARN, ROLES, unnested_sides

EXPERIMENTS = Path(__file__).with_name("files")
MAX_RUNS = 100_000
"""Maximum number of runs of a sweep, to catch typing errors."""
MEASURED = {"seconds": "budget_seconds", "frames": "budget_frames"}
"""New names of settings whose names are those of measurements in the table of runs."""

Change = Callable[[SweepFile], SweepFile]
"""Modifies the contents of a sweep file."""


def shipped(folder: Path = EXPERIMENTS) -> list[str]:
    """The names of the shipped files."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def load_sweep(name: str, version: str | None = None, change: Change = lambda file: file) -> Study:
    """Read a sweep file and expand it, without running it.

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full" of a file that has both; short by default.
        change: modifies the contents of the file.

    Raises:
        ValueError: no such file, invalid TOML, an unknown key, a value of a wrong type, an empty
            list, a version that the file does not have, or a combination that cannot run.
    """
    path, content = read_file(name, EXPERIMENTS, "sweep")
    file = read_as(SweepFile, content, path, REMEDY)
    try:
        return multiply_out(change(choose_version(file, version)), path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_file(name: str, folder: Path, kind: str) -> tuple[Path, dict[str, Any]]:
    """The path and the content of a TOML file, or of the one of that name in `folder`.

    Raises:
        ValueError: no such file, invalid TOML, or user-defined parts that are not trusted.
    """
    path, names = Path(name), shipped(folder)
    if not path.exists() and name in names:
        path = folder / f"{name}.toml"
    check(path.is_file(), f"{name}: no such {kind} file; shipped are {', '.join(names)}")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not TOML: {error}; {REMEDY}") from None
    check_trusted(path, content)
    return path, unnested_tables(content)


def unnested_tables(content: dict[str, Any]) -> dict[str, Any]:
    """The content of a file with the tables of one side as names such as chaser.entropy_coef."""
    found = dict(content)
    for name, value in content.items():
        if name in VERSIONS and isinstance(value, dict):
            found[name] = unnested_tables(value)
        elif name in ("settings", "grid", "search") and isinstance(value, dict):
            found[name] = unnested_sides(value)
        elif name == "variants" and isinstance(value, list):
            found[name] = [unnested_sides(v) if isinstance(v, dict) else v for v in value]
    return found


def choose_version(file: SweepFile, version: str | None) -> SweepFile:
    """The file overridden by the chosen version."""
    check(version in (None, *VERSIONS), f"unknown version {version!r}; short or full")
    has = [name for name in VERSIONS if getattr(file, name) is not None]
    check(version is None or version in has, f"no version {version!r}; give one of {has or 'none'}")
    chosen = version or (has[0] if has else None)
    over: dict[str, Any] = dict.fromkeys(VERSIONS)
    for name in Version.__struct_fields__ if chosen else ():
        value, before = getattr(getattr(file, str(chosen)), name), getattr(file, name)
        both = isinstance(value, dict) and isinstance(before, dict)
        if value is not None:
            over[name] = {**before, **value} if both else value
    return msgspec.structs.replace(file, **over)


def multiply_out(file: SweepFile, stem: str) -> Study:
    """All combinations as validated settings."""
    kind = RUN if file.kind is None else file.kind
    one_of("kind", kind, KINDS)
    common, grid = file.settings or {}, file.grid or {}
    variants, seeds = file.variants, [0] if file.seeds is None else file.seeds
    check_table(common, "[settings]")
    check_table(grid, "[grid]", values=True)
    check_seeds(seeds)
    check_variants(variants)
    count = math.prod(map(len, grid.values())) * len(variants or [{}]) * len(seeds)
    check(count <= MAX_RUNS, f"{count:,} runs; give values for at most {MAX_RUNS:,}")
    drawn = draw_samples(file.search or {}, MAX_RUNS // count)
    sources = [grid, drawn[0], {name: 0 for variant in variants or () for name in variant}]
    for one, two in itertools.combinations(sources, 2):
        for name in one.keys() & two.keys():
            raise ValueError(f"{name!r} is set by two of grid, search and variants; set it in one")
    check(bool(common or grid or variants), "nothing to do; give [settings] and [grid]")
    runs: dict[str, TrainingRun] = {}
    for values in itertools.product(*grid.values()):
        for variant, sample in itertools.product(variants or [{}], drawn):
            label = dict(zip(grid, values, strict=True)) | variant | sample
            for run in runs_of(kind, common, label, seeds, episodes_of(file)):
                same = runs.setdefault(run.name.rsplit("-", 1)[1], run)
                check(  # equal combinations run once
                    same.label == run.label,
                    f"{run_label(same.label)} and {run_label(run.label)} have equal "
                    "settings; change one of them, or leave it out",
                )
    return Study(
        stem if file.title is None else file.title,
        # Seeds are the outer loop, so that changes of the machine's speed affect all settings.
        tuple(sorted(runs.values(), key=lambda run: seeds.index(run.seed))),
        report_hints(file, tuple(runs.values()), [*grid, *drawn[0]]),
    )


def episodes_of(file: SweepFile) -> int:
    """Episodes of the final evaluation; ValueError if too few for an interval."""
    episodes = 1000 if file.episodes is None else file.episodes
    check(episodes >= 2, f"episodes={episodes!r}; give at least 2")
    return episodes


def check_variants(variants: list[dict[str, Any]] | None) -> None:
    """ValueError unless variants are tables of settings with a name each."""
    if variants is None:
        return
    check(bool(variants), "variants is an empty list; give at least one")
    names = [variant.get("name") for variant in variants]
    check(
        all(isinstance(name, str) for name in names) and len(set(map(str, names))) == len(names),
        f"names of variants are {names}; give each a different name",
    )
    for variant in variants:
        check_table({k: v for k, v in variant.items() if k != "name"}, repr(variant["name"]))


def runs_of(
    kind: str,
    common: Mapping[str, Any],
    label: dict[str, Any],
    seeds: Sequence[int],
    episodes: int,
) -> Iterator[TrainingRun]:
    """One combination with every seed, validated once, as validity does not depend on the seed."""
    varying = {name: value for name, value in label.items() if name != "name"}
    try:
        asked = KINDS[kind].settings_of(**{"threads": 1, **common, **varying, "seed": seeds[0]})
        settings, given = frozen_mazes(asked)
        inputs = inputs_of(settings)
    except ValueError as error:
        which = run_label(label | {"seed": seeds[0]})
        raise ValueError(f"combination {which}: {error}") from None
    if "name" in label:
        varying["variant"] = label["name"]
    for seed in seeds:
        own = replace(settings, seed=seed)
        name = job_name(varying, seed, fingerprint(kind, own, episodes, inputs), without=kind)
        yield TrainingRun(name, kind, own, episodes, varying, given, inputs)


def run_label(label: Mapping[str, Any]) -> str:
    """The varying settings in one line of text."""
    return ", ".join(f"{name}={value!r}" for name, value in label.items())


def flat_settings(settings: Any) -> dict[str, Any]:
    """Settings by name as a flat dictionary; budgets are renamed by `MEASURED`."""
    return flat_plain(asdict(settings))


def flat_plain(nested: Mapping[str, Any]) -> dict[str, Any]:
    """`flat_settings` of plain values; what differs between sides is chaser.NAME, evader.NAME."""
    plain = dict(nested)
    flat = {"variant": None, "kind": None} | plain.pop("task")
    for name in ("hyper", "curriculum_settings"):
        plain |= {k: v for k, v in (plain.pop(name, None) or {}).items() if k not in plain}
    sides = {
        role: {"algorithm": plain[role]["algorithm"], **plain[role]["hyper"]}
        for role in ROLES
        if isinstance(plain.get(role), Mapping)
    }
    for role, own in sides.items():
        plain[role] = LEARN
        for name, value in own.items():
            same = all(name in side and side[name] == value for side in sides.values())
            plain[name if same else f"{role}.{name}"] = value
    flat |= plain
    return {MEASURED.get(name, name): value for name, value in flat.items()}


def report_hints(
    file: SweepFile, runs: tuple[TrainingRun, ...], varying: list[str]
) -> dict[str, Any]:
    """The setting on the axis, and the settings that distinguish curves (`variant` if there are
    any).

    Raises:
        ValueError: an unknown name.
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
            f"{name!r} in [report] is not a setting of these runs; give one that varies: "
            f"{', '.join(['variant'] * bool(file.variants) + varying) or 'nothing'}",
        )
        return column

    x, group = hints.x, hints.group
    if group is None:
        group = ["variant"] if file.variants else [name for name in varying if name != x]
    return {"x": None if x is None else column(x), "group": [column(name) for name in group]}
