"""The report of an ablation: every arm against the control, whatever the outcome."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train.experiments.ablation_figures import Curve, draw_arms, draw_final
from train.experiments.forms import HINTS, THRESHOLDS, Hints, read_hints
from train.experiments.methods import METHODS_LINE, methods
from train.experiments.power import power_line
from train.experiments.statistics import (
    Interval,
    difference_interval,
    distance_interval,
    first_below,
    holm,
    logrank_p,
    mean_over,
    permutation_p,
    probability_of_improvement,
)
from train.experiments.tables import collect
from train.figures import PLAIN, Look
from train.files import write_text
from train.result_table import Column, ResultTable, in_markdown
from train.settings.checks import check

LEVEL = 0.05
SPENT = 0.8
"""An arm with a smaller share of its frames on its last lesson is pointed out."""


def curve_of(row: dict[str, Any], evaluations: list[dict[str, Any]]) -> Curve:
    """The curve of a complete run; ValueError where the optimum of its task is not known."""
    check(
        row.get("optimality_gap") is not None,
        f"{row['run']}: the exact optimum of its task is not known, and an ablation is measured "
        "against it; take a task with one (a runner alone, or one chaser against one evader)",
    )
    evader = str(row["role"]).startswith("evader") and row["num_goals"] in (None, 0)

    def column(name: str) -> NDArray[np.float64]:
        values = [e.get(name) for e in evaluations]
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)

    def short(kind: str) -> float:
        steps = float(row.get(f"{kind}_steps") or np.nan)
        return 100.0 * sign * (steps / float(row["optimal_steps"]) - 1.0)

    gap = column("optimality_gap")
    sign = -1.0 if evader else 1.0
    lesson, hardest = column("lesson"), column("on_hardest")
    kept = not np.isnan(lesson).all() and not (np.isnan(hardest) & ~np.isnan(lesson)).any()
    return Curve(
        column("seconds"),
        column("frames"),
        100.0 * sign * gap,
        1.0 + gap if evader else 1.0 / (1.0 + gap),
        lesson,
        100.0 * sign * float(row["optimality_gap"]),
        short("greedy"),
        short("sampled"),
        int(row["seed"]),
        str(row["_x"]),
        hardest if kept else None,
    )


def ablation_report(out: Path, look: Look = PLAIN) -> Path:
    """Collect the runs of an ablation, draw its figures and write its tables.

    Returns:
        The folder: `report.md`, `methods.md`, `table.csv`, `table.tex`, `arms*.png`, `final.png`.

    Raises:
        ValueError: no ablation in `out`, or no arm has a complete run.
    """
    runs, evaluations = collect(out)
    hints = read_hints(out)
    control = hints.control
    if control is None or (hints.x is not None and hints.x not in runs.columns):
        raise ValueError(f"{out / HINTS}: not that of an ablation; run `pursuit ablate` again")
    by_run: dict[str, list[dict[str, Any]]] = {}
    for entry in evaluations.to_dicts():
        by_run.setdefault(entry["run"], []).append(entry)
    everything = runs.to_dicts()
    x = hints.x
    arms: dict[str, list[Curve]] = {name: [] for name in hints.arms}
    complete = [row for row in everything if row["status"] == "complete"]
    check(bool(complete), f"{out}: no run is complete yet; `pursuit ablate` goes on with it")
    if look.x is None and all(row.get("budget_frames") for row in complete):
        look = replace(look, x="frames")  # seconds would be those of whatever else the machine did
    for row in complete:
        row["_x"] = row[x] if x else ""
        arms.setdefault(row["variant"], []).append(curve_of(row, by_run[row["run"]]))
    taught = [c for curves in arms.values() for c in curves if not np.isnan(c.lesson).all()]
    known = all(c.on_hardest is not None for c in taught)  # else all by the older measure
    arms = {
        name: curves if known else [replace(c, on_hardest=None) for c in curves]
        for name, curves in arms.items()
        if curves
    }
    rows = [summary(name, curves, arms.get(control, [])) for name, curves in arms.items()]
    correct(rows, hints)
    table = table_of(rows, hints, "the hardest" if known else "its last")
    sizes = [
        tuple(zip(map(len, strata(curves)), map(len, strata(arms[control])), strict=True))
        for name, curves in arms.items()
        if name != control and {c.task for c in curves} == {c.task for c in arms.get(control, [])}
    ]
    others = len(sizes) - (hints.primary is not None)
    power = "".join(f"Here {power_line(each, others)}. " for each in dict.fromkeys(sizes))
    folder = out / "report"
    folder.mkdir(exist_ok=True)
    figures = ["final.png"]
    draw_final(folder / "final.png", rows, control, hints.title, look)
    for task in dict.fromkeys(curve.task for curves in arms.values() for curve in curves):
        name = re.sub(r"[^A-Za-z0-9_.+-]+", "_", f"arms{'-' + task if task else ''}.png")
        here = {arm: [c for c in curves if c.task == task] for arm, curves in arms.items()}
        title = hints.title + (f" ({task})" if task else "")
        draw_arms(folder / name, {a: c for a, c in here.items() if c}, control, title, look)
        figures.append(name)
    table.write(folder)
    write_text(folder / "methods.md", methods([out / "runs" / row["run"] for row in complete]))
    text = markdown(hints, table, complete, everything, figures, power)
    write_text(folder / "report.md", text)
    return folder


def strata(curves: Sequence[Curve]) -> list[list[float]]:
    """The final shortfalls of each task, in the order of the tasks' names."""
    tasks = sorted({curve.task for curve in curves})
    return [[curve.final for curve in curves if curve.task == task] for task in tasks]


