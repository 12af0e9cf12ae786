"""Finished runs as rows of a CSV file, so that a study goes on another day, on another machine.

A run whose row says that it is complete is not executed again; its name has a fingerprint of
everything that affects the results.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable
from pathlib import Path

from filelock import FileLock

from pursuit.validation import check
from train.files import LOCK, write_csv
from train.reports.tables import Row

FIRST = ("run", "kind", "status")
"""The first columns. The settings of the study file that vary follow, then "seed" and the rest."""
TEXTS = {"run", "kind", "status", "variant", "game", "maze", "commit", "machine", "error"}
"""Columns that are never numbers."""


def read_recorded(path: Path | None) -> dict[str, Row]:
    """The rows by the name of the run, with numbers, booleans and None for empty cells; nothing if
    there is no such file.

    Raises:
        ValueError: no rows of runs.
    """
    if path is None or not path.exists():
        return {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file, strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: no CSV file ({error}); give one written by --rows") from None
    for row in rows:
        whole = None not in row and None not in row.values() and {*FIRST, "seed"} <= set(row)
        check(whole, f"{path}: no rows of runs; give a file written by --rows, or a new one")
    columns = {name: typed(name, [row[name] for row in rows]) for name in (rows[0] if rows else ())}
    typed_rows = [{name: columns[name][place] for name in columns} for place in range(len(rows))]
    return {str(row["run"]): row for row in typed_rows}


def typed(name: str, values: list[str]) -> list[object]:
    """A column with numbers or booleans where all of its values are such, and None for ""."""
    if name not in TEXTS and not name.endswith("_version"):
        booleans = {"True": True, "False": False}
        forms: tuple[Callable[[str], object], ...] = (int, float, booleans.__getitem__)
        for form in forms:
            try:
                return [form(value) if value else None for value in values]
            except (ValueError, KeyError):
                continue
    return [value or None for value in values]


def complete_in(path: Path | None) -> set[str]:
    """The names of the runs that are complete by their rows, as `read_recorded`."""
    return {name for name, row in read_recorded(path).items() if row["status"] == "complete"}


def record(path: Path, row: Row) -> None:
    """Add the row of a run, or replace the one that is there, atomically; several processes may."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path.with_name(f".{path.name}{LOCK}")):
        rows = {**read_recorded(path), str(row["run"]): row}
        write_csv(path, list(rows.values()), columns_of(rows.values()))


def columns_of(rows: Iterable[Row]) -> list[str]:
    """The columns of all rows: `FIRST`, settings, "seed", and the rest."""
    settings, rest = dict[str, None](), dict[str, None]()
    for row in rows:
        names = list(row)
        settings |= dict.fromkeys(settings_in(names))
        rest |= dict.fromkeys(names[names.index("seed") + 1 :])
    return [*FIRST, *settings, "seed", *rest]


def settings_in(columns: list[str]) -> list[str]:
    """The columns of settings that vary."""
    return columns[len(FIRST) : columns.index("seed")]
