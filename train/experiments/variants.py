"""Variants of an ablation against its control, and contestants against each other, from rows.

Single agents are compared by their gap to the optimum, self-play by exact NashConv. Several mazes
are the random units: a variant and the control are paired by maze after the mean over seeds. In one
maze the runs are the units; of other tasks in [grid] they are permuted within each. Small games
take the place of mazes, for single agents with the return that a best response has more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import check
from train.experiments.rows import GAPS, StudyRows
from train.experiments.runs import LAYOUT, Study
from train.experiments.statistics import (
    LEVEL,
    NAN,
    bounded,
    difference_interval,
    distance_interval,
    holm,
    improvement,
    least_p,
    least_sign_flip_p,
    logrank_p,
    mean_interval,
    permutation_p,
    probability_of_improvement,
    sign_flip_p,
)
from train.experiments.study import THRESHOLDS, Layout
from train.reports.tables import Row
from train.runs.folder import SELF_PLAY
from train.settings.task import GAME

MOST_RUNS = 100
TARGETS = (5.0, 2.0, 1.0)
"""Gaps in per cent to which contestants are compared."""
UNITS = ("seconds", "frames")
NEVER = float("inf")
MAZE = "maze"


@dataclass(frozen=True)
class Distance:
    """An exact distance to the equilibrium, or to a best response, by which runs are compared.

    Attributes:
        column: in the table of runs.
        name: in reports.
        scale: its unit.
        unit: what runs are paired by.
        note: what explains it in reports, of `notes.toml`.
        least: smaller values count as this one: ratios to 0 are not defined.
    """

    column: str
    name: str
    scale: str
    unit: str
    note: str
    least: float = 1e-3


NASH_CONV = Distance("played_nash_conv", "NashConv", "discounted steps", MAZE, "values")
GAME_NASH_CONV = Distance("played_nash_conv", "NashConv", "returns", GAME, "values")
GAME_REGRET = Distance("return_regret", "return regret", "returns", GAME, "regret")
MAZE_GAP = Distance("shortfall", "gap to the optimum", "per cent", MAZE, "gap", least=0.1)


def distance_of(study: StudyRows) -> Distance | None:
    """The distance of self-play, of small games, and of single agents in several mazes; None for
    gaps of runs in one maze."""
    rows = study.rows
    games = any(row.get("game") is not None for row in rows)
    if rows[0]["kind"] == SELF_PLAY:
        return GAME_NASH_CONV if games else NASH_CONV
    if games:
        return GAME_REGRET
    return MAZE_GAP if study.x == MAZE and len({row["_x"] for row in rows}) > 1 else None


def by_variant(study: StudyRows) -> dict[str, list[Row]]:
    """The complete runs of every variant that has some, in the order of the file, by seed."""
    layout = study.layout
    check(layout.x == study.x, f"{LAYOUT}: from another ablation; run `pursuit ablate` again")
    found: dict[str, list[Row]] = {name: [] for name in layout.variants}
    for row in sorted(study.rows, key=lambda row: int(row["seed"])):
        found.setdefault(row["variant"], []).append(row)
    return {name: rows for name, rows in found.items() if rows}


def against_control(study: StudyRows) -> list[Row]:
    """A row for each variant: its results, its tests against the control, and the "verdict".

    Raises:
        ValueError: a run whose distance to the optimum or equilibrium is not known.
    """
    layout, variants = study.layout, by_variant(study)
    control = variants.get(str(layout.control), [])
    distance = distance_of(study)
    for row in study.rows if distance in (None, MAZE_GAP) else ():
        check(
            row["objective"] == "mean_steps",
            f"{row['run']}: scored by {row['objective']}, but an ablation needs the gap in steps; "
            "use a single runner, or a chase",
        )
        check(
            row.get("shortfall") is not None,
            f"{row['run']}: the exact optimum of its task is not known, but an ablation needs it; "
            "use a single runner, or one chaser against one evader",
        )
    if distance is not None:
        rows = [paired_row(name, own, control, distance) for name, own in variants.items()]
        add_corrected(rows, layout, {"p_holm": "p"})
        return [row | {"verdict": paired_verdict(row, layout, distance)} for row in rows]
    rows = [gap_row(name, own, control) for name, own in variants.items()]
    add_corrected(rows, layout, {"p_holm": "p", "p_time": f"p_to_{layout.threshold:g}"})
    return [row | {"verdict": gap_verdict(row, layout)} for row in rows]


def add_corrected(rows: list[Row], layout: Layout, names: dict[str, str]) -> None:
    """Add p corrected for the number of variants, except that of the primary one, under new names.

    Args:
        rows: of all variants.
        layout: names the control and the primary variant.
        names: the columns of p by the new ones.
    """
    others = [row for row in rows if row["variant"] not in (layout.control, layout.primary)]
    for name, source in names.items():
        for row in rows:
            row[name] = NAN if row["variant"] == layout.control else row[source]
        for row, p in zip(others, holm([row[source] for row in others]), strict=True):
            row[name] = p


def by_task(rows: Sequence[Row], column: str, tasks: Iterable[str] = ()) -> list[list[float]]:
    """The values of a column for each task, sorted by task; by default of all tasks of the rows."""
    chosen = sorted(set(tasks) or {str(row["_x"]) for row in rows})
    own = [[row[column] for row in rows if str(row["_x"]) == task] for task in chosen]
    return [[NEVER if value is None else value for value in values] for values in own]


# -- gaps ------------------------------------------------------------------------------------------


def gap_row(name: str, own: list[Row], control: list[Row]) -> Row:
    """One variant as a flat row, with gaps in per cent, and `times_row`."""
    finals = by_task(own, "shortfall")
    row: Row = {"variant": name, "runs": len(own)}
    row |= bounded("gap", mean_of(finals), distance_interval(finals))
    row |= {"best": min(map(min, finals)), "worst": max(map(max, finals))}
    row["each_run"] = [value for task in finals for value in task]
    row |= times_row(own, THRESHOLDS)
    areas = by_task(own, "mean_optimality")
    row |= bounded("area", mean_of(areas), distance_interval(areas))
    row |= hardest_row(own)
    better, p, ends, apart = NAN, NAN, (NAN, NAN), (NAN, NAN)
    if {str(r["_x"]) for r in own} == {str(r["_x"]) for r in control}:
        theirs = by_task(control, "shortfall")
        better, ends = probability_of_improvement(finals, theirs)
        p = permutation_p(finals, theirs)
        apart = difference_interval(finals, theirs, 1.0 - 2.0 * LEVEL)
    row |= bounded("improvement", better, ends)
    row |= {"p": p, "apart_low": apart[0], "apart_high": apart[1]}
    tasks = {str(r["_x"]) for r in [*own, *control]}
    ended = by_task(own, "frames", tasks), by_task(control, "frames", tasks)
    for gap in THRESHOLDS:
        first, other = (by_task(r, f"frames_to_{gap:g}", tasks) for r in (own, control))
        row[f"p_to_{gap:g}"] = logrank_p(first, other, ended)
    return row


def hardest_row(rows: Sequence[Row]) -> Row:
    """The mean share of frames in the hardest stage of a curriculum, "hardest_share", NaN without
    one; "never_hardest": in how many runs it is 0."""
    shares = [row.get("hardest_share") for row in rows]
    known = [share for share in shares if share is not None]
    mean = float(np.mean(known)) if known and len(known) == len(shares) else NAN
    return {"hardest_share": mean, "never_hardest": known.count(0.0)}


def mean_of(tasks: Sequence[Sequence[float]]) -> float:
    """The mean over tasks of the mean of their runs."""
    return float(np.mean([np.mean(task) for task in tasks]))


def times_row(rows: Sequence[Row], gaps: Iterable[float] = GAPS, prefix: str = "") -> Row:
    """For each gap the number of runs that reached it, and medians of seconds and frames to it.

    A median is infinite unless more than half of the runs reached the gap.
    """
    row: Row = {}
    for gap in gaps:
        for unit in UNITS:
            values = [each.get(f"{prefix}{unit}_to_{gap:g}") for each in rows]
            times = sorted(NEVER if value is None else value for value in values)
            row[f"reached_{gap:g}"] = sum(time < NEVER for time in times)
            middle = times[(len(times) - 1) // 2] + times[len(times) // 2] if times else NEVER
            row[f"{unit}_to_{gap:g}"] = middle / 2
    return row


def gap_verdict(row: Row, layout: Layout) -> str:
    """The verdict on a variant against the control."""
    if row["variant"] == layout.control:
        return "control"
    p, margin = row["p_holm"], layout.margin
    if np.isnan(row["improvement_low"]):
        return "too few runs"
    note = f"p = {p_text(p)}" + (", primary" if row["variant"] == layout.primary else "")
    if p < LEVEL:
        return f"{'better' if row['improvement'] > 0.5 else 'worse'} ({note})"
    if margin is not None and -margin < row["apart_low"] <= row["apart_high"] < margin:
        return f"equal within {margin:g} points ({note})"
    if least_p([(row["runs"], row["runs"])]) >= LEVEL:
        return f"too few runs for p < {LEVEL:g} ({note})"
    return f"no difference shown ({note})"


def p_text(p: float) -> str:
    """A p as text; empty for NaN."""
    return "" if np.isnan(p) else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def equal_results(study: StudyRows) -> list[tuple[str, str]]:
    """The pairs of variants with equal results in all evaluations of all runs."""

    def results(rows: list[Row]) -> list[tuple[object, ...]]:
        names = ("frames", "optimality_gap")
        return sorted(
            (str(row["_x"]), row["seed"], *(e.get(name) or 0 for name in names for e in curve))
            for row in rows
            for curve in [study.curves[row["run"]]]
        )

    found = {name: results(rows) for name, rows in by_variant(study).items()}
    return [(one, other) for one, other in combinations(found, 2) if found[one] == found[other]]


# -- variants that are paired by maze or game ------------------------------------------------------


def distances(rows: Iterable[Row], distance: Distance = NASH_CONV) -> dict[str, list[float]]:
    """The distances of the policies that runs play, by maze or game, sorted."""
    found: dict[str, list[float]] = {}
    for row in rows:
        value = row.get(distance.column)
        remedy = "use duels of at most 49 cells" if distance is NASH_CONV else "resume the run"
        check(value is not None, f"{row['run']}: no exact {distance.name}; {remedy}")
        found.setdefault(str(row["_x"]), []).append(max(float(value or 0), distance.least))
    return dict(sorted(found.items()))


def unit_means(mazes: dict[str, list[float]]) -> NDArray[np.float64]:
    """[units]: the mean over seeds of each maze; of one maze the value of each run."""
    if len(mazes) == 1:
        return np.array(next(iter(mazes.values())))
    return np.array([np.mean(runs) for runs in mazes.values()])


def paired_row(
    name: str, rows: Sequence[Row], control: Sequence[Row], distance: Distance = NASH_CONV
) -> Row:
    """One variant as a flat row; ratios are of geometric means, to the control."""
    own, other = distances(rows, distance), distances(control, distance)
    units = unit_means(own)
    logs = np.log(units)
    row: Row = {"variant": name, f"{distance.unit}s": len(own), "runs": len(rows)}
    low, high = mean_interval([logs.tolist()])
    row |= bounded("distance", np.exp(logs.mean()), (np.exp(low), np.exp(high)))
    row |= {"worst": float(units.max()), "each_run": units.tolist()}
    ratio, ends, p, lower = NAN, (NAN, NAN), NAN, ""
    if rows is not control and list(own) == list(other):
        theirs = np.log(unit_means(other))
        if len(own) > 1:
            differences = logs - theirs
            ratio, ends = float(differences.mean()), mean_interval([differences.tolist()])
            p, lower = sign_flip_p(differences), f"{(differences < 0).sum()} of {len(own)}"
        else:
            sides = [logs.tolist()], [theirs.tolist()]
            ratio = float(np.mean(logs) - np.mean(theirs))
            ends, p = difference_interval(*sides), permutation_p(*sides)
    row |= bounded("ratio", float(np.exp(ratio)), (float(np.exp(ends[0])), float(np.exp(ends[1]))))
    return row | hardest_row(rows) | {"lower_in": lower, "p": p}


def paired_verdict(row: Row, layout: Layout, distance: Distance = NASH_CONV) -> str:
    """The verdict on a variant against the control, paired by maze or game."""
    if row["variant"] == layout.control:
        return "control"
    if np.isnan(row["p_holm"]):
        return f"not compared: other {distance.unit}s than the control"
    note = f"p = {row['p_holm']:.3g}" + ", primary" * (row["variant"] == layout.primary)
    if row["p_holm"] < LEVEL:
        return f"{'lower' if row['ratio'] < 1.0 else 'higher'} {distance.name} ({note})"
    return f"no difference shown ({note})"


# -- contestants -----------------------------------------------------------------------------------


def contestant_rows(study: StudyRows) -> list[Row]:
    """A row for each task, policy (greedy or sampled) and contestant: times to the gaps of
    `TARGETS`, and final gaps in per cent; failed runs count as not reaching any."""
    table: list[Row] = []
    runs = study.everything
    tasks, names = (list(dict.fromkeys(r[n] for r in runs)) for n in ("variant", "contestant"))
    for task, policy, name in product(tasks, ("greedy", "sampled"), names):
        own = [r for r in runs if (r["variant"], r["contestant"]) == (task, name)]
        ended = [row for row in own if row["status"] == "complete"]
        gaps = [100.0 * row[policy] for row in ended]
        line: Row = {"task": task, "policy": policy, "contestant": name, "runs": len(own)}
        line |= times_row(own, TARGETS, f"{policy}_")
        mean = (np.mean(gaps), distance_interval([gaps])) if gaps else (NAN, (NAN, NAN))
        line |= bounded("gap", float(mean[0]), mean[1])
        line |= {"best": min(gaps, default=NAN), "worst": max(gaps, default=NAN)}
        success = [row[f"{policy}_success"] for row in ended]
        line["unsolved"] = 100.0 * (1.0 - float(np.mean(success))) if ended else NAN
        speeds = [row["frames"] / row["seconds"] for row in ended]
        table.append(line | {"frames_per_second": float(np.median(speeds)) if ended else NAN})
    return table


def first_to_gaps(study: StudyRows, table: Sequence[Row]) -> list[Row]:
    """For each task, policy, gap and unit the contestant with the smallest median, the second, and
    their test: "ratio" of medians, "faster_in" (share of pairs of runs), and p, not corrected."""
    found: list[Row] = []
    for (task, policy), gap, unit in product(
        dict.fromkeys((row["task"], row["policy"]) for row in table), TARGETS, UNITS
    ):
        column = f"{unit}_to_{gap:g}"
        rows = [row for row in table if (row["task"], row["policy"]) == (task, policy)]
        known = sorted((r for r in rows if r[column] < NEVER), key=lambda row: row[column])
        line: Row = {"task": task, "policy": policy, "gap": gap, "unit": unit}
        line |= dict.fromkeys(("first", "second", "ratio", "faster_in", "p"))
        for place, row in zip(("first", "second"), known, strict=False):
            line[place] = row["contestant"]
        if len(known) > 1:
            ours, theirs = (
                [
                    min(row.get(f"{policy}_{column}") or 1e18, 1e18)
                    for row in study.everything
                    if (row["variant"], row["contestant"]) == (task, each["contestant"])
                ]
                for each in known[:2]
            )
            line["ratio"] = known[1][column] / known[0][column]
            line["faster_in"] = float(improvement(ours, theirs))
            line["p"] = permutation_p([ours], [theirs])
        found.append(line)
    return found


# -- beforehand ------------------------------------------------------------------------------------


def out_of_reach(study: Study) -> list[str]:
    """A line for the variants (or contestants) whose corrected p cannot be below LEVEL; [] if none.

    Holm's correction multiplies the smallest of m values by m.
    """
    layout, runs = study.layout, study.runs
    seeds = len({run.seed for run in runs})
    if layout.control is None:
        least = least_p([(seeds, seeds)])
        line = f"p < {LEVEL:g} cannot be reached: with {seeds} seeds the least p is {least:.2g}"
        return [line] if study.pinned and least >= LEVEL else []
    tasks = len({run.label.get(str(layout.x)) for run in runs})
    games = layout.x == GAME
    by_maze = (runs[0].kind == SELF_PLAY or layout.x in (GAME, MAZE)) and tasks > 1
    corrected = [v for v in layout.variants if v not in (layout.control, layout.primary)]
    unit, now = ("games" if games else "mazes", tasks) if by_maze else ("seeds", seeds)

    def least_of(count: int) -> float:
        return least_sign_flip_p(count) if by_maze else least_p([(count, count)] * tasks)

    lines = []
    for names in (corrected, [layout.primary] if layout.primary is not None else []):
        p, counts = least_of(now) * len(names), range(now, MOST_RUNS)
        if names and p >= LEVEL:
            enough = next((n for n in counts if least_of(n) * len(names) < LEVEL), None)
            remedy = f"{enough} {unit} or more" if enough else "fewer variants"
            lines.append(
                f"{', '.join(names)}: p < {LEVEL:g} cannot be reached: with {now} {unit} the least "
                f"p is {least_of(now):.2g}, corrected for {len(names)} comparisons "
                f"{min(p, 1.0):.2g}; give {remedy}"
            )
    return lines