def summary(name: str, curves: list[Curve], control: list[Curve]) -> dict[str, Any]:
    """One arm as a flat row; times are medians over seeds, inf where at least half never got there.

    Shortfalls in per cent, times in seconds and frames.
    """
    finals, tasks = strata(curves), {c.task for c in curves}
    low, high = distance_interval(finals)
    row: dict[str, Any] = {"arm": name, "runs": len(curves)}
    row |= {"gap": float(np.mean([np.mean(each) for each in finals]))}
    row |= {"gap_low": low, "gap_high": high}
    row |= {"best": min(map(min, finals)), "worst": max(map(max, finals))}
    for kind in ("greedy", "sampled"):
        each = [getattr(curve, kind) for curve in curves]
        row |= {f"{kind}_best": min(each), f"{kind}_worst": max(each)}
    for threshold in THRESHOLDS:
        for unit in ("seconds", "frames"):
            times = [first_below(getattr(c, unit), c.shortfall, threshold) for c in curves]
            row[f"reached_{threshold:g}"] = int(np.isfinite(times).sum())
            row[f"{unit}_to_{threshold:g}"] = _median(times)
    areas = [mean_over(c.frames, c.optimality) for c in curves]
    low, high = distance_interval([areas])
    row |= {"area": float(np.mean(areas)), "area_low": low, "area_high": high}
    row["settled"] = float(np.mean([c.settled for c in curves]))
    empty = (float("nan"), float("nan"))
    point, (low, high), p, apart = float("nan"), empty, float("nan"), empty
    if control and tasks == {c.task for c in control}:
        point, (low, high) = probability_of_improvement(finals, strata(control))
        p = permutation_p(finals, strata(control))
        apart = difference_interval(finals, strata(control), 1.0 - 2.0 * LEVEL)
    row |= {"improvement": point, "improvement_low": low, "improvement_high": high, "p": p}
    row |= {"apart_low": apart[0], "apart_high": apart[1]}
    for threshold in THRESHOLDS:
        row[f"p_to_{threshold:g}"] = _p_of_times(curves, control, threshold)
    return row


