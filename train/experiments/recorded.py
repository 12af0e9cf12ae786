"""Finished runs as rows of a CSV file, so that a study goes on another day, on another machine.

A run whose row says that it is complete is not executed again; its name has a fingerprint of
everything that affects the results.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path

from filelock import FileLock

from pursuit.validation import check
from train.experiments.shards import row_files
from train.files import LOCK, write_csv
from train.reports.tables import Row
from train.runs.folder import RESULTS_FORMAT

FIRST = ("run", "kind", "status")
"""The first columns. The settings of the study file that vary follow, then "seed" and the rest."""
MEASURED = {"seconds": "budget_seconds", "frames": "budget_frames"}
"""New names of settings whose names are those of measurements in the table of runs."""
TEXTS = {"run", "kind", "status", "variant", "game", "maze", "commit", "machine", "error"}
"""Columns that are never numbers."""
WORDS = {"objective", "unit", "scripted", "curve"}
"""Results that are no numbers, or several."""
Cells = dict[str, dict[str, object]]
"""By run, what its row says of its settings."""
REMEDY = "correct it, or remove the row so that the run is repeated"


def read_recorded(path: Path | None, planned: Cells | None = None) -> dict[str, Row]:
    """The rows by the name of the run, with numbers, booleans and None for empty cells, of a file
    and those of shards beside it; nothing if there are none.

    Of a run that is in several files the row counts that says complete.

    Args:
        path: of the file.
        planned: the settings of the runs of a study, which the rows of these runs must have.

    Raises:
        ValueError: no rows of runs, a run twice in a file, text or an infinite number where a
            result is a number, or other settings than those of the study; with the line and the
            column.
    """
    return {} if path is None else read_files(row_files(path), planned)


def read_files(files: Iterable[Path], planned: Cells | None = None) -> dict[str, Row]:
    """The rows of these files together, as `read_recorded`."""
    placed = [each for path in files for each in cells_in(path)]
    rows = [cells for _, cells in placed]
    names = [*rows[0]] if len({*map(tuple, rows)}) == 1 else columns_of(rows)
    chosen = dict[str, int]()
    results = names[names.index("seed") + 1 :]
    numbers = [name for name in results if holds_numbers(name, rows)]
    for place, (where, cells) in enumerate(placed):
        run = cells["run"]
        if run not in chosen or rows[chosen[run]]["status"] != "complete":
            chosen[run] = place
        for name in numbers:
            cell = cells.get(name, "")
            check(
                cell == "" or is_number(cell),
                f"{where}, column {name}: {cell!r} is no finite number; {REMEDY}",
            )
        check_format(where, cells)
        for name, value in (planned or {}).get(run, {}).items():
            own = cells.get(name)
            check(
                own is not None or value is None, f"{where}: the column {name} is missing; {REMEDY}"
            )
            check(
                same(own or "", value),
                f"{where}, column {name}: {own!r}, but the study has {value!r}; {REMEDY}",
            )
    columns = {name: typed_column(name, [cells.get(name, "") for cells in rows]) for name in names}
    return {run: {name: columns[name][place] for name in names} for run, place in chosen.items()}


def cells_in(path: Path) -> list[tuple[str, dict[str, str]]]:
    """The rows of a file as text, each with its place for messages; ValueError as `read_recorded`
    if they are no rows of runs, or of one run twice."""
    rows, lines = dict[str, tuple[str, dict[str, str]]](), [1]
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, strict=True)
            for cells in reader:
                lines.append(reader.line_num)
                whole = None not in cells and None not in cells.values()
                check(
                    whole and {*FIRST, "seed"} <= set(cells),
                    f"{path}, line {lines[-1]}: no row of a run; remove that line, so that the "
                    "run is repeated, or give a file written by --rows",
                )
                nul = [name for name, cell in cells.items() if "\0" in cell]
                where, run = f"{path}, line {lines[-1]}", cells["run"]
                check(not nul, f"{where}, column {', '.join(nul)}: a NUL byte; {REMEDY}")
                check(
                    run not in rows, f"{where}: a second row of the run {run}; remove one of them"
                )
                rows[run] = (where, cells)
    except (UnicodeDecodeError, csv.Error) as error:
        where = f"{path}, after line {lines[-1]}"
        raise ValueError(f"{where}: no CSV file ({error}); give one written by --rows") from None
    return list(rows.values())


def check_format(where: str, cells: dict[str, str]) -> None:
    """Check that a row is one of this version; rows of the first format have no number of it.

    Raises:
        ValueError: a later format, or outcomes in the first, where time-outs were successes.
    """
    found = int(cells.get("format") or 1) if (cells.get("format") or "1").isdigit() else 0
    check(
        1 <= found <= RESULTS_FORMAT,
        f"{where}: has format {cells.get('format')}, this version of pursuit reads 1 to "
        f"{RESULTS_FORMAT}; use the version that wrote it",
    )
    check(
        found > 1 or cells.get("objective") != "outcome",
        f"{where}: has format 1, where time-outs of escapes counted as successes; remove the row "
        "so that the run is repeated",
    )


def holds_numbers(name: str, rows: list[dict[str, str]]) -> bool:
    """Whether a column of results holds numbers: the measure does, and each with a number in it."""
    if name in TEXTS | WORDS or name.endswith("_version"):
        return False
    cells = [row.get(name, "") for row in rows]
    measured = name in {row.get("objective") for row in rows}
    return measured or any(is_number(cell) or is_infinite(cell) for cell in cells)


def is_infinite(text: str) -> bool:
    """Whether a cell is an infinite number."""
    return text.strip().lstrip("+-").lower() in ("inf", "infinity")


def is_number(text: str) -> bool:
    """Whether a cell is a number, or a boolean; not infinite. NaN is "not known"."""
    try:
        return text in ("True", "False") or not math.isinf(float(text))
    except ValueError:
        return False


def same(text: str, value: object) -> bool:
    """Whether a cell holds a value."""
    if value is None or isinstance(value, str | bool):
        return text == ("" if value is None else str(value))
    if isinstance(value, int) and re.fullmatch(r"-?\d+", text):
        return int(text) == value
    return is_number(text) and text not in ("True", "False") and float(text) == value


def typed_column(name: str, values: list[str]) -> list[object]:
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


def complete_in(path: Path | None, planned: Cells | None = None) -> set[str]:
    """The names of the runs that are complete by their rows, as `read_recorded`."""
    rows = read_recorded(path, planned)
    return {name for name, row in rows.items() if row["status"] == "complete"}


def record(path: Path, row: Row) -> None:
    """Add the row of a run, or replace the one that is there, atomically; several processes may."""
    path.parent.mkdir(parents=True, exist_ok=True)
    row = {n: None if isinstance(v, float) and math.isinf(v) else v for n, v in row.items()}
    with lock_of(path):
        rows = {**read_files([path] if path.exists() else ()), str(row["run"]): row}
        write_csv(path, list(rows.values()), columns_of(rows.values()))


def lock_of(path: Path) -> FileLock:
    """The lock of a file of rows while it is written."""
    return FileLock(path.with_name(f".{path.name}{LOCK}"))


def columns_of(rows: Iterable[Row]) -> list[str]:
    """The columns of all rows: `FIRST`, settings, "seed", and the rest."""
    settings, rest = dict[str, None](), dict[str, None]()
    for row in rows:
        names = list(row)
        settings |= dict.fromkeys(varied_settings(names))
        rest |= dict.fromkeys(names[names.index("seed") + 1 :])
    return [*FIRST, *settings, "seed", *rest]


def varied_settings(columns: list[str]) -> list[str]:
    """The columns of settings that vary."""
    return columns[len(FIRST) : columns.index("seed")]
