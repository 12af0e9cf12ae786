"""Scores as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from train.evaluation.departures import RATES
from train.evaluation.hidden_contest import Certificate
from train.evaluation.scores import BY_STEPS, FULL_VIEW, Measure, Score, optimality_gap
from train.reports.tables import Column, ResultTable, Row, numeric, words


def score_table(
    scores: Sequence[Score],
    certificate: Certificate | None = None,
    measure: Measure = BY_STEPS,
    beside: str = "",
    success: str = "success",
) -> ResultTable:
    """Scores with the gap to the optimum, or to its proven interval.

    A measure other than steps is the first column, followed by the difference to the optimum if
    that is known, and by its interval. Names end with `beside`, the teammates; `success` heads the
    success rates. What is not exact in the row of an exact optimum is said beside the interval.
    """
    by_steps = measure.by_steps
    optimum = next((score for score in scores if score.name == "optimal"), None)
    names = (measure.optimum, measure.optimum + FULL_VIEW)
    best = next((score for score in scores if score.name in names), None)
    rows: list[Row] = []
    for score in scores:
        half = score.ci95 if by_steps else score.value_ci95
        certain = score.exact or (half == 0.0 and score.apart)
        interval = "exact" if certain else "" if half is None else f"± {half:.3f}"
        row: Row = asdict(score) | {"interval": ", ".join(filter(None, (interval, score.apart)))}
        row["value"] = measure.of(score)
        if score is not best:
            row["missing"] = measure.distance(score, best)
        if score is not optimum:
            row["gap"] = optimality_gap(score, optimum)
        elif not by_steps:
            row["name"] = "optimal steps"
        if certificate is not None and score.discounted_steps is not None:
            row["certified_gap"] = certificate.gap(score.discounted_steps)
        row["name"] += beside
        if score.success_rate == 1.0:
            row["solved_gap"] = None
        rows.append(row)
    columns = [words("", "name")]
    if not by_steps:
        columns.append(numeric(measure.unit, "value", "z.3f"))
        if best is not None:
            side = "above" if measure.less_is_better else "below"
            columns.append(numeric(f"{side} the best", "missing", "z.3f"))
    steps = numeric("steps", "mean_steps", ".3f")
    half_widths = Column("95 % interval", lambda row: str(row["interval"]))
    columns += [steps, half_widths] if by_steps else [half_widths, steps]
    columns.append(numeric(success, "success_rate", ".1f", 100, " %"))
    if any(score.rates for score in scores):
        columns += [numeric(f"{name[:-5]}s", name, ".1f", 100, " %") for name in RATES]
    if by_steps:
        columns.append(numeric("gap to optimum", "gap", "+.2f", 100, " %"))
    if any(row["solved_gap"] is not None for row in rows):
        columns.append(numeric("of the solved", "solved_gap", "+.2f", 100, " %"))
    if certificate is not None:
        columns.append(numeric("discounted", "discounted_steps", ".3f"))
        columns.append(numeric(certificate.head, "certified_gap", "+.2f", 100, " %"))
    return ResultTable(rows, columns)