def _p_of_times(curves: list[Curve], control: list[Curve], threshold: float) -> float:
    """Of the log-rank test of frames to a gap, over all tasks; nan without a control."""
    if not control:
        return float("nan")
    sides = [
        [first_below(c.frames, c.shortfall, threshold) for c in side] for side in (curves, control)
    ]
    ends = ([c.frames[-1] for c in curves], [c.frames[-1] for c in control])
    return logrank_p(sides[0], sides[1], ends)


def correct(rows: list[dict[str, Any]], hints: Hints) -> None:
    """Correct what p there is for how many arms are compared: `p_holm`, `p_time`.

    The primary arm, which was named before, stands alone.
    """
    others = [row for row in rows if row["arm"] not in (hints.control, hints.primary)]
    for name, source in (("p_holm", "p"), ("p_time", f"p_to_{hints.threshold:g}")):
        for row in rows:
            row[name] = float("nan") if row["arm"] == hints.control else row[source]
        for row, p in zip(others, holm([row[source] for row in others]), strict=True):
            row[name] = p


def _median(times: Sequence[float]) -> float:
    """The median where runs that never got there count as infinitely late."""
    ordered = sorted(times)
    middle = len(ordered) // 2
    if len(ordered) % 2:
        return ordered[middle]
    return (ordered[middle - 1] + ordered[middle]) / 2


def verdict(row: dict[str, Any], hints: Hints) -> str:
    """What an arm shows against the control, in words."""
    if row["arm"] == hints.control:
        return "control"
    p, margin = row["p_holm"], hints.margin
    if np.isnan(row["improvement_low"]):
        return "nothing can be said"
    told = f"p = {_p(p)}" + (", primary" if row["arm"] == hints.primary else "")
    if p < LEVEL:
        return f"{'better' if row['improvement'] > 0.5 else 'worse'} ({told})"
    if margin is not None and -margin < row["apart_low"] <= row["apart_high"] < margin:
        return f"equal within {margin:g} points ({told})"
    return f"no difference shown ({told})"


def _p(p: float) -> str:
    return f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def table_of(rows: list[dict[str, Any]], hints: Hints, lesson: str) -> ResultTable:
    """`summary` of every arm as people read it; `correct` has been there.

    `lesson` says of which one the share of frames is.
    """
    control = hints.control
    columns = [
        Column("arm", lambda row: str(row["arm"]), left=True),
        Column("runs", lambda row: str(row["runs"])),
        Column("final gap, mean, % [95 %]", partial(_cell_with, "gap")),
        Column("best to worst", partial(_cell_range, "")),
        Column("greedy, %", partial(_cell_range, "greedy_")),
        Column("sampled, %", partial(_cell_range, "sampled_")),
        *(
            Column(f"to {t:g} %: seconds, M frames (runs)", partial(_cell_time, f"{t:g}"))
            for t in THRESHOLDS
        ),
        Column(
            f"log-rank p, to {hints.threshold:g} %",
            lambda row: "" if np.isnan(row["p_time"]) else _p(row["p_time"]),
        ),
        Column("optimality over training [95 %]", partial(_cell_with, "area")),
        Column(f"frames on {lesson} lesson", lambda row: _cell_settled(row["settled"])),
        Column(
            f"P(better than {control}) [95 %]",
            lambda row: "" if row["arm"] == control else _cell_with("improvement", row),
        ),
        Column("verdict", lambda row: verdict(row, hints), left=True),
    ]
    return ResultTable(rows, columns)


def _cell_settled(share: float) -> str:
    if np.isnan(share):
        return ""
    return f"{100 * share:.0f} %" + ("" if share >= SPENT else f", below {100 * SPENT:.0f} %")


def _cell_with(name: str, row: dict[str, Any]) -> str:
    return _with(row[name], (row[f"{name}_low"], row[f"{name}_high"]))


def _cell_range(which: str, row: dict[str, Any]) -> str:
    ends = (row[f"{which}best"], row[f"{which}worst"])
    return "" if np.isnan(ends[0]) else " to ".join(map(_number, ends))


