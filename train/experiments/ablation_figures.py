"""The figures of an ablation: what every arm ends with, and how it gets there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train.figures import (
    GREY,
    KINK,
    PALETTE,
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

ARM_COLORS = tuple(color for color in PALETTE if color != GREY)


@dataclass(frozen=True)
class Curve:
    """One run, evaluated at the final difficulty throughout.

    Attributes:
        seconds, frames: [evaluations] of training.
        shortfall: [evaluations] per cent by which it is worse than the exact optimum: more steps,
            or for an evader fewer.
        optimality: [evaluations] in [0, 1]: optimum / steps, or for an evader steps / optimum.
        lesson: [evaluations] mean of what was trained on since the evaluation before; NaN without a
            curriculum.
        final: per cent short of the optimum in the final evaluation.
        greedy, sampled: the same of the policy that takes the most probable action, and of the one
            that draws; NaN where an algorithm has no such policy.
        seed, task: whose.
        on_hardest: [evaluations] of the frames of the episodes that ended since the evaluation
            before, the share in the hardest lesson; None where that was not kept, or there is none.
    """

    seconds: NDArray[np.float64]
    frames: NDArray[np.float64]
    shortfall: NDArray[np.float64]
    optimality: NDArray[np.float64]
    lesson: NDArray[np.float64]
    final: float
    greedy: float
    sampled: float
    seed: int
    task: str
    on_hardest: NDArray[np.float64] | None = None

    @property
    def settled_at(self) -> int:
        """Which evaluation was the first on whose lesson training stayed; -1 without lessons."""
        last = self.lesson[-1]
        if np.isnan(last):
            return -1
        other = np.flatnonzero(~np.isclose(self.lesson, last))
        return int(other[-1]) + 1 if len(other) else 0

    @property
    def settled(self) -> float:
        """The share of the frames that were spent on the hardest lesson, or, where that is not
        known, on the last one; NaN without lessons."""
        if self.on_hardest is not None:
            spent, told = np.diff(self.frames, prepend=0.0), np.isfinite(self.on_hardest)
            return float(np.average(self.on_hardest[told], weights=spent[told]))
        at = self.settled_at
        if at < 0:
            return float("nan")
        began = self.frames[at - 1] if at else 0.0  # a lesson is told after it was trained on
        return float(1.0 - began / self.frames[-1])

    def time(self, unit: str) -> NDArray[np.float64]:
        """[evaluations]: frames in millions, or seconds, as axes have them."""
        return time_scale(unit) * (self.frames if unit == "frames" else self.seconds)


def draw_final(
    path: Path, table: list[dict[str, Any]], control: str, title: str, look: Look = PLAIN
) -> None:
    """Final gaps and probabilities of improvement with their intervals, one line an arm."""
    figure, (left, right) = pyplot().subplots(
        1, 2, figsize=(9.5, 1.3 + 0.42 * len(table)), sharey=True, layout="constrained"
    )
    for place, row in enumerate(table):
        own = row["arm"] == control
        color = GREY if own else ARM_COLORS[place % len(ARM_COLORS)]
        for axis, name in ((left, "gap"), (right, "improvement")):
            value, low, high = (row[name + end] for end in ("", "_low", "_high"))
            if np.isnan(value) or (own and axis is right):
                continue
            if not np.isnan(low):
                axis.plot([low, high], [place, place], color=color, lw=5, alpha=0.35)
            axis.plot(value, place, "o", color=color, ms=6)
        left.plot([row["best"], row["worst"]], [place, place], "|", color=color, ms=9)
    left.set_yticks(range(len(table)), [row["arm"] for row in table])
    left.set_ylim(len(table) - 0.5, -0.5)
    left.set_xscale("symlog", linthresh=KINK)
    short_numbers(left.xaxis)
    ends = [row[name] for row in table for name in ("best", "worst")]
    left.set_xlim(1.4 * min(*ends, 0.0) - KINK / 10, 1.6 * max(ends) + 0.2)
    left.axvline(0, color="#333333", lw=1.0, ls=":")
    left.set_xlabel("final gap to the optimum (%)")
    right.set_xlim(-0.03, 1.03)
    right.axvline(0.5, color="#333333", lw=1.0, ls=":")
    right.set_xlabel(f"P(better than {control})")
    for axis in (left, right):
        tidy(axis)
    figure.suptitle(title, fontsize=11)
    save(figure, path, formats=look.formats)


def draw_arms(
    path: Path, arms: dict[str, list[Curve]], control: str, title: str, look: Look = PLAIN
) -> None:
    """A panel for each arm: the control in grey, all seeds faint, what was trained on below.

    A dotted line stands where a run's last lesson began.
    """
    unit = look.x or "seconds"
    names = [name for name in arms if name != control] or [control]
    columns = min(len(names), 4)
    lines = -(-len(names) // columns)
    figure, grid = pyplot().subplots(
        2 * lines,
        columns,
        figsize=(max(3.3 * columns + 0.6, 7.5), 3.5 * lines + 0.5),
        squeeze=False,
        sharex=True,
        height_ratios=(3, 1) * lines,
        layout="constrained",
    )
    everything = [curve for curves in arms.values() for curve in curves]
    top = max(float(np.nanmax(curve.shortfall)) for curve in everything)
    bottom = min(0.0, *(float(np.nanmin(curve.shortfall)) for curve in everything))
    for number, name in enumerate(names):
        upper = grid[2 * (number // columns), number % columns]
        lower = grid[2 * (number // columns) + 1, number % columns]
        color = ARM_COLORS[list(arms).index(name) % len(ARM_COLORS)]
        for arm, shade, order in ((control, GREY, 1), (name, color, 2)):
            for curve in arms.get(arm, []):
                upper.plot(
                    curve.time(unit), curve.shortfall, color=shade, lw=0.8, alpha=0.4, zorder=order
                )
            places, middle = _middle(arms.get(arm, []), unit)
            if len(places):
                upper.plot(places, middle, color=shade, lw=1.9, zorder=order + 2, label=arm)
        upper.set_yscale("symlog", linthresh=KINK)
        upper.set_ylim(1.3 * bottom, 1.6 * top + 0.2)
        short_numbers(upper.yaxis)
        upper.axhline(0, color="#333333", lw=1.0, ls=":")
        upper.set_title(name, fontsize=10)
        for curve in arms[name]:
            lower.plot(curve.time(unit), curve.lesson, color=color, lw=1.0, alpha=0.6)
            if curve.settled_at > 0:
                began = curve.time(unit)[curve.settled_at - 1]
                for axis in (upper, lower):
                    axis.axvline(began, color=color, lw=0.8, ls=":", alpha=0.6)
        if all(np.isnan(curve.lesson).all() for curve in arms[name]):
            said = "as the task" if name == control else "levels, chosen one by one"
            lower.text(0.5, 0.5, said, transform=lower.transAxes, ha="center", va="center")
            lower.set_yticks([])
        for axis in (upper, lower):
            time_axis(axis, look.log)
            tidy(axis)
    for number in range(len(names), lines * columns):
        for half in (0, 1):
            grid[2 * (number // columns) + half, number % columns].set_visible(False)
    for line in range(lines):
        grid[2 * line, 0].set_ylabel("gap to the optimum (%)")
        grid[2 * line + 1, 0].set_ylabel("trained on")
    figure.supxlabel(time_head(unit), fontsize=10)
    figure.suptitle(f"{title}; grey: {control}", fontsize=11)
    save(figure, path, formats=look.formats)


def _middle(curves: list[Curve], unit: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The mean of the curves, where all of them are."""
    if not curves:
        return np.zeros(0), np.zeros(0)
    times = [curve.time(unit) for curve in curves]
    start, end = max(time[0] for time in times), min(time[-1] for time in times)
    places = np.linspace(start, max(start, end), 80)
    values = [
        np.interp(places, time, curve.shortfall) for time, curve in zip(times, curves, strict=True)
    ]
    return places, np.mean(values, axis=0)
