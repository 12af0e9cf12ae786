"""What a report is about: the gap to the optimum, or whatever else the runs are judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from train.experiments.statistics import Interval, distance_interval, mean_interval


@dataclass(frozen=True)
class Measure:
    """One figure of a run.

    Attributes:
        name: in tables.
        final: its column in the table of runs, to be multiplied by `scale`.
        label: what tables and figures call it.
        curve: the column of `metrics.csv` that is drawn over time, `curve_label` its name, and
            `curve_scale` that of its axis (`Panel.scale`).
    """

    name: str
    final: str
    scale: float
    label: str
    curve: str
    curve_label: str
    curve_scale: str

    def interval(self, values: Sequence[float]) -> Interval:
        """The 95 % interval of the mean over runs; only returns may lie on either side of 0."""
        signed = self.final == "mean_return"
        return mean_interval([values]) if signed else distance_interval([values])


LENGTH = ("mean_steps", "episode length (steps, log)", "log")
GAP = Measure("gap", "optimality_gap", 100.0, "gap to the optimum, %", *LENGTH)
STEPS = Measure("steps", "mean_steps", 1.0, "steps", *LENGTH)


def measure_of(rows: list[dict[str, Any]]) -> Measure:
    """The gap where every run knows its optimum, steps where not; of self-play its own objective.

    Args:
        rows: complete runs of one kind. Where only some games of self-play are exact, all are
            judged by their steps.
    """
    objectives = {(row["objective"], row["unit"]) for row in rows}
    column, unit = objectives.pop() if len(objectives) == 1 else ("steps", "steps")
    if column == "mean_steps":
        known = all(row.get("optimality_gap") is not None for row in rows)
        return GAP if known else STEPS
    name = "NashConv" if column == "nash_conv" else column.replace("_", " ")
    told = name if name.endswith(unit) else f"{name} ({unit})"
    scale = "linear" if column == "mean_return" else "from 0"
    return Measure(column, column, 1.0, told, column, told, scale)


def size_of(value: Any) -> tuple[Any, ...]:
    """Orders 3x3 before 10x10, and numbers as numbers."""
    text = str(value)
    digits = "".join(c if c.isdigit() or c == "." else " " for c in text).split()
    return (float(digits[0]) if digits else 0.0, text)