def _cell_time(threshold: str, row: dict[str, Any]) -> str:
    count = f"({row[f'reached_{threshold}']} of {row['runs']})"
    seconds, frames = row[f"seconds_to_{threshold}"], row[f"frames_to_{threshold}"]
    if not np.isfinite(seconds):
        return f"not reached {count}"
    return f"{seconds:.0f}, {frames / 1e6:.1f} {count}"


def markdown(
    hints: Hints,
    table: ResultTable,
    rows: list[dict[str, Any]],
    everything: list[dict[str, Any]],
    figures: list[str],
    power: str,
) -> str:
    """The report as Markdown; `power` says what so many runs can show."""
    lines = [f"# {in_markdown(hints.title)}", "", table.markdown()]
    budgets = {(row["budget_seconds"], row["budget_frames"]) for row in rows}
    told = "; ".join(f"{s:g} s" if s is not None else f"{f:,} frames" for s, f in budgets)
    seeds = sorted({row["seed"] for row in rows})
    kinds = sorted({str(row["evaluate"]) for row in rows})
    machines = sorted({str(row["machine"]) for row in rows})
    if hints.primary is None:
        asked = "No arm was named as the primary one before the runs, so all p are corrected. "
    else:
        pair = in_markdown(f"{hints.primary} against {hints.control}")
        asked = f"Asked for before the runs: {pair}. "
    if hints.margin is not None:
        asked += (
            f"Equal is said where the 90 % interval of the difference of the means (Welch) lies "
            f"within {hints.margin:g} points, a margin named before the runs. "
        )
    lines += [
        "",
        f"{len(rows)} runs of {told} each, seeds {', '.join(map(str, seeds))}, "
        f"on {in_markdown('; '.join(machines))}.",
        "",
        "Every arm is evaluated on the same task at its final difficulty, throughout training. The "
        f"gap is by how many per cent the {' or '.join(kinds)} policy is worse than the exact "
        "optimum: the mean over runs, with Student's interval, which says little where some runs "
        "solve their task and some do not: then count those that got there. Greedy takes the "
        "most probable action, sampled plays the policy as it is learned: where the greedy one "
        "steps to and fro between two cells for ever, that gets away; both are given, best to "
        "worst run. Times are those of the first evaluation at or below the threshold, medians "
        "over runs; a run that never got there "
        "counts as infinitely late, not as missing, and is censored in the log-rank test (of "
        "frames). Optimality is optimum / steps (for evaders "
        "steps / optimum), averaged over the frames of training; 1 is perfect. P is the "
        "probability that "
        "a run of the arm ends nearer to the optimum than one of the control (Mann and Whitney), "
        "its interval Newcombe's; "
        "p is that of a permutation test of P against 0.5, two-sided; all p are corrected for the "
        f"number of arms (Holm), but that of a primary one. {asked}A verdict is given only "
        f"below {LEVEL:g}. {power}".rstrip(),
        "",
        METHODS_LINE,
    ]
    missing = [row for row in everything if row["status"] != "complete"]
    if missing:
        lines += ["", f"Not complete: {len(missing)} runs.", ""]
        failed = [f"{r['run']}: {r['status']} {r['error'] or ''}" for r in missing]
        lines += [f"- {in_markdown(line)}" for line in failed]
    lines += [""] + [f"![{name}]({name})\n" for name in figures]
    return "\n".join(lines)


def _number(value: float) -> str:
    if np.isinf(value):
        return "never"
    size = abs(value)
    text = f"{value:.0f}" if size >= 100 else f"{value:.1f}" if size >= 10 else f"{value:.2f}"
    return text.replace("-0.00", "0.00")


def _with(value: float, interval: Interval) -> str:
    if np.isnan(interval[0]):
        return _number(value)
    return f"{_number(value)} [{_number(interval[0])}, {_number(interval[1])}]"
