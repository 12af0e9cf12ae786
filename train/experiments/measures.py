"""What runs are measured by, and the sentences that reports have in common."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

from train.evaluation.scores import Measure
from train.experiments.rows import StudyRows
from train.experiments.statistics import Interval, distance_interval, mean_interval
from train.reports.tables import Row

REFERENCE_COLUMNS = {
    "random": "random_steps",
    "scripted": "scripted_steps",
    "optimal": "optimal_steps",
    "learned": "mean_steps",
    "chaser vs A*": "chaser_vs_astar",
    "evader vs A*": "evader_vs_astar",
}
"""Those of measures in steps, and of self-play: steps."""
NOTES = tomllib.loads(Path(__file__).with_name("notes.toml").read_text(encoding="utf-8"))
GAP, REGRET = Measure("optimality_gap", "%"), Measure("return_regret", "return")


def measure_of_rows(rows: list[Row]) -> Measure:
    """The gap if the optimum of every run is known, otherwise steps; the objective for self-play;
    for single players of small games the return that a best response has more.

    Args:
        rows: complete runs of one kind. If only some games of self-play are exact, the measure is
            steps.
    """
    objectives = {(row["objective"], row["unit"]) for row in rows}
    column, unit = objectives.pop() if len(objectives) == 1 else ("steps", "steps")
    if column == "mean_steps" and all(row.get("optimality_gap") is not None for row in rows):
        return GAP
    regrets = [row.get("return_regret") for row in rows]
    if column == "mean_return" and None not in regrets and all(row.get("game") for row in rows):
        return REGRET
    return Measure(column, unit)


def interval_of(measure: Measure, values: Sequence[float]) -> Interval:
    """The 95 % interval of the mean over runs."""
    return mean_interval([values]) if measure.is_signed else distance_interval([values])


def references_of(measure: Measure) -> dict[str, str]:
    """Further columns of tables, if the runs have them, by their heads: means over seeds of the
    same quantity."""
    if measure == REGRET:
        return {"return": "mean_return"}
    if measure.name not in ("goals", "return", "outcome"):
        return REFERENCE_COLUMNS
    found = {each: f"{each}_{measure.name}" for each in ("random", "scripted", "optimal")}
    return {**found, "behind the optimum": f"{measure.name}_regret"}


def size_of(value: object) -> tuple[float, str]:
    """A sort key that orders 3x3 before 10x10, and numbers by value."""
    text = str(value)
    digits = "".join(c if c.isdigit() or c == "." else " " for c in text).split()
    return (float(digits[0]) if digits else 0.0, text)


def evaluated_policies(rows: list[Row]) -> str:
    """The evaluated policies, greedy or sampled."""
    return " or ".join(sorted({row["evaluate"] for row in rows if row.get("evaluate")}))


def note(place: str, **values: object) -> str:
    """An explanation of `notes.toml`, by "section.name", with its values."""
    section, _, key = place.partition(".")
    text: str = NOTES[section][key]
    return text.strip().format(**values)


def budget_note(study: StudyRows) -> str:
    """The budgets of the runs."""
    budgets = {(row["budget_seconds"], row["budget_frames"]) for row in study.rows}
    texts = (f"{s:g} s" if s is not None else f"{f:,} frames" for s, f in budgets)
    return f"Budget per run: {'; '.join(texts)}."
