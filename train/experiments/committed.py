"""Rows beside results pages, and which of them are the runs of a study file.

Runs are matched by their settings, as the fingerprints in the names of runs change with the code.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from train.experiments.expansion import NO_SETTINGS
from train.experiments.recorded import typed_column, varied_settings
from train.experiments.rows import StudyRows
from train.experiments.study import Layout, StudyFile, choose_version, read_file
from train.experiments.tuning import score
from train.files import read_csv
from train.reports.tables import Row

UNITS = ("game", "maze")
"""The columns by which the runs of an ablation are paired."""


def read_table(path: Path) -> list[Row]:
    """The rows of a CSV file, with numbers, booleans and None for empty cells where all cells of a
    column are such.

    Raises:
        ValueError: as `read_csv`.
    """
    rows = read_csv(path)
    columns = {name: typed_column(name, [row[name] for row in rows]) for name in (rows or [{}])[0]}
    return [
        dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)
    ]


def grouped(rows: Iterable[Row], *names: str) -> dict[Any, list[Row]]:
    """Rows by their value in a column, or their values in several, in the order of the rows."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        key = tuple(row[name] for name in names)
        found.setdefault(key if len(names) > 1 else key[0], []).append(row)
    return found


def ablation_of(name: str | Path) -> StudyFile:
    """An ablation by its name or path, in the full version if it has one.

    Raises:
        ValueError: as `read_file`.
    """
    _, file = read_file(str(name), "ablation", StudyFile)
    return choose_version(file, "full" if file.full else None)


def units_of(file: StudyFile) -> tuple[str, list[object]]:
    """What the runs of an ablation are paired by, and its values: its games, else its mazes."""
    unit = next((name for name in UNITS if name in file.grid), "maze")
    return unit, file.grid.get(unit, [file.settings.get(unit)])


def committed_rows(file: StudyFile, rows: Iterable[Row]) -> StudyRows:
    """The rows of the runs of an ablation with a budget of frames, complete or not.

    Args:
        file: of the ablation.
        rows: of these runs and others; several ablations may have runs in common.
    """
    names = [str(variant["name"]) for variant in file.variants or ()]
    unit, values = units_of(file)
    x = unit if unit in file.grid else None
    layout = Layout(str(file.title), x=x, control=file.control, primary=file.primary)
    layout.variants = names
    frames = file.settings["frames"]
    everything = [
        row | {"_x": row[unit] if x else ""}
        for row in rows
        if row["variant"] in names and row[unit] in values and row["budget_frames"] == frames
    ]
    complete = [row for row in everything if row["status"] == "complete"]
    return StudyRows(layout, complete, everything, x)


def has_all_runs(file: StudyFile, study: StudyRows) -> bool:
    """Whether there is a row for every variant, game or maze, and seed of an ablation."""
    wanted = len(file.variants or ()) * len(units_of(file)[1]) * len(file.seeds or ())
    return len(study.everything) == wanted


def chosen_trials(file: StudyFile, rows: Iterable[Row]) -> dict[str, list[Row]]:
    """By searched variant the rows of the trial that [tuning] of an ablation chose: that of the
    best score in the last rung, of those of which all runs are complete.

    Args:
        file: of the ablation; without [tuning] nothing is chosen.
        rows: of the search and others.
    """
    if file.tuning is None:
        return {}
    trials, units = file.tuning.full, file.tuning.games or file.tuning.mazes
    frames = (trials.frames or 0) * 2 ** (trials.rungs - 1)
    found: dict[str, list[Row]] = {}
    for variant in file.variants or ():
        own: dict[int, list[Row]] = {}
        for row in rows:
            unit = row["game"] if file.tuning.games else row["maze"]
            same = row["variant"] == variant["name"] and row["budget_frames"] == frames
            if same and unit in units and variant["name"] not in file.tuning.like:
                own.setdefault(row["trial"], []).append(row)
        ended = [n for n in own if all(row["status"] == "complete" for row in own[n])]
        if ended:
            best = min(ended, key=lambda number: (score(own[number]), number))
            found[str(variant["name"])] = own[best]
    return found


def tried_settings(row: Row) -> Row:
    """The settings that a trial drew."""
    other = (*UNITS, "variant", *NO_SETTINGS)
    names = [name for name in varied_settings([*row]) if name not in other]
    return {name: row[name] for name in names if row[name] is not None}
