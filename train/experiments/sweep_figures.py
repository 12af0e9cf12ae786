"""The figures of a sweep: learning curves, and what a run ends with against what varies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from train.experiments.measures import GAP, STEPS, Measure, measure_of, size_of
from train.figures import (
    KINK,
    PLAIN,
    Look,
    pyplot,
    save,
    short_numbers,
    tidy,
    time_axis,
    time_head,
    time_scale,
)

GRID = 60
"""Points of a curve."""

BAND_FROM = 10
"""So many runs are drawn as a band: fewer are drawn one by one."""


def on_one_axis(
    curves: list[tuple[NDArray[Any], NDArray[Any]]], log: bool = False
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Curves over a common axis: its points, and [curves, points] values.

    The axis ends where the first curve ends; between evaluations a curve is a straight line. The
    points lie evenly on the axis, which is logarithmic if `log`; that has no place for 0.
    """
    if log:
        kept = [(points > 0, points, values) for points, values in curves]
        curves = [(points[above], values[above]) for above, points, values in kept if above.any()]
    start = max(float(points[0]) for points, _ in curves)
    end = min(float(points[-1]) for points, _ in curves)
    points = (np.geomspace if log else np.linspace)(start, max(end, start), GRID)
    return points, np.stack([np.interp(points, *curve) for curve in curves])


def draw_group(
    axis: Any,
    curves: list[tuple[NDArray[Any], NDArray[Any]]],
    color: str,
    name: str,
    log: bool = False,
    dash: str = "-",
    measure: Measure = STEPS,
) -> NDArray[Any]:
    """The mean of the runs that belong together, and every run, or from `BAND_FROM` runs on a band.

    Returns:
        All values that were drawn.
    """
    points, values = on_one_axis(curves, log)
    axis.plot(points, values.mean(axis=0), dash, color=color, lw=1.7, label=name)
    if len(values) < BAND_FROM:
        axis.plot(points, values.T, dash, color=color, lw=0.7, alpha=0.45)
        return values
    ends = np.array([measure.interval(column) for column in values.T])
    axis.fill_between(points, ends[:, 0], ends[:, 1], color=color, alpha=0.18, lw=0)
    return ends


def draw_curves(
    path: Path,
    rows: list[dict[str, Any]],
    by_run: dict[str, list[dict[str, Any]]],
    unit: str,
    x: str | None,
    colors: dict[str, str],
    title: str,
    look: Look = PLAIN,
) -> None:
    """The measure over seconds or frames: a panel for each x, a colour for each group."""
    measure = measure_of(rows)
    panels = sorted({row["_x"] for row in rows}, key=size_of)
    columns = min(len(panels), 4)
    lines = -(-len(panels) // columns)
    figure, axes = pyplot().subplots(
        lines,
        columns,
        figsize=(max(3.4 * columns + 1.2, 7.6), 2.9 * lines + 0.9),
        squeeze=False,
        layout="constrained",
    )
    scale = time_scale(unit)
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        here = [row for row in rows if row["_x"] == panel]
        for name, color in colors.items():
            curves = [
                (
                    np.array([r[unit] for r in by_run[row["run"]]]) * scale,
                    np.array([r[measure.curve] for r in by_run[row["run"]]]),
                )
                for row in here
                if row["_group"] == name and row["run"] in by_run
            ]
            if curves:
                draw_group(axis, curves, color, name, look.log, measure=measure)
        for column, word, style in (
            ("optimal_steps", "optimal", ":"),
            ("scripted_steps", "scripted", "--"),
        ):
            known = [row[column] for row in here if row.get(column) is not None]
            if known and measure.curve == "mean_steps":
                axis.axhline(np.mean(known), color="#333333", lw=1.2, ls=style, label=word)
        if measure.logarithmic:
            axis.set_yscale("log")
            axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            short_numbers(axis.yaxis)
            axis.yaxis.set_minor_formatter(NullFormatter())
        elif measure.curve != "mean_return":
            axis.set_ylim(bottom=0)
        if x:
            axis.set_title(f"{x.replace('_', ' ')} {panel}", fontsize=10)
        time_axis(axis, look.log)
        tidy(axis)
    for axis in axes[:, 0]:
        axis.set_ylabel(measure.curve_axis)
    figure.supxlabel(time_head(unit), fontsize=10)
    figure.suptitle(title, fontsize=11)
    handles: dict[str, Any] = {}
    for axis in axes.flat:
        for handle, word in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(word, handle)
    figure.legend(
        handles.values(), handles.keys(), loc="outside right center", frameon=False, fontsize=9
    )
    save(figure, path, formats=look.formats)


def draw_final(
    path: Path,
    rows: list[dict[str, Any]],
    x: str,
    colors: dict[str, str],
    title: str,
    look: Look = PLAIN,
) -> None:
    """The final measure against x, with intervals."""
    measure = measure_of(rows)
    gap, column, scale = measure is GAP, measure.final, measure.scale
    values = sorted({row["_x"] for row in rows}, key=size_of)
    figure, axis = pyplot().subplots(figsize=(6.4, 4), layout="constrained")
    side_by_side = len({(row["_x"], row["_group"]) for row in rows}) > len(values)
    for number, (name, color) in enumerate(colors.items()):
        shift = 0.09 * (number - (len(colors) - 1) / 2) * side_by_side
        places, means, lows, highs = [], [], [], []
        for place, value in enumerate(values):
            final = [
                scale * row[column] for row in rows if (row["_x"], row["_group"]) == (value, name)
            ]
            if final:
                low, high = measure.interval(final)
                places.append(place + shift)
                means.append(float(np.mean(final)))
                lows.append(means[-1] - (means[-1] if np.isnan(low) else low))
                highs.append((means[-1] if np.isnan(high) else high) - means[-1])
                axis.plot([place + shift] * len(final), final, ".", color=color, alpha=0.35, ms=6)
        axis.errorbar(
            places,
            means,
            (lows, highs),
            color=color,
            fmt="o",
            ms=4.5,
            capsize=3,
            label=name,
        )
    axis.set_xticks(range(len(values)), [str(value) for value in values])
    axis.set_xlabel(x.replace("_", " "))
    axis.set_ylabel(measure.axis)
    if gap:
        axis.set_yscale("symlog", linthresh=KINK)
        axis.axhline(0, color="#333333", lw=1.2, ls=":")
        short_numbers(axis.yaxis)
        finals = [100.0 * row["optimality_gap"] for row in rows]
        # An interval that reaches below 0 does so for its form: nobody beats the optimum.
        lowest = 1.6 * min(finals) - 0.2 if min(finals) < 0.0 else 0.0
        axis.set_ylim(lowest, 1.6 * max(*finals, 0.0) + 0.2)
    axis.set_title(title, fontsize=11, loc="left")
    if side_by_side:
        beside = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
        axis.legend(frameon=False, fontsize=9, **beside)
    tidy(axis)
    save(figure, path, formats=look.formats)
