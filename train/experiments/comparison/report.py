"""The report of a comparison: times to each gap, all settings, and a figure of all runs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from train.experiments.comparison.contestants import CONTESTANTS
from train.experiments.comparison.plan import Comparison
from train.experiments.comparison.run import Outcome, Result
from train.experiments.search import LEAST_GAP
from train.experiments.statistics import (
    CUT_AT_0,
    distance_interval,
    first_below,
    improvement,
    permutation_p,
)
from train.files import write_csv
from train.reports.curves import SINGLE_RUNS, Level, Panel, Series, draw_panels
from train.reports.figures import PALETTE, time_scale
from train.reports.pages import write_markdown
from train.reports.tables import Row, in_markdown, plain_table

TARGETS = (0.05, 0.02, 0.01)
"""Gaps to the optimum."""
WAYS = ("greedy", "sampled")
"""Evaluation modes: the most probable action, or actions sampled from the policy."""
UNITS = ("seconds", "frames")
NEVER = float("inf")
CLOCK_WORDS = {"wall": "wall clock", "processor": "processor time (of the run's own process)"}
HIGHEST = 3.0
"""Larger gaps are drawn at this value: policies that solve nothing yet."""


def comparison_report(plan: Comparison, outcome: Outcome, out: Path) -> Path:
    """Write the report of a completed comparison.

    Args:
        plan: the comparison.
        outcome: its results.
        out: its folder; the report is written to `report/` in it.

    Returns:
        The path of `report.md`. Also written: `report.html`, `table.csv` (a row per task,
        contestant, evaluation mode and target), `runs.csv`, `trials.csv`, `curves.csv`.
    """
    folder = out / "report"
    folder.mkdir(parents=True, exist_ok=True)
    rows = table_rows(plan, outcome)
    write_csv(folder / "table.csv", rows)
    write_csv(folder / "runs.csv", run_rows(outcome))
    write_csv(folder / "trials.csv", trial_rows(plan, outcome))
    write_csv(folder / "curves.csv", curve_rows(outcome))
    draw(plan, outcome, folder / "curves.png")
    parts = [
        *how(plan, outcome),
        "## First to each gap",
        plain_table(winner_rows(plan, outcome, rows)).markdown(),
        "In brackets: how much longer the second takes, and the two-sided p of a permutation test "
        "between the two. The p are not corrected for the number of comparisons.",
        "![All runs: the gap to the optimum over seconds](curves.png)",
    ]
    for on in plan.tasks:
        table = plain_table(task_rows(plan, outcome, on.name, rows)).markdown()
        parts += [f"## {in_markdown(on.name)}", table]
        parts.append(
            "Median seconds and frames to each gap (– if the median run did not reach it), and the "
            f"number of runs that did. {CUT_AT_0}"
        )
    parts += ["## Settings", *settings_parts(plan, outcome)]
    failed = [" ".join(map(str, key)) for key, found in outcome.finals.items() if found is None]
    if failed:
        parts += ["## Failed runs", "These runs failed and count as not reaching any target:"]
        parts += [f"- {in_markdown(each)}" for each in failed]
    return write_markdown(folder / "report.md", plan.title, parts)


def draw(plan: Comparison, outcome: Outcome, path: Path) -> None:
    """The gap over training time: one column of panels per task, one colour per contestant, the
    greedy policy above the sampled one."""
    levels = [Level(100 * target, color="#999999") for target in TARGETS]
    grid = []
    for way in WAYS:
        panels: list[Panel] = []
        for on in plan.tasks:
            series = []
            for name, color in zip(plan.contestants, PALETTE, strict=False):
                curves = [
                    (
                        time_scale("seconds") * np.array([p["seconds"] for p in result.points]),
                        np.array([p[way] for p in result.points]).clip(LEAST_GAP / 2, HIGHEST)
                        * 100,
                    )
                    for result in done(plan, outcome, on.name, name)
                ]
                if curves:
                    title = CONTESTANTS[name].title
                    series.append(Series(curves, title, color, middle=np.median))
            label = "" if panels else f"gap to the optimum (%, log), {way}"
            panels.append(Panel(series, label, on.name if way == WAYS[0] else "", "log", levels))
        grid.append(panels)
    note = f"{SINGLE_RUNS.format('median')}. Dotted: the gaps to be reached"
    draw_panels(path, grid, "seconds", beside=True, log=True, note=note)


# -- rows ------------------------------------------------------------------------------------------


def results_of(plan: Comparison, outcome: Outcome, task: str, name: str) -> list[Result | None]:
    """The runs of one contestant on one task, by seed."""
    return [outcome.finals[task, name, seed] for seed in plan.final.seeds]


def done(plan: Comparison, outcome: Outcome, task: str, name: str) -> list[Result]:
    """The results of the runs that did not fail."""
    return [result for result in results_of(plan, outcome, task, name) if result is not None]


def reached(result: Result | None, way: str, target: float, unit: str) -> float:
    """Seconds or frames to the first evaluation with a gap of at most the target; `NEVER` if the
    budget ends before, or if the run failed."""
    if result is None:
        return NEVER
    places = [point[unit] for point in result.points]
    return first_below(places, [point[way] for point in result.points], target)


def median_of(times: Sequence[float]) -> float | None:
    """The median of times of which some are `NEVER`; None unless more than half are finite."""
    got = sum(time < NEVER for time in times)
    return float(median(times)) if 2 * got > len(times) else None


def table_rows(plan: Comparison, outcome: Outcome) -> list[Row]:
    """A row for each task, evaluation mode, target and contestant."""
    rows = []
    for on, way, target, name in product(plan.tasks, WAYS, TARGETS, plan.contestants):
        found = results_of(plan, outcome, on.name, name)
        row: Row = {"task": on.name, "policy": way, "target": target}
        row |= {"contestant": name, "runs": len(found)}
        for unit in UNITS:
            times = [reached(result, way, target, unit) for result in found]
            row["reached"] = sum(time < NEVER for time in times)
            row[f"median_{unit}"] = median_of(times)
            row[unit] = " ".join("-" if t == NEVER else f"{t:.6g}" for t in times)
        rows.append(row)
    return rows


def run_rows(outcome: Outcome) -> list[Row]:
    """A row for each run: its last evaluation."""
    rows = []
    for (task, name, seed), result in outcome.finals.items():
        row: Row = {"task": task, "contestant": name, "seed": seed, "failed": result is None}
        if result is not None:
            row |= result.points[-1]
            names = ("library", "torch", "commit", "processor")
            row |= {each: getattr(result, each) for each in names}
        rows.append(row)
    return rows


def trial_rows(plan: Comparison, outcome: Outcome) -> list[Row]:
    """A row for each trial: its settings, and its gaps on the held-out mazes."""
    return [
        {
            "task": task,
            "contestant": name,
            "trial": number,
            "chosen": outcome.chosen[task, name] == number,
            **plan.trials[number],
            **{
                f"gap on maze {place}": None if score is None else float(np.exp(score))
                for place, score in enumerate(scores, start=1)
            },
        }
        for (task, name, number), scores in outcome.scores.items()
    ]


def curve_rows(outcome: Outcome) -> list[Row]:
    """A row for each evaluation of the comparison."""
    return [
        {"task": task, "contestant": name, "seed": seed, **point}
        for (task, name, seed), result in outcome.finals.items()
        for point in (result.points if result else ())
    ]


def winner_rows(plan: Comparison, outcome: Outcome, rows: list[Row]) -> list[Row]:
    """The fastest contestant by seconds and by frames, for each task, mode and target."""
    found: list[Row] = []
    for on, way, target in product(plan.tasks, WAYS, TARGETS):
        key = (on.name, way, target)
        some = [r for r in rows if (r["task"], r["policy"], r["target"]) == key]
        line: Row = {"task": on.name, "policy": way, "gap": f"{100 * target:g} %"}
        found.append(line | {f"first by {u}": first(plan, outcome, some, u) for u in UNITS})
    return found


def first(plan: Comparison, outcome: Outcome, rows: list[Row], unit: str) -> str:
    """The fastest contestant to a target, with its p; of rows that differ only in contestant."""
    column = f"median_{unit}"
    known = sorted((r for r in rows if r[column] is not None), key=lambda row: row[column])
    if not known:
        return "none"
    best, name = known[0], CONTESTANTS[known[0]["contestant"]].title
    if len(known) == 1:
        return f"{name} (the only one)" if len(rows) > 1 else name
    second = known[1]
    ours, theirs = (
        [
            min(reached(result, row["policy"], row["target"], unit), 1e18)
            for result in results_of(plan, outcome, row["task"], row["contestant"])
        ]
        for row in (best, second)
    )
    return (
        f"{name} ({CONTESTANTS[second['contestant']].title} "
        f"{second[column] / best[column]:.2f} times as long; faster in "
        f"{100 * float(improvement(ours, theirs)):.0f} % of the pairs of runs, "
        f"p = {permutation_p([ours], [theirs]):.2g})"
    )


def task_rows(plan: Comparison, outcome: Outcome, task: str, rows: list[Row]) -> list[Row]:
    """The rows of one task, by contestant and mode: times to each gap, and final gaps."""
    found: list[Row] = []
    for way, name in product(WAYS, plan.contestants):
        line: Row = {"contestant": CONTESTANTS[name].title, "policy": way}
        for row in rows:
            if (row["task"], row["contestant"], row["policy"]) == (task, name, way):
                times = f"{shown(row['median_seconds'], 1, ' s')}, "
                times += shown(row["median_frames"], 1e-6, " M")
                count = f"{row['reached']} of {row['runs']}"
                line[f"to {100 * row['target']:g} %"] = f"{times} ({count})"
        ends = [result.points[-1] for result in done(plan, outcome, task, name)]
        gaps = [end[way] for end in ends]
        low, high = distance_interval([gaps]) if gaps else (NEVER, NEVER)
        line["gaps at the end, %"] = ", ".join(f"{100 * gap:.2f}" for gap in gaps)
        line["95 % interval of the mean"] = (
            f"{100 * low:.2f} to {100 * high:.2f}" if len(gaps) > 1 else ""
        )
        unsolved = [1.0 - end[f"{way}_success"] for end in ends]
        line["unsolved"] = f"{100 * float(np.mean(unsolved)):.2f} %" if ends else ""
        speeds = [end["frames"] / end["seconds"] for end in ends]
        line["frames/s"] = f"{median(speeds):,.0f}" if ends else ""
        found.append(line)
    return found


def shown(value: float | None, scale: float, unit: str) -> str:
    """A time as text."""
    return "–" if value is None else f"{value * scale:.2f}{unit}"


# -- methods ---------------------------------------------------------------------------------------


def how(plan: Comparison, outcome: Outcome) -> list[str]:
    """The method, the machine and the versions of libraries."""
    found = [result for result in outcome.finals.values() if result is not None]
    kinds = {
        name: ", ".join(sorted({getattr(result, name) or "unknown" for result in found}))
        for name in ("processor", "library", "torch", "commit")
    }
    shares = [100 * r.points[-1]["processor_seconds"] / r.points[-1]["wall_seconds"] for r in found]
    core = f"{min(shares):.0f} to {max(shares):.0f} %" if shares else "none"
    return [
        f"Seeds: {', '.join(map(str, plan.final.seeds))}; one core per run, contestants alternate. "
        f"Seconds are {CLOCK_WORDS[plan.clock]} of rollouts and updates, without imports, "
        f"compilation and evaluations. Budget: {length(plan.final)}. A run is evaluated from "
        f"{plan.episodes} starts, the same for all (a chaser exactly), with greedy and sampled "
        "actions. A target is reached at the first evaluation with a gap to the exact optimum of "
        "at most the target. Medians are given if more than half of the runs reached the target.",
        f"Processor: {in_markdown(kinds['processor'])}; the runs used {core} of their core. "
        f"Libraries: {kinds['library']}; torch {kinds['torch']}. Commit: {kinds['commit']}.",
    ]


def length(budget: Any) -> str:
    """A budget as text."""
    return f"{budget.seconds:g} s" if budget.seconds else f"{budget.frames:,} frames"


def settings_parts(plan: Comparison, outcome: Outcome) -> list[str]:
    """The method of the search, and the settings of the final runs."""
    space = [{"setting": name, "drawn from": str(spec)} for name, spec in plan.space.items()]
    mazes = [
        {"task": on.name, "held-out mazes": ", ".join(task.maze for task in on.held_out)}
        for on in plan.tasks
    ]
    rows: list[Row] = []
    for (task, name), number in outcome.chosen.items():
        found = done(plan, outcome, task, name)
        used = found[0].settings if found else plan.trials[number]
        names = dict.fromkeys([*plan.trials[number], "value_coef", "clip", "max_grad_norm"])
        row: Row = {"task": task, "contestant": CONTESTANTS[name].title, "trial": number}
        rows.append(row | {each: used.get(each, "") for each in names})
    return [
        f"Trials: {len(plan.trials)}, drawn at random from the space below and the same for all "
        f"contestants, {length(plan.tuning)} on each held-out maze. The trial with the smallest "
        "mean logarithm of the final gap (greedy or sampled, the better one) is selected. Other "
        "settings are the defaults of each library (ours: the preset of the task, including its "
        "curriculum if it has one).",
        *(plain_table(each).markdown() for each in (space, mazes, rows)),
    ]
