"""Schemas of sweep files, and of the files that a sweep writes to its folder."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from train.files import read_json
from train.schemas import read_as
from train.settings.checks import check, check_seed

HINTS, LABEL = "sweep.json", "run.json"
VERSIONS = ("short", "full")
THRESHOLDS = (20.0, 10.0, 5.0, 2.0)
"""Gaps in per cent; an ablation reports the times to reach them."""
REMEDY = "correct that line; docs/guides shows the form"
ANEW = "remove that file; the next `pursuit sweep` writes it again"

Table = dict[str, Any]
"""Settings by name; names and values are checked by the kind of run."""


class ReportHints(msgspec.Struct, forbid_unknown_fields=True):
    """[report]: the setting on the axis, and the settings that distinguish curves."""

    x: str | None = None
    group: list[str] | None = None


class Version(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """[short] or [full]: values that override the rest of the file."""

    settings: Table | None = None
    grid: Table | None = None
    seeds: list[int] | None = None
    episodes: int | None = None
    search: Table | None = None


class SweepFile(Version, forbid_unknown_fields=True, omit_defaults=True):
    """The contents of a sweep file."""

    title: str | None = None
    kind: str | None = None
    variants: list[Table] | None = None
    report: ReportHints | None = None
    short: Version | None = None
    full: Version | None = None


class AblationFile(SweepFile, forbid_unknown_fields=True, omit_defaults=True):
    """An ablation file: a sweep file with a control.

    Attributes:
        control: the variant that the others are compared with.
        primary: the variant of the primary comparison. Its p is not corrected; those of the others
            are corrected for multiple comparisons.
        margin: equivalence margin in percentage points of the gap.
        threshold: the gap in per cent; the times to reach it are tested.
    """

    control: str | None = None
    primary: str | None = None
    margin: float | None = None
    threshold: float = 5.0


class Range(msgspec.Struct, forbid_unknown_fields=True):
    """A setting that is drawn uniformly from an interval, on a linear or logarithmic scale."""

    low: float
    high: float
    scale: str = "linear"
    whole: bool = False

    def __post_init__(self) -> None:
        check(self.scale in ("linear", "log"), f"scale={self.scale!r}; give linear or log")
        check(
            math.isfinite(self.low) and math.isfinite(self.high),
            f"low={self.low} and high={self.high}; give finite numbers",
        )
        check(self.low < self.high, f"low={self.low} is not below high={self.high}; exchange them")
        check(self.scale != "log" or self.low > 0, f"low={self.low}; scale='log' needs low above 0")


class Choices(msgspec.Struct, forbid_unknown_fields=True):
    """A setting that is drawn from a list."""

    choices: list[Any]

    def __post_init__(self) -> None:
        check(bool(self.choices), "choices is an empty list; give at least one value")


class Hints(msgspec.Struct):
    """`sweep.json`: the layout of the report, and the runs of the sweep.

    Attributes:
        title: of the report.
        format: version of the folder layout.
        runs: the names of the runs; None for all runs in the folder.
        x, group: columns of the table of runs.
        control, variants, primary, margin, threshold: of an ablation (`AblationFile`); `variants`
            are names.
    """

    title: str
    format: int = 1
    runs: list[str] | None = None
    x: str | None = None
    group: list[str] = msgspec.field(default_factory=list)
    control: str | None = None
    variants: list[str] = msgspec.field(default_factory=list)
    primary: str | None = None
    margin: float | None = None
    threshold: float = 5.0


Label = dict[str, bool | int | float | str | list[str] | None]
"""`run.json`: the values of the sweep file for one run."""


def check_table(table: Any, where: str, values: bool = False) -> None:
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


def check_plain(name: str, value: Any, where: str) -> None:
    """ValueError unless a setting is a number, a string, a boolean, or a list of strings."""
    plain = isinstance(value, bool | int | float | str)
    texts = isinstance(value, list) and all(isinstance(item, str) for item in value)
    named = name in ("task", "algorithm", "curriculum", "preset")  # these need a name
    check(
        isinstance(value, str) if named else plain or texts,
        f"{name}={value!r} in {where}; give "
        + ("a name" if named else "a number, a string, true or false"),
    )


def check_seeds(seeds: Iterable[int]) -> None:
    """ValueError for an empty list, or for a seed that is out of range."""
    check(bool(seeds), "seeds is an empty list; give at least one value")
    for seed in seeds:
        check_seed(seed)


# -- files in the folder of a sweep ----------------------------------------------------------------


def read_hints(out: Path) -> Hints:
    """`sweep.json` of a folder, or a default if there is none."""
    path = out / HINTS
    if not path.exists():
        return Hints(title=out.name)
    return read_as(Hints, read_json(path), path, ANEW)


def read_label(folder: Path) -> Label:
    """`run.json` of a run; empty if there is none."""
    path = folder / LABEL
    return read_as(Label, read_json(path), path, ANEW) if path.exists() else {}
