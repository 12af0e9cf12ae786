"""Replication files: studies, their claims, and the rules that decide the claims."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from pursuit.mazes.maze import Maze
from pursuit.validation import one_of, unknown
from train.experiments.ablation import load_ablation
from train.experiments.forms import REMEDY, VERSIONS, SweepFile, Table
from train.experiments.replication.rules import PARTS, RULES, TO, cells_of
from train.experiments.search import draw_samples
from train.experiments.study import Study
from train.experiments.sweep import (
    flat_settings,
    load_sweep,
    multiply_out,
    read_file,
)
from train.schemas import read_as
from train.settings.checks import check

FILES = Path(__file__).with_name("files")
EXACT_RULES = ("states", "tours")
"""Rules of studies that need no runs."""
SHIPPED = "as shipped"
FIRST_TRIAL_SEED = 10**6
"""Seed of the trials; studies use other seeds."""
BY_SIZE = re.compile(r"(\d+)x(\d+)")


class Claim(msgspec.Struct, forbid_unknown_fields=True):
    """A claim and its decision rule.

    Attributes:
        text: the claim.
        rule: one of `RULES`, or of `EXACT_RULES` if no runs are needed.
        of: the cells of the claim: columns of the table of runs with a value or a list of values.
        than: the cells that they are compared with.
        to, percent: a reference of `TO`, and the tolerance around it in per cent.
        part: a part of the gap, one of `PARTS`; `percent` is its share then.
        cause: our interpretation, by verdict.
    """

    text: str
    rule: str
    of: Table = {}
    than: list[Table] = []
    to: str = "optimal"
    percent: float = 0.0
    part: str = "objective"
    cause: dict[str, str] = {}

    def __post_init__(self) -> None:
        one_of("rule", self.rule, (*RULES, *EXACT_RULES))
        one_of("to", self.to, tuple(TO))
        one_of("part", self.part, PARTS)
        check(
            (self.rule in ("lower", "higher")) == bool(self.than),
            f"rule={self.rule!r} and than={self.than}; give than for lower and higher only",
        )


class Experiment(msgspec.Struct, forbid_unknown_fields=True):
    """[[studies]]: a figure or table, its claims, and the experiment that decides them.

    Attributes:
        id: its name on the command line.
        title: of its section in the report.
        thesis, differs: the conditions in the thesis, and the differences here.
        claims: see `Claim`.
        sweep, ablation: the name of a shipped file with the runs; neither if `exact`.
        exact: whether the claims need no runs.
        tuned: whether every algorithm uses the settings found by the search.
        versions: the versions that include this study.
        least_frames: a cell with a shorter run is not tested.
    """

    id: str
    title: str
    thesis: str
    differs: str
    claims: list[Claim]
    sweep: str | None = None
    ablation: str | None = None
    exact: bool = False
    tuned: bool = False
    versions: tuple[str, ...] = VERSIONS
    least_frames: int = 0

    def __post_init__(self) -> None:
        given = [bool(self.sweep), bool(self.ablation), self.exact]
        check(sum(given) == 1, f"study {self.id!r}: give one of sweep, ablation and exact")
        check(bool(self.claims), f"study {self.id!r}: no claims; give [[studies.claims]]")
        for claim in self.claims:
            check(
                (claim.rule in EXACT_RULES) == self.exact,
                f"study {self.id!r}: rule {claim.rule!r}; give {' or '.join(EXACT_RULES)} exactly "
                "if exact = true",
            )


class Trials(msgspec.Struct, forbid_unknown_fields=True):
    """[tuning.short] or [tuning.full]: trials per algorithm, and seconds per trial."""

    samples: int
    seconds: float


class Tuning(msgspec.Struct, forbid_unknown_fields=True):
    """[tuning]: the search for settings, with the same budget for every algorithm.

    Attributes:
        mazes: of the search; studies use other mazes.
        settings: of all trials.
        space: the searched settings by algorithm, in the form of [search] in a sweep file.
    """

    mazes: list[str]
    settings: Table
    space: dict[str, Table]
    short: Trials
    full: Trials


class ReplicationFile(msgspec.Struct, forbid_unknown_fields=True):
    """The contents of a replication file."""

    title: str
    studies: list[Experiment]
    tuning: Tuning | None = None

    def __post_init__(self) -> None:
        tuned = [study.id for study in self.studies if study.tuned]
        check(
            not tuned or self.tuning is not None,
            f"tuned studies ({', '.join(tuned)}) need [tuning]; give it, or leave tuned out",
        )


@dataclass(frozen=True)
class Replication:
    """The selected studies of a validated replication file.

    Attributes:
        name: of the file.
        title: of the report.
        version: "short" or "full".
        studies: the selected studies, in the order of the file.
        left_out: the ids of studies that only the other version includes.
        tuning: the search; None if no study needs it.
        mazes: paths of user-defined mazes, by the names of the shipped mazes that they replace.
    """

    name: str
    title: str
    version: str
    studies: tuple[Experiment, ...]
    left_out: tuple[str, ...]
    tuning: Tuning | None
    mazes: Mapping[str, str]


def load_replication(
    wanted: Sequence[str] = ("all",),
    version: str = "short",
    mazes: Path | None = None,
    file: str = "thesis",
) -> Replication:
    """Read and validate a replication file.

    Args:
        wanted: the ids of studies, or "all".
        version: "short" or "full".
        mazes: a folder of maze files that replace the shipped mazes of the same size.
        file: a path, or the name of a shipped file.

    Raises:
        ValueError: unknown file, study or version, a study that the version does not include, or a
            folder without mazes or with several of one size.
    """
    path, content = read_file(file, FILES, "replication")
    found = read_as(ReplicationFile, content, path, REMEDY)
    one_of("version", version, VERSIONS)
    ids = [study.id for study in found.studies]
    for name in set(wanted) - {"all"}:
        check(name in ids, unknown("study", name, ids, "give all, or some of"))
    chosen = [s for s in found.studies if ("all" in wanted or s.id in wanted)]
    for study in chosen if "all" not in wanted else ():
        check(
            version in study.versions,
            f"study {study.id!r} is part of {', '.join(study.versions)} only; give --version "
            f"{study.versions[0]}",
        )
    left_out = tuple(study.id for study in chosen if version not in study.versions)
    chosen = [study for study in chosen if version in study.versions]
    own = {} if mazes is None else mazes_by_size(mazes)
    tuning = found.tuning if any(study.tuned for study in chosen) else None
    return Replication(path.stem, found.title, version, tuple(chosen), left_out, tuning, own)


def mazes_by_size(folder: Path) -> dict[str, str]:
    """The maze files of a folder by size, such as "5x5"; other files are ignored.

    Raises:
        ValueError: no folder, no maze in it, or two of one size.
    """
    check(folder.is_dir(), f"{folder}: no such folder; give one with maze files")
    found: dict[str, str] = {}
    for path in sorted(folder.iterdir()):
        if not path.is_file():
            continue
        try:
            maze = Maze.from_text(path.read_text(encoding="utf-8"))
        except (ValueError, UnicodeDecodeError):
            continue
        name = f"{maze.height}x{maze.width}"
        check(
            name not in found,
            f"{folder}: {found.get(name)} and {path} are both {name}; keep one of each size",
        )
        found[name] = str(path.resolve())
    check(bool(found), f"{folder}: contains no maze file; give a folder with maze files")
    return found


# -- sweeps ----------------------------------------------------------------------------------------


def tuning_sweep(plan: Replication) -> Study:
    """The trials: shipped settings and random samples, for every algorithm."""
    tuning = plan.tuning
    assert tuning is not None  # a file with tuned studies has [tuning]
    trials: Trials = getattr(tuning, plan.version)
    variants = []
    for algorithm, space in tuning.space.items():
        drawn = draw_samples({**space, "samples": trials.samples - 1}, 1000)
        settings: dict[str, Table] = {SHIPPED: {}}
        settings |= {f"draw {n}": found for n, found in enumerate(drawn, 1)}
        variants += [
            {"name": f"{algorithm}, {name}", "algorithm": algorithm, **found}
            for name, found in settings.items()
        ]
    return multiply_out(
        SweepFile(
            title="Search for the settings of each algorithm, on other mazes",
            settings={**tuning.settings, "seconds": trials.seconds},
            grid={"maze": tuning.mazes},
            variants=variants,
            seeds=[FIRST_TRIAL_SEED],
        ),
        "tuning",
    )


def sweep_of(study: Experiment, plan: Replication, tuned: Mapping[str, Table]) -> Study:
    """The runs of a study.

    Args:
        study: with a sweep or an ablation.
        plan: of the study.
        tuned: the settings found by the search, by algorithm.

    Raises:
        ValueError: an invalid sweep, or a claim about runs that the sweep does not have.
    """

    def change(file: SweepFile) -> SweepFile:
        file = with_mazes(file, plan.mazes)
        return with_settings(file, tuned) if study.tuned else file

    load, name = (load_ablation, study.ablation) if study.ablation else (load_sweep, study.sweep)
    sweep = load(str(name), plan.version, change)
    check_cells(study, sweep, {path: name for name, path in plan.mazes.items()})
    return sweep


def check_cells(study: Experiment, sweep: Study, names: Mapping[str, str]) -> None:
    """ValueError for a claim about runs that the sweep does not have.

    Args:
        study, sweep: with the claims, and with the runs.
        names: of mazes by path.
    """
    rows = []
    for run in sweep.runs:
        row = {**flat_settings(run.settings), **run.given, **run.label}
        rows.append(row | {"maze": names.get(str(row.get("maze")), row.get("maze"))})
    for claim in study.claims:
        for cell in [cell for table in (claim.of, *claim.than) for cell in cells_of(table)]:
            check(
                any(all(row.get(n) == value for n, value in cell.items()) for row in rows),
                f"study {study.id!r}: the claim {claim.text!r} is about {cell}, but "
                f"{study.sweep or study.ablation} has no such run; correct the claim or the file",
            )


def with_mazes(file: SweepFile, mazes: Mapping[str, str]) -> SweepFile:
    """The same sweep file with user-defined mazes in place of shipped ones."""

    def other(table: Table | None) -> Table | None:
        if table is None or "maze" not in table:
            return table
        given = table["maze"]
        names = given if isinstance(given, list) else [given]
        if mazes:
            lacking = [n for n in names if BY_SIZE.fullmatch(n) and n not in mazes]
            check(
                not lacking,
                f"--mazes has {', '.join(mazes)}, but not {', '.join(lacking)}; add these sizes",
            )
        found = [mazes.get(name, name) for name in names]
        return {**table, "maze": found if isinstance(given, list) else found[0]}

    return msgspec.structs.replace(file, settings=other(file.settings), grid=other(file.grid))


def with_settings(file: SweepFile, tuned: Mapping[str, Table]) -> SweepFile:
    """The same sweep file with the settings found by the search, instead of [grid] algorithm."""
    grid, settings = dict(file.grid or {}), dict(file.settings or {})
    names = grid.pop("algorithm", None) or [settings.pop("algorithm", None)]
    variants = [{"name": name, "algorithm": name, **tuned.get(str(name), {})} for name in names]
    report = file.report
    if report is not None:
        report = msgspec.structs.replace(report, group=None)
    return msgspec.structs.replace(
        file, grid=grid, settings=settings, variants=variants, report=report
    )
