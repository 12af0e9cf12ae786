"""The learning curve and the replay of a run."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from train.evaluation.scores import BY_STEPS, Measure
from train.files import Plain
from train.reports.curves import Level, Panel, Series, draw_panels
from train.reports.figures import BLACK, GREEN, GREY, ORANGE, PINK, SKY, YELLOW, time_scale

COLORS = {"optimal": GREEN, "random": GREY}
OTHERS = ((ORANGE, "--"), (YELLOW, "-."), (BLACK, ":"), (SKY, "--"), (PINK, "-."))
"""Colour and line style of the other references, in their order."""


def draw_learning_curve(
    path: Path,
    rows: list[dict[str, float]],
    scores: list[Plain],
    title: str,
    stages: list[Plain] | None = None,
    taught: str = "",
    measure: Measure = BY_STEPS,
    unit: str = "frames",
) -> None:
    """The objective over training time with references as lines; gap and curriculum below.

    Args:
        path: of the figure, written atomically.
        rows: of `metrics.csv`.
        scores: of `results.json`.
        title: of the figure.
        stages: rows of `curriculum.csv`; None without a curriculum.
        taught: the label of their values.
        measure: the objective of the run.
        unit: of the axis: that of the budget, frames or seconds.
    """
    times = np.array([row[unit] for row in rows]) * time_scale(unit)
    levels, others = [], itertools.cycle(OTHERS)
    for score in scores:
        name, value = score["name"], score.get(measure.column)
        if not name.startswith("learned") and value is not None:
            color, dash = (COLORS[name], "--") if name in COLORS else next(others)
            levels.append(Level(value, f"{name}: {value:z.2f}", color, dash))
    measured = Series([(times, np.array([row[measure.column] for row in rows]))], "learned")
    label = f"mean {measure.unit}" + ("\n(log)" if measure.scale == "log" else "")
    panels = [Panel([measured], label, scale=measure.scale, levels=levels)]
    optimum = any(score["name"] == "optimal" for score in scores)
    if measure.by_steps and optimum and any("optimality_gap" in row for row in rows):
        gap = 100 * np.array([row.get("optimality_gap", np.nan) for row in rows])
        panels.append(Panel([Series([(times, gap)])], "gap to the\noptimum (%)", scale="gap"))
    if stages:
        panels.append(curriculum_panel(stages, float(times[-1]), taught, unit))
    draw_panels(path, [[panel] for panel in panels], unit, title)


def curriculum_panel(stages: list[Plain], end: float, taught: str, unit: str) -> Panel:
    """The values of the curriculum as steps: the mean, and the range if there is one; up to `end`
    on an axis of `unit`."""
    places = np.array([*(row[unit] * time_scale(unit) for row in stages), end])
    values = {name: np.repeat([row[name] for row in stages], 2) for name in ("mean", "low", "high")}
    ranged = bool((values["high"] > values["low"]).any())
    series = [
        Series([(np.repeat(places, 2)[1:-1], values[name])], text, color=PINK, style=style)
        for name, style, text in (
            ("mean", "-", "mean" if ranged else None),
            ("low", ":", "least and largest"),
            ("high", ":", None),
        )[: 3 if ranged else 1]
    ]
    label = taught.replace("-", "\n", 1).replace("-", " ")
    return Panel(series, label, height=2.0)
