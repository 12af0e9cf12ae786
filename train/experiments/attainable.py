"""Whether comparisons can be decided, known from the number of runs alone."""

from __future__ import annotations

from train.experiments.statistics import LEVEL, least_p, least_sign_flip_p
from train.experiments.study import Study
from train.runs.folder import SELF_PLAY

MOST_RUNS = 100


def out_of_reach(study: Study) -> list[str]:
    """A line for the variants of an ablation whose corrected p cannot be below LEVEL; [] if none.

    Holm's correction multiplies the smallest of m values by m.
    """
    control, primary = study.report["control"], study.report.get("primary")
    tasks = len({run.label.get(study.report["x"]) for run in study.runs})
    by_maze = study.runs[0].kind == SELF_PLAY and tasks > 1
    corrected = [v for v in study.report["variants"] if v not in (control, primary)]
    unit, now = ("mazes", tasks) if by_maze else ("seeds", len({run.seed for run in study.runs}))

    def least(count: int) -> float:
        return least_sign_flip_p(count) if by_maze else least_p([(count, count)] * tasks)

    lines = []
    for names in (corrected, [primary] if primary is not None else []):
        p, counts = least(now) * len(names), range(now, MOST_RUNS)
        if names and p >= LEVEL:
            enough = next((n for n in counts if least(n) * len(names) < LEVEL), None)
            remedy = f"{enough} {unit} or more" if enough else "fewer variants"
            lines.append(
                f"{', '.join(names)}: p < {LEVEL:g} cannot be reached: with {now} {unit} the least "
                f"p is {least(now):.2g}, corrected for {len(names)} comparisons "
                f"{min(p, 1.0):.2g}; give {remedy}"
            )
    return lines


def comparison_out_of_reach(seeds: int) -> list[str]:
    """The same for the uncorrected comparisons of two libraries with so many seeds each."""
    least = least_p([(seeds, seeds)])
    if least < LEVEL:
        return []
    return [f"p < {LEVEL:g} cannot be reached: with {seeds} seeds the least p is {least:.2g}"]
