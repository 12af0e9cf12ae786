"""The report of an ablation: every arm against the control, whatever the outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train.experiments.report import PALETTE, _csv, _pyplot, _tidy
from train.experiments.statistics import (
    Interval,
    first_below,
    interquartile_mean,
    interquartile_means,
    mean_over,
    permutation_p,
    probability_of_improvement,
    stratified_interval,
)
from train.experiments.sweep import HINTS
from train.experiments.tables import collect
from train.runs.folder import read_json, write_beside
from train.settings.checks import check

THRESHOLDS = (20.0, 10.0, 5.0, 2.0)
"""Per cent above the optimum that are waited for."""
GREY = "#7F7F7F"
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
    return Curve(
        column("seconds"),
        column("frames"),
        100.0 * sign * gap,
        1.0 + gap if evader else 1.0 / (1.0 + gap),
        column("lesson") if any("lesson" in e for e in evaluations) else np.full(len(gap), np.nan),
        100.0 * sign * float(row["optimality_gap"]),
        short("greedy"),
        short("sampled"),
        int(row["seed"]),
        str(row["_x"]),
    )


def ablation_report(out: Path) -> Path:
    """Collect the runs of an ablation, draw its figures and write its tables.

    Returns:
        The folder: `report.md`, `table.csv`, `arms*.png`, `final.png`.

    Raises:
        ValueError: no ablation in `out`, or no arm has a complete run.
    """
    runs, evaluations = collect(out)
    hints = read_json(out / HINTS)
    by_run: dict[str, list[dict[str, Any]]] = {}
    for entry in evaluations.to_dicts():
        by_run.setdefault(entry["run"], []).append(entry)
    everything = runs.to_dicts()
    x = hints.get("x")
    arms: dict[str, list[Curve]] = {name: [] for name in hints["arms"]}
    complete = [row for row in everything if row["status"] == "complete"]
    check(bool(complete), f"{out}: no run is complete yet; `pursuit ablate` goes on with it")
    for row in complete:
        row["_x"] = row[x] if x else ""
        arms.setdefault(row["variant"], []).append(curve_of(row, by_run[row["run"]]))
    arms = {name: curves for name, curves in arms.items() if curves}
    control = hints["control"]
    table = [summary(name, curves, arms.get(control, [])) for name, curves in arms.items()]
    folder = out / "report"
    folder.mkdir(exist_ok=True)
    figures = ["final.png"]
    draw_final(folder / "final.png", table, control, hints["title"])
    for task in dict.fromkeys(curve.task for curves in arms.values() for curve in curves):
        name = f"arms{'-' + task if task else ''}.png".replace("/", "_")
        here = {arm: [c for c in curves if c.task == task] for arm, curves in arms.items()}
        title = hints["title"] + (f" ({task})" if task else "")
        draw_arms(folder / name, {a: c for a, c in here.items() if c}, control, title)
        figures.append(name)
    write_beside(folder / "table.csv", lambda beside: beside.write_text(_csv(table)))
    text = markdown(hints["title"], table, control, complete, everything, figures)
    write_beside(folder / "report.md", lambda beside: beside.write_text(text, encoding="utf-8"))
    return folder


def strata(curves: Sequence[Curve]) -> list[list[float]]:
    """The final shortfalls of each task, in the order of the tasks' names."""
    tasks = sorted({curve.task for curve in curves})
    return [[curve.final for curve in curves if curve.task == task] for task in tasks]


def summary(name: str, curves: list[Curve], control: list[Curve]) -> dict[str, Any]:
    """One arm as a flat row; times are medians over seeds, inf where at least half never got there.

    Shortfalls in per cent, times in seconds and frames.
    """
    finals = [curve.final for curve in curves]
    low, high = stratified_interval(strata(curves))
    row: dict[str, Any] = {"arm": name, "runs": len(curves)}
    row |= {"gap": interquartile_mean(finals), "gap_low": low, "gap_high": high}
    row |= {"best": min(finals), "worst": max(finals)}
    for kind in ("greedy", "sampled"):
        each = [getattr(curve, kind) for curve in curves]
        row |= {f"{kind}_best": min(each), f"{kind}_worst": max(each)}
    for threshold in THRESHOLDS:
        for unit in ("seconds", "frames"):
            times = [first_below(getattr(c, unit), c.shortfall, threshold) for c in curves]
            row[f"reached_{threshold:g}"] = int(np.isfinite(times).sum())
            row[f"{unit}_to_{threshold:g}"] = _median(times)
    areas = [mean_over(c.seconds, c.optimality) for c in curves]
    low, high = stratified_interval([areas])
    row |= {"area": interquartile_mean(areas), "area_low": low, "area_high": high}
    point, (low, high), p = float("nan"), (float("nan"), float("nan")), float("nan")
    tasks = {c.task for c in curves}
    if control and tasks == {c.task for c in control}:
        point, (low, high) = probability_of_improvement(strata(curves), strata(control))
        p = permutation_p(strata(curves), strata(control))
    row |= {"improvement": point, "improvement_low": low, "improvement_high": high, "p": p}
    return row


