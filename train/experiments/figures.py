"""The figures of studies: learning curves and final values, from rows and evaluations."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from train.evaluation.scores import Measure
from train.experiments.measures import interval_of, references_of, size_of
from train.experiments.rows import StudyRows, by_variant, column_of, longer_is_better
from train.experiments.statistics import NAN, distance_interval
from train.reports.curves import SINGLE_RUNS, Level, LineStyle, Panel, Series, draw_panels
from train.reports.figures import (
    BLACK,
    GREEN,
    GREY,
    PALETTE,
    PlottedEstimate,
    draw_intervals,
    time_scale,
)
from train.reports.tables import Row

COLUMNS = 4
"""Maximum number of panels per row."""
LINES = (
    f"{SINGLE_RUNS}. Grey: the control. Dotted: the optimum (horizontal), and for each run the "
    "start of its last stage (vertical)"
)
LEVELS: dict[str, tuple[str, LineStyle]] = {
    "random": (GREY, "--"),
    "scripted": (BLACK, ":"),
    "optimal": (GREEN, "--"),
}
"""Colours and styles of the references of returns, goals and outcomes."""
ELSEWHERE = "no curves: these runs\nare in another folder"
"""In a panel whose runs are known by their rows alone."""
COLORS = tuple(color for color in PALETTE if color != GREY)


@dataclass(frozen=True)
class Drawing:
    """How the figures of a report are drawn.

    Attributes:
        unit: of training time: frames or seconds.
        log: whether the axis of training time is logarithmic.
        y: the scale of the vertical axis of curves, "linear" or "log"; None for the usual one.
        also: the format of figures beside .png, as of `save`.
        title: of report and figures; None for the usual one.
    """

    unit: str = "frames"
    log: bool = False
    y: str | None = None
    also: str = "svg"
    title: str | None = None

    @property
    def below(self) -> str:
        """What a logarithmic axis does not show."""
        return ". Values of 0 and less are below the axis" * (self.y == "log")


def unit_of(study: StudyRows) -> str:
    """The unit of training time: that of the budget."""
    in_frames = all(row.get("budget_frames") is not None for row in study.rows)
    return "frames" if in_frames else "seconds"


def curve_of(
    study: StudyRows, row: Row, column: str, factor: float, unit: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The known values of a column over training time."""
    evaluations = study.curves.get(row["run"], [])
    values = factor * column_of(evaluations, column)
    times, known = time_scale(unit) * column_of(evaluations, unit), ~np.isnan(values)
    return times[known], values[known]


def draw_curves(path: Path, study: StudyRows, measures: Sequence[Measure], how: Drawing) -> None:
    """Measures over seconds or frames: a panel for each measure and x, one colour per group."""
    groups = list(dict.fromkeys(row["_group"] for row in study.rows))
    panels: list[Panel] = []
    for measure in measures:
        for value in sorted({row["_x"] for row in study.rows}, key=size_of):
            series = []
            for place, name in enumerate(groups):
                own = [r for r in study.rows if (r["_x"], r["_group"]) == (value, name)]
                found = [curve_of(study, r, measure.column, measure.factor, how.unit) for r in own]
                curves = [curve for curve in found if len(curve[0])]
                color = PALETTE[place % len(PALETTE)]
                if curves:
                    series.append(
                        Series(curves, name, color, interval=partial(interval_of, measure))
                    )
            here = [row for row in study.rows if row["_x"] == value]
            title = f"{str(study.x).replace('_', ' ')} {value}" if study.x else ""
            first = measure.title if not len(panels) % COLUMNS else ""
            levels = levels_of(measure, here)
            note, scale = "" if series else ELSEWHERE, how.y or measure.scale
            panels.append(Panel(series, first, title, scale, levels=levels, note=note))
    grid = [panels[first : first + COLUMNS] for first in range(0, len(panels), COLUMNS)]
    title = study.layout.title
    draw_panels(path, grid, how.unit, title, True, how.log, SINGLE_RUNS + how.below, how.also)


def levels_of(measure: Measure, rows: Sequence[Row]) -> list[Level]:
    """Lines of the references in the measure of these runs: their means."""
    if measure.name not in ("steps", "goals", "return", "outcome"):
        return []
    references, levels = references_of(measure), list[Level]()
    for name, (color, dash) in LEVELS.items():
        values = [row.get(references[name]) for row in rows]
        if values and None not in values:
            mean = float(np.mean([float(value) for value in values if value is not None]))
            levels.append(Level(mean, f"{name}: {mean:z.2f}", color, dash))
    return levels


