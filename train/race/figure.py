"""The figure of a race: the gap over seconds, a panel a task, a colour a contestant."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from train.figures import PALETTE, PLAIN, Look, plain_numbers, pyplot, save, tidy, time_axis
from train.race.contestants import CONTESTANTS
from train.race.plan import LEAST_GAP, Race
from train.race.run import Standing

LEVELS = (0.05, 0.02, 0.01)
HIGHEST = 3.0
"""Gaps above are drawn there: policies that solve nothing yet."""


def draw(race: Race, standing: Standing, path: Path, look: Look = PLAIN) -> None:
    """Draw all runs: the greedy policy above, the sampled one below; seeds are thin lines, their
    median over the common part is a thick one.

    Args:
        race, standing: what was done, and how it went.
        path: of the figure.
        look: formats, the unit of time and the scale of its axis; seconds if left out.
    """
    unit = look.x or "seconds"
    columns = len(race.tasks)
    figure, axes = pyplot().subplots(
        2, columns, figsize=(0.8 + 4.6 * columns, 6.6), squeeze=False, sharex="col"
    )
    scale = 1e-6 if unit == "frames" else 1.0
    for column, on in enumerate(race.tasks):
        for axis, way in zip(axes[:, column], ("greedy", "sampled"), strict=True):
            for level in LEVELS:
                axis.axhline(100 * level, color="#999999", lw=0.8, ls=":")
            for name, colour in zip(race.contestants, PALETTE, strict=False):
                curves = []
                for seed in race.seeds:
                    result = standing.finals[on.name, name, seed]
                    if result is None:
                        continue
                    x = np.array([point[unit] for point in result.points]) * scale
                    y = np.array([point[way] for point in result.points])
                    y = 100 * y.clip(LEAST_GAP / 2, HIGHEST)
                    curves.append((x, y))
                    axis.plot(x, y, color=colour, lw=0.7, alpha=0.55)
                title = CONTESTANTS[name].title
                axis.plot(*median_curve(curves), color=colour, lw=2.2, label=title)
            axis.set_yscale("log")
            plain_numbers(axis.yaxis)
            tidy(axis)
            time_axis(axis, True)
            axis.set_title(on.name if way == "greedy" else "", fontsize=10)
        axes[1, column].set_xlabel("frames (millions, log)" if scale < 1 else "seconds (log)")
    for axis, way in zip(axes[:, 0], ("greedy", "sampled"), strict=True):
        axis.set_ylabel(f"gap to the optimum (%, log), {way}")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=2 * axes.shape[1], frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.94))
    save(figure, path, formats=look.formats)


def median_curve(
    curves: list[tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """The median of curves, between the last of their beginnings and the first of their ends."""
    if not curves:
        return np.zeros(0), np.zeros(0)
    low, high = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
    places = np.geomspace(low, high, 60) if 0 < low < high else np.array([low])
    return places, np.median([np.interp(places, x, y) for x, y in curves], axis=0)