def _median(times: Sequence[float]) -> float:
    """The median where runs that never got there count as infinitely late."""
    ordered = sorted(times)
    middle = len(ordered) // 2
    if len(ordered) % 2:
        return ordered[middle]
    return (ordered[middle - 1] + ordered[middle]) / 2


def verdict(row: dict[str, Any], control: str) -> str:
    """What an arm shows against the control, in words."""
    if row["arm"] == control:
        return "control"
    low = row["improvement_low"]
    if np.isnan(low):
        return "nothing can be said"
    told = f"p = {row['p']:.3f}" if row["p"] < 0.1 else f"p = {row['p']:.2f}"
    if row["p"] >= 0.05:
        return f"no difference shown ({told})"
    return f"{'better' if row['improvement'] > 0.5 else 'worse'} ({told})"


def markdown(
    title: str,
    table: list[dict[str, Any]],
    control: str,
    rows: list[dict[str, Any]],
    everything: list[dict[str, Any]],
    figures: list[str],
) -> str:
    """The report as Markdown."""
    heads = ["arm", "runs", "final gap, % [95 %]", "best to worst", "greedy, %", "sampled, %"]
    heads += [f"to {t:g} %: seconds, M frames (runs)" for t in THRESHOLDS]
    heads += ["optimality over training [95 %]", f"P(better than {control}) [95 %]", "verdict"]
    lines = [f"# {title}", "", "| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in table:
        cells = [row["arm"], str(row["runs"])]
        cells.append(_with(row["gap"], (row["gap_low"], row["gap_high"])))
        cells.append(f"{_number(row['best'])} to {_number(row['worst'])}")
        for kind in ("greedy", "sampled"):
            ends = (row[f"{kind}_best"], row[f"{kind}_worst"])
            cells.append("" if np.isnan(ends[0]) else " to ".join(map(_number, ends)))
        for t in THRESHOLDS:
            count = f"({row[f'reached_{t:g}']} of {row['runs']})"
            seconds, frames = row[f"seconds_to_{t:g}"], row[f"frames_to_{t:g}"]
            reached = np.isfinite(seconds)
            cells.append(
                f"{seconds:.0f}, {frames / 1e6:.1f} {count}" if reached else f"not reached {count}"
            )
        cells.append(_with(row["area"], (row["area_low"], row["area_high"])))
        own = row["arm"] == control
        interval = (row["improvement_low"], row["improvement_high"])
        cells.append("" if own else _with(row["improvement"], interval))
        cells.append(verdict(row, control))
        lines.append("| " + " | ".join(cells) + " |")
    budgets = {(row["budget_seconds"], row["budget_frames"]) for row in rows}
    told = "; ".join(f"{s:g} s" if s is not None else f"{f:,} frames" for s, f in budgets)
    seeds = sorted({row["seed"] for row in rows})
    kinds = sorted({str(row["evaluate"]) for row in rows})
    machines = sorted({str(row["machine"]) for row in rows})
    lines += [
        "",
        f"{len(rows)} runs of {told} each, seeds {', '.join(map(str, seeds))}, "
        f"on {'; '.join(machines)}.",
        "",
        "Every arm is evaluated on the same task at its final difficulty, throughout training. The "
        f"gap is by how many per cent the {' or '.join(kinds)} policy is worse than the exact "
        "optimum: the interquartile mean over runs, with a stratified bootstrap. Greedy takes the "
        "most probable action, sampled plays the policy as it is learned: where the greedy one "
        "steps to and fro between two cells for ever, that gets away; both are given, best to worst run. "
        "Times are those of the first "
        "evaluation at or below the threshold, medians over runs; a run that never got there "
        "counts as infinitely late, not as missing. Optimality is optimum / steps (for evaders "
        "steps / optimum), averaged over training time; 1 is perfect. P is the probability that "
        "a run of the arm ends nearer to the optimum than one of the control (Mann and Whitney); "
        "p is that of an exact permutation test of P against 0.5, two-sided; a verdict is given "
        "only below 0.05, which three seeds against three can never reach (0.1 at best). With few "
        "seeds intervals are hardly more than the range of the runs.",
    ]
    missing = [row for row in everything if row["status"] != "complete"]
    if missing:
        lines += ["", f"Not complete: {len(missing)} runs.", ""]
        lines += [f"- {r['run']}: {r['status']} {r['error'] or ''}".rstrip() for r in missing]
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


# -- figures ---------------------------------------------------------------------------------------


def draw_final(path: Path, table: list[dict[str, Any]], control: str, title: str) -> None:
    """Final gaps and probabilities of improvement with their intervals, one line an arm."""
    pyplot = _pyplot()
    import matplotlib

    figure, (left, right) = pyplot.subplots(
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
    left.set_xscale("symlog", linthresh=1.0)
    left.xaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
    ends = [row[name] for row in table for name in ("best", "worst")]
    left.set_xlim(1.4 * min(*ends, 0.0) - 0.1, 1.6 * max(ends) + 0.2)
    left.axvline(0, color="#333333", lw=1.0, ls=":")
    left.set_xlabel("final gap to the optimum (%)")
    right.set_xlim(-0.03, 1.03)
    right.axvline(0.5, color="#333333", lw=1.0, ls=":")
    right.set_xlabel(f"P(better than {control})")
    for axis in (left, right):
        _tidy(axis)
    figure.suptitle(title, fontsize=11)
    write_beside(path, lambda beside: figure.savefig(beside, dpi=130, format="png"))
    pyplot.close(figure)


def draw_arms(path: Path, arms: dict[str, list[Curve]], control: str, title: str) -> None:
    """A panel for each arm: the control in grey, all seeds faint, what was trained on below."""
    pyplot = _pyplot()
    import matplotlib

    names = [name for name in arms if name != control] or [control]
    columns = min(len(names), 4)
    lines = -(-len(names) // columns)
    figure, grid = pyplot.subplots(
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
                    curve.seconds, curve.shortfall, color=shade, lw=0.8, alpha=0.4, zorder=order
                )
            places, middle = _middle(arms.get(arm, []))
            if len(places):
                upper.plot(places, middle, color=shade, lw=1.9, zorder=order + 2, label=arm)
        upper.set_yscale("symlog", linthresh=1.0)
        upper.set_ylim(1.3 * bottom, 1.6 * top + 0.2)
        upper.yaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
        upper.axhline(0, color="#333333", lw=1.0, ls=":")
        upper.set_title(name, fontsize=10)
        for curve in arms[name]:
            lower.plot(curve.seconds, curve.lesson, color=color, lw=1.0, alpha=0.6)
        if all(np.isnan(curve.lesson).all() for curve in arms[name]):
            said = "as the task" if name == control else "levels, chosen one by one"
            lower.text(0.5, 0.5, said, transform=lower.transAxes, ha="center", va="center")
            lower.set_yticks([])
        for axis in (upper, lower):
            _tidy(axis)
    for number in range(len(names), lines * columns):
        for half in (0, 1):
            grid[2 * (number // columns) + half, number % columns].set_visible(False)
    for line in range(lines):
        grid[2 * line, 0].set_ylabel("gap to the optimum (%)")
        grid[2 * line + 1, 0].set_ylabel("trained on")
    figure.supxlabel("training time (s)", fontsize=10)
    figure.suptitle(f"{title}; grey: {control}", fontsize=11)
    write_beside(path, lambda beside: figure.savefig(beside, dpi=130, format="png"))
    pyplot.close(figure)


def _middle(curves: list[Curve]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The interquartile mean of the curves, where all of them are."""
    if not curves:
        return np.zeros(0), np.zeros(0)
    start = max(curve.seconds[0] for curve in curves)
    end = min(curve.seconds[-1] for curve in curves)
    places = np.linspace(start, max(start, end), 80)
    values = [np.interp(places, curve.seconds, curve.shortfall) for curve in curves]
    return places, interquartile_means(np.stack(values, axis=-1))