def draw_final(
    path: Path,
    study: StudyRows,
    table: Sequence[Row],
    line: str,
    panels: Mapping[str, tuple[str, str, str]],
    how: Drawing,
    note: str = "",
) -> None:
    """Values of a table with their intervals and single runs, one line per x or variant.

    Args:
        path: of the figure.
        study: with the layout.
        table: the rows.
        line: the column that names a line.
        panels: by label: the scale of the axis, the column of the value, and that of single runs.
        how: see `Drawing`.
        note: text below the figure.
    """
    control = study.layout.control
    groups = list(dict.fromkeys(row.get("group") for row in table))
    several = len(table) > len({row[line] for row in table})
    drawn = {}
    for label, (scale, name, points) in panels.items():
        estimates = []
        for place, row in enumerate(table):
            color = COLORS[place % len(COLORS)] if control is not None else PALETTE[
                groups.index(row.get("group")) % len(PALETTE)
            ]  # fmt: skip
            own = control is not None and row[line] == control
            value, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
            if own and not points:
                value = low = high = NAN
            group, runs = row.get("group") if several else None, row.get(points, ())
            shade = GREY if own else color
            estimates.append(PlottedEstimate(str(row[line]), value, low, high, runs, shade, group))
        drawn[label] = (scale, estimates)
    words = str(study.x).replace("_", " ") if control is None else ""
    draw_intervals(path, drawn, study.layout.title, words, how.also, note)


# -- ablations -------------------------------------------------------------------------------------


def draw_stages(folder: Path, study: StudyRows, how: Drawing) -> list[str]:
    """For each task a figure of all variants beside the control; returns the file names."""
    names = []
    for task in dict.fromkeys(str(row["_x"]) for row in study.rows):
        name = re.sub(r"[^A-Za-z0-9_.+-]+", "_", f"variants{'-' + task if task else ''}.png")
        title = study.layout.title + (f" ({task})" if task else "")
        grid, note = variant_panels(study, task, how), LINES + how.below
        draw_panels(folder / name, grid, how.unit, title, True, how.log, note, how.also)
        names.append(name)
    return names


def variant_panels(study: StudyRows, task: str, how: Drawing) -> list[list[Panel]]:
    """Two panels per variant: the gaps, with the control in grey, and the stage of the curriculum.

    A dotted line marks the start of the last stage of a run.
    """
    variants: Mapping[str, list[Row]] = {
        name: own
        for name, rows in by_variant(study).items()
        if (own := [row for row in rows if str(row["_x"]) == task])
    }
    control = str(study.layout.control)
    names = [name for name in variants if name != control] or [control]
    places = list(variants)

    def gaps(row: Row) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        factor = -100.0 if longer_is_better(row) else 100.0
        return curve_of(study, row, "optimality_gap", factor, how.unit)

    grid: list[list[Panel]] = []
    for first in range(0, len(names), COLUMNS):
        upper: list[Panel] = []
        lower: list[Panel] = []
        for name in names[first : first + COLUMNS]:
            color = COLORS[places.index(name) % len(COLORS)]
            series = [
                Series(
                    [curve for curve in map(gaps, variants.get(variant, [])) if len(curve[0])],
                    variant if variant == control else None, shade,
                    interval=lambda values: distance_interval([values]),
                )
                for variant, shade in ((control, GREY), (name, color))
            ]  # fmt: skip
            stages = [curve_of(study, row, "stage", 1.0, how.unit) for row in variants[name]]
            curves = [curve for curve in stages if len(curve[0])]
            settled = [(times, settled_at(values)) for times, values in curves]
            marks = [(times[place - 1], color) for times, place in settled if place > 0]
            labels = ("", "") if upper else ("gap to the optimum (%)", "trained on")
            missing = "" if any(each.curves for each in series) else ELSEWHERE
            scale = how.y or "gap"
            upper.append(Panel(series, labels[0], name, scale, marks=marks, note=missing))
            lines = [Series([curve], None, color, width=1.0) for curve in curves]
            why = "the task itself" if name == control else "levels instead of stages"
            note = "" if lines else why
            lower.append(Panel(lines, labels[1], marks=marks, note=note, height=1.5))
        grid += [upper, lower]
    return grid


def settled_at(stage: NDArray[np.float64]) -> int:
    """The first evaluation of the last stage, of [evaluations] stages."""
    other = np.flatnonzero(~np.isclose(stage, stage[-1]))
    return int(other[-1]) + 1 if len(other) else 0
