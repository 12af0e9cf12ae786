"""Figures of curves over training time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pursuit.rules.arrays import Array
from train.files import Plain
from train.reports.figures import (
    BLUE,
    gap_axis,
    in_legend,
    legend_beside,
    log_axis,
    pyplot,
    save,
    tidy,
)

if TYPE_CHECKING:  # slow to import
    from matplotlib.axes import Axes

Curve = tuple[Array, Array]
"""Points on the axis, and values."""

LineStyle = str | tuple[int, tuple[int, ...]]
"""As Matplotlib takes it: a name, or an offset and the lengths of strokes and gaps."""

SINGLE_RUNS = "Thick: mean of the runs; thin: single runs, or a band, their interval"
"""What the lines of several runs are, for `draw_panels`."""

GRID = 60
"""Number of points of a mean curve."""

BAND_FROM = 10
"""Least number of runs that are drawn as a band; fewer are drawn as lines."""

END_SIZE = 8.5
"""Points of the texts at the ends of lines."""

CHARACTERS = 12
"""Per inch of width, in lines of titles and notes."""


class Level(NamedTuple):
    """A horizontal line in a panel, such as a reference."""

    value: float
    label: str | None = None
    color: str = "#333333"
    style: LineStyle = ":"


@dataclass(frozen=True)
class Series:
    """Curves of runs that differ only in their seeds, drawn in one colour.

    Attributes:
        curves: of the runs.
        label: in the legend; None for none.
        color, style, width: of the line.
        interval: computes the band of many runs from values; None for thin lines.
    """

    curves: Sequence[Curve]
    label: str | None = None
    color: str = BLUE
    style: LineStyle = "-"
    width: float = 1.7
    interval: Callable[[Sequence[float]], tuple[float, float]] | None = None


@dataclass(frozen=True)
class Panel:
    """One pair of axes with curves over training time.

    Attributes:
        series: the curves.
        ylabel, title: texts.
        scale: "linear"; "from 0"; "log"; or "gap", in per cent: linear near 0, where the optimum
            is, and logarithmic beyond.
        levels: horizontal lines.
        marks: vertical lines, as (position, colour).
        note: text in the middle of an empty panel.
        height: relative to other panels in the same column.
    """

    series: Sequence[Series] = ()
    ylabel: str = ""
    title: str = ""
    scale: str = "linear"
    levels: Sequence[Level] = ()
    marks: Sequence[tuple[float, str]] = ()
    note: str = ""
    height: float = 3.0


def on_one_axis(curves: Sequence[Curve], log: bool = False) -> Curve:
    """Curves interpolated linearly on a common axis: its points, and [curves, points] values.

    The axis ends with the shortest curve. Its points have equal distances, on a logarithmic scale
    without 0 if `log`.
    """
    if log:
        kept = [(points > 0, points, values) for points, values in curves]
        curves = [(points[above], values[above]) for above, points, values in kept if above.any()]
    start = max(float(points[0]) for points, _ in curves)
    end = min(float(points[-1]) for points, _ in curves)
    points = (np.geomspace if log else np.linspace)(start, max(end, start), GRID)
    return points, np.stack([np.interp(points, *curve) for curve in curves])


def draw_panels(
    path: Path,
    grid: Sequence[Sequence[Panel]],
    unit: str,
    title: str = "",
    beside: bool = False,
    log: bool = False,
    note: str = "",
    also: str = "svg",
) -> None:
    """Curves over training time.

    Args:
        path: of the figure.
        grid: the panels by row; the last row may be shorter.
        unit: of the times in the curves: frames (in millions) or seconds.
        title: of the whole figure.
        beside: draw one legend next to all panels, and only values at the ends of lines.
        log: whether the axis of training time is logarithmic.
        note: text below the figure: what its lines are.
        also: as of `save`.
    """
    lines, columns = len(grid), max(map(len, grid))
    heights = [line[0].height for line in grid]
    width = 9.0 if columns == 1 else 3.4 * columns + 1.2
    size = (width, 0.7 + 1.1 * sum(heights))
    shared = "col" if len(grid[-1]) == columns else False
    how: Plain = {"squeeze": False, "height_ratios": heights, "layout": "constrained"}
    figure, axes = pyplot().subplots(lines, columns, figsize=size, sharex=shared, **how)
    gaps = [y for line in grid for panel in line if panel.scale == "gap"
            for series in panel.series for _, y in series.curves]  # fmt: skip
    for line, below in zip(grid, axes, strict=True):
        for place, axis in enumerate(below):
            if place >= len(line):
                axis.set_visible(False)
                continue
            _draw_panel(axis, line[place], log, gaps)
            if ends := [*_ends(line[place], beside)]:
                label_ends(axis, ends, 1.1 * line[place].height)
    for axis in axes[-1]:
        axis.set_xlabel("frames (millions)" if unit == "frames" else "training time (s)")
    # Matplotlib's own wrapping reads formulas.
    figure.suptitle(fill(title, int(CHARACTERS * width)), fontsize=11)
    figure.supxlabel(fill(note, int(CHARACTERS * width)), fontsize=8)
    if beside:
        legend_beside(figure, axes.flat)
    save(figure, path, also)


def label_ends(axis: Axes, ends: Sequence[tuple[float, str, str]], height: float) -> None:
    """Write texts beside the right end of an axis, each at its value or as near as there is room.

    Args:
        axis: with its final limits.
        ends: the values, texts and colours.
        height: of the axis, in inches.
    """
    values = np.array([value for value, _, _ in ends])
    points = axis.transData.transform(
        np.column_stack([np.full_like(values, axis.get_xlim()[1]), values])
    )
    wanted = np.clip(axis.transAxes.inverted().transform(points)[:, 1], 0.0, 1.0)
    least = 1.25 * END_SIZE / (72.0 * height)
    order = np.argsort(wanted, kind="stable")
    places = wanted[order]
    for above in range(1, len(places)):
        places[above] = max(places[above], places[above - 1] + least)
    most = 1.0
    for below in reversed(range(len(places))):
        places[below] = most = min(places[below], most)
        most -= least
    for place, number in zip(places, order, strict=True):
        _, text, color = ends[number]
        where = {"transform": axis.transAxes, "va": "center", "color": color}
        axis.text(1.01, place, text, fontsize=END_SIZE, **where)


def _draw_panel(axis: Axes, panel: Panel, log: bool, gaps: Sequence[Array]) -> None:
    """Draw one panel; panels of scale "gap" share the limits of all `gaps` in the figure."""
    for series in panel.series:
        _draw_series(axis, series, log)
    for value, label, color, style in panel.levels:
        axis.axhline(value, color=color, lw=1.3, ls=style, label=in_legend(label))
    for place, color in panel.marks:
        axis.axvline(place, color=color, lw=0.8, ls=":", alpha=0.6)
    if panel.note:
        axis.text(0.5, 0.5, panel.note, transform=axis.transAxes, ha="center", va="center")
        axis.set_yticks([])
    elif panel.scale == "gap" and gaps:  # none before the first evaluation
        gap_axis(axis, "y", np.concatenate(gaps))
    elif panel.scale == "log":
        log_axis(axis, "y")
    elif panel.scale == "from 0":
        axis.set_ylim(bottom=min(0.0, -0.03 * axis.get_ylim()[1]))  # so that 0 can be seen
    axis.set_ylabel(panel.ylabel)
    axis.set_title(panel.title, fontsize=10)
    if log:
        log_axis(axis, "x")
    tidy(axis)


def _ends(panel: Panel, bare: bool) -> Iterator[tuple[float, str, str]]:
    """Value, text and colour of what is written at the ends of the lines of a panel: labels with
    last values, or only the values if `bare`."""
    unit = " %" if panel.scale == "gap" else ""
    for series in panel.series:
        known = [values[~np.isnan(values)] for _, values in series.curves]
        last = [values[-1] for values in known if len(values)]
        if last and not panel.note and (series.label is not None or unit):
            value = float(np.mean(last))
            text = f"{value:z.2f}{unit}" if unit else f"{value:.4g}"
            named = series.label is not None and not bare
            yield value, f"{series.label}: {text}" if named else text, series.color
    for level in () if bare else panel.levels:
        if level.label is not None:
            yield level.value, level.label, level.color


def _draw_series(axis: Axes, series: Series, log: bool) -> None:
    """Draw the mean of the runs, and every run, or a band for at least `BAND_FROM` runs."""
    style: Plain = {"ls": series.style, "color": series.color}
    thick = {**style, "lw": series.width, "label": in_legend(series.label)}
    if len(series.curves) == 1:
        few = len(series.curves[0][0]) <= GRID
        axis.plot(*series.curves[0], marker="o" if few else None, ms=3, **thick)
    elif series.curves:
        points, values = on_one_axis(series.curves, log)
        axis.plot(points, np.mean(values, axis=0), **thick)
        if series.interval is None or len(values) < BAND_FROM:
            for curve in series.curves:
                axis.plot(*curve, lw=0.7, alpha=0.45, **style)
        else:
            ends = np.array([series.interval(column) for column in values.T])
            axis.fill_between(points, *ends.T, color=series.color, alpha=0.18, lw=0)
