"""Studies as data: the schemas of their files, and reading these.

A study file has settings, a grid or variants, seeds and a budget, and names the analysis of its
runs: "summary" (of a sweep), "variants" or "paired" (against the `control` of an ablation),
"libraries" (`kind = "contestant"`). With [tuning] settings are searched on other mazes first. A
replication file lists studies and the claims that their runs decide.

All go the same way: file, `expansion`, runs in folders (`runs`, `executors`), `rows`, analysis
(`summary`, `variants`, `libraries`, `claims`), `report`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pursuit.plugins import reading
from pursuit.validation import check, one_of
from train.files import read_toml
from train.schemas import read_as
from train.settings.self_play import OPPOSING_ROLES, unnested_sides

FILES = Path(__file__).with_name("files")
FOLDERS = {"sweep": FILES}
FOLDERS |= {kind: FILES / f"{kind}s" for kind in ("ablation", "comparison", "replication")}
"""The folders of shipped files, by kind of study."""
VERSIONS = ("short", "full")
TABLES = ("settings", "grid", "search")
"""Tables of settings."""
SUMMARY, VARIANTS, PAIRED, LIBRARIES = ANALYSES = ("summary", "variants", "paired", "libraries")
"""The analyses of runs that a study file can name. A replication file has "claims"."""
REPORTED_GAPS = (20.0, 10.0, 5.0, 2.0)
"""Gaps in per cent; an ablation reports the times to reach them."""
ENDED = ("complete", "failed")
"""Statuses of runs that have ended."""
REMEDY = "correct that line; docs/guides/sweeps.md shows the form"

THRESHOLD_RULES = ("diverges", "learns", "within", "beyond", "part_above", "part_below")
"""Rules that compare each run with a threshold."""
COMPARISONS = ("lower", "higher")
"""Rules that compare the distances of settings to the optimum."""
COMPARED_TO = {"optimal": "optimal_steps", "scripted": "scripted_steps", "limit": "max_steps"}
"""Columns of the references of claims."""
PARTS = ("objective", "learning", "loops")
"""Parts of a gap."""

Table = dict[str, Any]
"""Settings by name; names and values are checked by the kind of run."""
Form = TypeVar("Form")


# -- sweeps, ablations and comparisons -------------------------------------------------------------


class ReportHints(msgspec.Struct, forbid_unknown_fields=True):
    """[report]: the setting on the axis, and the settings that distinguish curves."""

    x: str | None = None
    group: list[str] | None = None


class Version(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """[short] or [full]: values that override the rest of the file; `only` names its variants."""

    settings: Table | None = None
    grid: Table | None = None
    seeds: list[int] | None = None
    episodes: int | None = None
    search: Table | None = None
    only: list[str] | None = None


class Trials(msgspec.Struct, forbid_unknown_fields=True):
    """[tuning.short] or [tuning.full]: trials of each algorithm or library, and their budget.

    Attributes:
        samples: number of trials.
        seconds, frames: of each trial; one of the two.
        rungs: of successive halving: the better half of the trials of a rung goes on to the next
            one, with twice the budget. One rung is random search.
        mazes: of each task, the first ones of the list; None for all.
    """

    samples: int
    seconds: float | None = None
    frames: int | None = None
    mazes: int | None = None
    rungs: int = 1

    def __post_init__(self) -> None:
        check(self.samples > 0, f"samples={self.samples} in [tuning]; give at least 1")
        check(self.rungs > 0, f"rungs={self.rungs} in [tuning]; give at least 1")
        check(
            2 ** (self.rungs - 1) <= self.samples,
            f"rungs={self.rungs} with samples={self.samples} in [tuning]; give at most "
            f"{self.samples.bit_length()}: every rung keeps half of the trials",
        )
        check_budget(self.seconds, self.frames, " in [tuning]", 2 ** (self.rungs - 1))
        check(
            self.mazes is None or self.mazes > 0,
            f"mazes={self.mazes} in [tuning]; give at least 1, or leave it out to use all",
        )


class Tuning(msgspec.Struct, forbid_unknown_fields=True):
    """[tuning]: the search for settings, with the same budget for every algorithm or library.

    In an ablation every variant that is in `space` is searched; with "all" every one not in `like`.

    Attributes:
        mazes: of the search; runs of the study use other mazes. By variant, or for all.
        games: of the search of an ablation, in place of mazes.
        space: the searched settings by algorithm, library or variant, in the form of [search];
            those of "all" are for every one.
        like: of an ablation, variants by name that have the settings found for another one, but for
            those that they set themselves.
        settings: of all trials.
        shipped: whether the first trial has the default settings.
        search_seed: of the draws.
    """

    space: dict[str, Table]
    short: Trials
    full: Trials
    mazes: list[str] | dict[str, list[str]] = []
    games: list[str] = []
    like: dict[str, str] = {}
    settings: Table = {}
    shipped: bool = True
    search_seed: int = 0

    def trials(self, version: str | None) -> Trials:
        """The trials of a version, "short" or "full"; short by default."""
        return self.full if version == "full" else self.short


class StudyFile(Version, forbid_unknown_fields=True, omit_defaults=True):
    """The contents of a study file.

    Attributes:
        analysis: one of `ANALYSES`; None for the usual one of such runs.
        control: the variant that the others are compared with.
        primary: the variant of the primary comparison. Its p is not corrected; those of the others
            are corrected for multiple comparisons.
        margin: equivalence margin in percentage points of the gap.
        threshold: the gap in per cent; the times to reach it are tested.
        tuning: the search before the runs.
        paired: whether the place of a maze in [grid] is that of its only seed in `seeds`, instead
            of all seeds for every maze.
    """

    settings: Table = {}
    grid: Table = {}
    search: Table = {}
    title: str | None = None
    kind: str | None = None
    analysis: str | None = None
    variants: list[Table] | None = None
    report: ReportHints | None = None
    short: Version | None = None
    full: Version | None = None
    control: str | None = None
    primary: str | None = None
    margin: float | None = None
    threshold: float = 5.0
    tuning: Tuning | None = None
    paired: bool = False


class Layout(msgspec.Struct):
    """`sweep.json` in the folder of a study: the layout of its report, and its runs.

    Attributes:
        title: of the report.
        format: version of the folder layout.
        runs: the names of the runs; None for all runs in the folder.
        x, group: columns of the table of runs.
        variants: their names, in order.
        analysis: of the runs; None in folders of versions before 0.2.0.
        control, primary, margin, threshold: as `StudyFile`.
        rows: the file with the rows of finished runs, if there is one, relative to the folder.
        planned: by run the columns of its row that the study sets.
    """

    title: str
    format: int = 1
    runs: list[str] | None = None
    rows: str | None = None
    planned: dict[str, Table] = msgspec.field(default_factory=dict)
    x: str | None = None
    group: list[str] = msgspec.field(default_factory=list)
    analysis: str | None = None
    control: str | None = None
    variants: list[str] = msgspec.field(default_factory=list)
    primary: str | None = None
    margin: float | None = None
    threshold: float = 5.0


# -- claims ----------------------------------------------------------------------------------------


class Claim(msgspec.Struct, forbid_unknown_fields=True):
    """A claim and its decision rule.

    Attributes:
        text: the claim.
        rule: one of `THRESHOLD_RULES` or `COMPARISONS`.
        of: the cells of the claim: columns of the table of runs with a value or a list of values.
        than: the cells that they are compared with.
        to, percent: a reference of `COMPARED_TO`, and the tolerance around it in per cent.
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
        one_of("rule", self.rule, (*THRESHOLD_RULES, *COMPARISONS))
        one_of("to", self.to, tuple(COMPARED_TO))
        one_of("part", self.part, PARTS)
        check(
            (self.rule in COMPARISONS) == bool(self.than),
            f"rule={self.rule!r} and than={self.than}; give than for lower and higher only",
        )


