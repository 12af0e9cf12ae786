"""Learning curves of the runs of an ablation, by variant, as gaps to the exact optimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from train.experiments.forms import HINTS
from train.experiments.tables import FinishedStudy, longer_is_better
from train.reports.figures import time_scale
from train.reports.tables import Row
from train.settings.checks import check

NAN = float("nan")


@dataclass(frozen=True)
class Curve:
    """The curve of one run, always evaluated at the final difficulty.

    Attributes:
        seconds, frames: [evaluations] of training.
        shortfall: [evaluations] per cent by which the policy is worse than the exact optimum: more
            steps, or fewer for an evader.
        optimality: [evaluations] in [0, 1]: optimum / steps, or for an evader steps / optimum.
        stage: [evaluations] mean training stage since the previous evaluation; NaN without a
            curriculum.
        final: `shortfall` in the final evaluation.
        seed, task: of the run.
        on_hardest: [evaluations] share of frames in the hardest stage, of episodes that ended since
            the previous evaluation; NaN without a curriculum.
    """

    seconds: NDArray[np.float64]
    frames: NDArray[np.float64]
    shortfall: NDArray[np.float64]
    optimality: NDArray[np.float64]
    stage: NDArray[np.float64]
    on_hardest: NDArray[np.float64]
    final: float
    seed: int
    task: str

    @property
    def settled_at(self) -> int:
        """The first evaluation of the last stage; -1 without a curriculum."""
        last = self.stage[-1]
        if np.isnan(last):
            return -1
        other = np.flatnonzero(~np.isclose(self.stage, last))
        return int(other[-1]) + 1 if len(other) else 0

    @property
    def settled(self) -> float:
        """Share of the frames spent on the hardest stage; NaN without a curriculum."""
        spent, known = np.diff(self.frames, prepend=0.0), np.isfinite(self.on_hardest)
        if not known.any():
            return NAN
        return float(np.average(self.on_hardest[known], weights=spent[known]))

    def time(self, unit: str) -> NDArray[np.float64]:
        """[evaluations] values for an axis: frames in millions, or seconds."""
        return time_scale(unit) * (self.frames if unit == "frames" else self.seconds)


VariantCurves = dict[str, list[Curve]]


def curve_of(row: Row, evaluations: list[Row], x: str | None) -> Curve:
    """The curve of a complete run; ValueError if the optimum of its task is not known."""
    check(
        row["objective"] == "mean_steps",
        f"{row['run']}: scored by {row['objective']}, but an ablation needs the gap in steps; use "
        "a single runner, or a chase",
    )
    check(
        row.get("optimality_gap") is not None,
        f"{row['run']}: the exact optimum of its task is not known, but an ablation needs it; use "
        "a single runner, or one chaser against one evader",
    )
    evader = longer_is_better(row)
    sign = -1.0 if evader else 1.0

    def column(name: str) -> NDArray[np.float64]:
        return np.array([e.get(name) for e in evaluations], dtype=np.float64)  # None becomes NaN

    gap = column("optimality_gap")
    return Curve(
        column("seconds"),
        column("frames"),
        100.0 * sign * gap,
        1.0 + gap if evader else 1.0 / (1.0 + gap),
        column("stage"),
        column("on_hardest"),
        100.0 * sign * float(row["optimality_gap"]),
        int(row["seed"]),
        str(row[x] if x else ""),
    )


def curves_by_variant(study: FinishedStudy) -> VariantCurves:
    """The curves of every variant with complete runs, in the order of the file."""
    hints = study.hints
    check(hints.x == study.x, f"{HINTS}: from another ablation; run `pursuit ablate` again")
    variants: VariantCurves = {name: [] for name in hints.variants}
    for row in study.rows:
        curve = curve_of(row, study.by_run[row["run"]], hints.x)
        variants.setdefault(row["variant"], []).append(curve)
    return {name: curves for name, curves in variants.items() if curves}


def strata(curves: Sequence[Curve], tasks: set[str] | None = None) -> list[list[Curve]]:
    """The curves of each task, sorted by task; by default of all tasks of the curves."""
    tasks = {curve.task for curve in curves} if tasks is None else tasks
    return [[curve for curve in curves if curve.task == task] for task in sorted(tasks)]
