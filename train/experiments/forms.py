"""The forms of the files of sweeps: what a person writes, and what a sweep keeps in its folder."""

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
"""Gaps in per cent that an ablation waits for."""
REMEDY = "mend that line; the README's section on sweeps shows the form"
ANEW = "remove that file; the next `pursuit sweep` writes it anew"

Table = dict[str, Any]
"""Settings by name: which there are depends on the kind of run, and is checked with the values."""


class ReportHints(msgspec.Struct, forbid_unknown_fields=True):
    """[report]: what is on the axis, and what makes a curve of its own."""

    x: str | None = None
    group: list[str] | None = None


class Version(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """[short] or [full]: what it has lies over the rest of the file."""

    settings: Table | None = None
    grid: Table | None = None
    seeds: list[int] | None = None
    episodes: int | None = None
    search: Table | None = None


class SweepFile(Version, forbid_unknown_fields=True, omit_defaults=True):
    """A sweep file as it is written."""

    title: str | None = None
    kind: str | None = None
    variants: list[Table] | None = None
    report: ReportHints | None = None
    short: Version | None = None
    full: Version | None = None


class AblationFile(SweepFile, forbid_unknown_fields=True, omit_defaults=True):
    """An ablation file: a sweep's, with arms instead of variants, and a control.

    Attributes:
        arms: the variants; those of a sweep stay empty.
        primary: the one arm whose difference from the control is asked for: its p stands alone,
            those of the others are corrected for how many they are.
        margin: points of the gap within which an arm is to count as equal to the control.
        threshold: the gap in per cent whose time to reach is tested.
    """

    arms: list[Table] | None = None
    control: str | None = None
    primary: str | None = None
    margin: float | None = None
    threshold: float = 5.0


class Range(msgspec.Struct, forbid_unknown_fields=True):
    """A setting that is searched between two ends, even on this scale."""

    low: float
    high: float
    scale: str = "linear"
    whole: bool = False

    def __post_init__(self) -> None:
        check(self.scale in ("linear", "log"), f"scale={self.scale!r}; linear or log")
        check(
            math.isfinite(self.low) and math.isfinite(self.high),
            f"low={self.low} and high={self.high}; give finite numbers",
        )
        check(self.low < self.high, f"low={self.low} is not below high={self.high}")
        check(self.scale != "log" or self.low > 0, "scale='log' needs low above 0")


class Choices(msgspec.Struct, forbid_unknown_fields=True):
    """A setting that is drawn from a list."""

    choices: list[Any]

    def __post_init__(self) -> None:
        check(bool(self.choices), "choices is an empty list; give at least one value")


class Hints(msgspec.Struct):
    """`sweep.json`: what the report is to show, and which runs the plan has.

    Attributes:
        title: of the report.
        format: of the folder.
        runs: the names of the runs; None where nobody has said (all that are there).
        x, group: columns of the table of runs.
        control, arms, primary, margin, threshold: of an ablation (`AblationFile`).
    """

    title: str
    format: int = 1
    runs: list[str] | None = None
    x: str | None = None
    group: list[str] = msgspec.field(default_factory=list)
    control: str | None = None
    arms: list[str] = msgspec.field(default_factory=list)
    primary: str | None = None
    margin: float | None = None
    threshold: float = 5.0


Label = dict[str, bool | int | float | str | list[str] | None]
"""`run.json`: what the sweep file says of a run."""


def check_table(table: Any, where: str, values: bool = False) -> None:
    """ValueError unless `table` has plain values (or lists of them, if `values`) by name."""
    for name, value in table.items():
        if values:
            check(isinstance(value, list), f"{name}={value!r} in {where}; give a list of values")
            check(bool(value), f"{name} is an empty list in {where}; give at least one value")
        check(
            name != "seed",
            f"seed in {where} would be set by seeds; give seeds = [...] at the top of the file",
        )
        for item in value if values else [value]:
            check_plain(name, item, where)


def check_plain(name: str, value: Any, where: str) -> None:
    """ValueError unless a setting is a number, a text, true or false, or a list of texts."""
    plain = isinstance(value, bool | int | float | str)
    texts = isinstance(value, list) and all(isinstance(item, str) for item in value)
    named = name in ("task", "algorithm", "curriculum", "preset")  # others are read by these
    check(
        isinstance(value, str) if named else plain or texts,
        f"{name}={value!r} in {where}; give "
        + ("a name" if named else "a number, a text, true or false"),
    )


def check_seeds(seeds: Iterable[int]) -> None:
    """ValueError for no seeds, or for one that not every generator takes."""
    check(bool(seeds), "seeds is an empty list; give at least one value")
    for seed in seeds:
        check_seed(seed)


# -- what a sweep keeps ----------------------------------------------------------------------------


def read_hints(out: Path) -> Hints:
    """`sweep.json` of a folder, or what stands for it where there is none."""
    path = out / HINTS
    if not path.exists():
        return Hints(title=out.name)
    return read_as(Hints, read_json(path), path, ANEW)


def read_label(folder: Path) -> Label:
    """`run.json` of a run; empty where there is none."""
    path = folder / LABEL
    return read_as(Label, read_json(path), path, ANEW) if path.exists() else {}