class ClaimedStudy(msgspec.Struct, forbid_unknown_fields=True):
    """[[studies]] of a replication: a figure or table, its claims, and the runs that decide them.

    Attributes:
        id: its name on the command line.
        title: of its section in the report.
        thesis, differs: the conditions in the thesis, and the differences here.
        claims: see `Claim`.
        sweep, ablation: the name of a study file with the runs; one of the two.
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
    tuned: bool = False
    versions: tuple[str, ...] = VERSIONS
    least_frames: int = 0

    def __post_init__(self) -> None:
        check(bool(self.sweep) != bool(self.ablation), f"study {self.id!r}: give sweep or ablation")
        check(bool(self.claims), f"study {self.id!r}: no claims; give [[studies.claims]]")


class ReplicationFile(msgspec.Struct, forbid_unknown_fields=True):
    """The contents of a replication file: studies, and the claims that their runs decide."""

    title: str
    studies: list[ClaimedStudy]
    tuning: Tuning | None = None

    def __post_init__(self) -> None:
        tuned = [study.id for study in self.studies if study.tuned]
        check(
            not tuned or self.tuning is not None,
            f"tuned studies ({', '.join(tuned)}) need [tuning]; give it, or leave tuned out",
        )


# -- reading ---------------------------------------------------------------------------------------


def shipped(kind: str = "sweep") -> list[str]:
    """The names of the shipped files of a kind of study."""
    return sorted(path.stem for path in FOLDERS[kind].glob("*.toml"))


def read_file(name: str, kind: str, form: type[Form]) -> tuple[Path, Form]:
    """The path and the content of a TOML file, or of the shipped one of that name.

    Raises:
        ValueError: no such file, invalid TOML, or content of another form.
    """
    path, names = Path(name), shipped(kind)
    if not path.is_file() and name in names:  # a folder of that name may hold an earlier run
        path = FOLDERS[kind] / f"{name}.toml"
    check(path.is_file(), f"{name}: no such {kind} file; shipped are {', '.join(names)}")
    content = read_toml(path, REMEDY)
    check("arms" not in content, f"{path}: [[arms]] was renamed; give [[variants]]")
    return path, read_as(form, unnested_tables(content), path, REMEDY)


def judged(file: StudyFile, name: str) -> list[str]:
    """The mazes or games (`name` "maze" or "game") of the runs of a study, wherever the file sets
    them."""
    tables = [file.settings, *(file.variants or ()), file.grid, file.search]
    values: list[Any] = [table[name] for table in tables if name in table]
    values = [value["choices"] if isinstance(value, dict) else value for value in values]
    each = [value if isinstance(value, list) else [value] for value in values]
    return [value for several in each for value in several if isinstance(value, str)]


@contextmanager
def content_of(path: Path) -> Iterator[None]:
    """While the content of a study file is used: what it names must be allowed; errors name it."""
    with reading(path):
        try:
            yield
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None


def unnested_tables(content: Table, small: bool = False) -> Table:
    """The content of a file with the tables of one side as names such as chaser.entropy_coef.

    Args:
        content: of the file, or of one of its versions.
        small: whether the file names a small game; then every table is that of a player.
    """
    found, variants = dict(content), content.get("variants")
    tables = [content.get(name) for name in TABLES]
    tables += variants if isinstance(variants, list) else []
    small = small or any(isinstance(table, dict) and "game" in table for table in tables)

    def flat(name: str, table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        return unnested_sides(table, sides_in(table, name) if small else OPPOSING_ROLES)

    for name, value in content.items():
        if name in VERSIONS and isinstance(value, dict):
            found[name] = unnested_tables(value, small)
        elif name in TABLES:
            found[name] = flat(name, value)
        elif name == "variants" and isinstance(value, list):
            found[name] = [flat(name, each) for each in value]
    return found


def sides_in(table: Table, name: str) -> list[str]:
    """The players with a table of settings in a table of the file; in [search] ranges are tables,
    too."""
    sides = {side: [*own.values()] for side, own in table.items() if isinstance(own, dict)}
    return [s for s, own in sides.items() if name != "search" or {*map(type, own)} == {dict}]


def choose_version(file: StudyFile, version: str | None) -> StudyFile:
    """The file overridden by the chosen version, by default the first that it has."""
    check(version in (None, *VERSIONS), f"unknown version {version!r}; short or full")
    has = [name for name in VERSIONS if getattr(file, name) is not None]
    check(version is None or version in has, f"no version {version!r}; there is {has or 'none'}")
    chosen = version or (has[0] if has else None)
    over: Table = dict.fromkeys(VERSIONS)
    for name in Version.__struct_fields__ if chosen else ():
        value = getattr(getattr(file, str(chosen)), name)
        if value is not None:
            over[name] = {**getattr(file, name), **value} if isinstance(value, dict) else value
    found = msgspec.structs.replace(file, **over)
    if found.only is not None:
        names = [variant.get("name") for variant in found.variants or ()]
        for name in found.only:
            check(name in names, f"only={found.only}; give some of the variants {names}")
        check_once("only", found.only)
        found.variants = [v for v in found.variants or () if v.get("name") in found.only]
    return found


# -- checks of values ------------------------------------------------------------------------------


def check_table(table: Table, where: str, values: bool = False) -> None:
    """ValueError unless the values of `table` are plain (or lists of plain values, if `values`)."""
    for name, value in table.items():
        if values:
            check(isinstance(value, list), f"{name}={value!r} in {where}; give a list of values")
            check(bool(value), f"{name} is an empty list in {where}; give at least one value")
        check(
            name != "seed",
            f"seed in {where} is not allowed; give seeds = [...] at the top of the file",
        )
        for item in value if values else [value]:
            check_plain(name, item, where)


def check_plain(name: str, value: object, where: str) -> None:
    """ValueError unless a setting is a number, a string, a boolean, or a list of strings."""
    plain = isinstance(value, bool | int | float | str)
    texts = isinstance(value, list) and all(isinstance(item, str) for item in value)
    named = name in ("task", "algorithm", "curriculum", "preset", "contestant")
    check(
        isinstance(value, str) if named else plain or texts,
        f"{name}={value!r} in {where}; give "
        + ("a name" if named else "a number, a string, true or false"),
    )


def check_budget(
    seconds: float | None, frames: int | None, where: str = "", times: int = 1
) -> None:
    """ValueError unless a budget in seconds or in frames is given; `times` it is used at most."""
    check(
        (seconds is None) != (frames is None),
        f"seconds={seconds} and frames={frames}{where}; give one of the two",
    )
    budget = float((seconds if frames is None else frames) or 0) * times
    check(0 < budget < 1e9, f"budget {budget:g}{where}; give one above 0 and below 1e9")


def check_once(name: str, values: Sequence[object]) -> None:
    """ValueError for an empty list or repeated values."""
    check(len(set(values)) == len(values) > 0, f"{name}={values}; give one or more, each once")
