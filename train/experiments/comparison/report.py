"""The report of a race: who reaches which gap when, all settings, and a figure of all runs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from train.experiments.comparison.contestants import CONTESTANTS
from train.experiments.comparison.plan import Race
from train.experiments.comparison.run import Result, Standing
from train.experiments.search import LEAST_GAP
from train.experiments.statistics import (
    distance_interval,
    first_below,
    improvement,
    permutation_p,
)
from train.files import write_csv
from train.reports.curves import Level, Panel, Series, draw_panels
from train.reports.figures import PALETTE, time_scale
from train.reports.pages import write_markdown
from train.reports.tables import Row, in_markdown, plain_table

TARGETS = (0.05, 0.02, 0.01)
"""Gaps to the optimum."""
WAYS = ("greedy", "sampled")
"""How a policy plays: its most probable action, or as it was learned."""
UNITS = ("seconds", "frames")
NEVER = float("inf")
CLOCK_WORDS = {"wall": "wall clock", "cpu": "processor time (of the run's own process)"}
HIGHEST = 3.0
"""Gaps above are drawn there: policies that solve nothing yet."""


def race_report(race: Race, standing: Standing, out: Path) -> Path:
    """Write the report of a race that is over.

    Args:
        race: what was done.
        standing: how it went.
        out: the folder of the race; `report/` in it is written.

    Returns:
        `report.md`; beside it `report.html`, `table.csv` (a row for each task, contestant, way to
        play and target), `runs.csv` (a row for each run), `trials.csv`, `curves.csv`.
    """
    folder = out / "report"
    folder.mkdir(parents=True, exist_ok=True)
    rows = table_rows(race, standing)
    write_csv(folder / "table.csv", rows)
    write_csv(folder / "runs.csv", run_rows(standing))
    write_csv(folder / "trials.csv", trial_rows(race, standing))
    write_csv(folder / "curves.csv", curve_rows(standing))
    draw(race, standing, folder / "curves.png")
    parts = [
        *how(race, standing),
        "## First to each gap",
        plain_table(winner_rows(race, standing, rows)).markdown(),
        "In brackets: how much longer the second takes, and the two-sided p of a permutation test "
        "of the two. With so many comparisons some p below 0.05 are chance.",
        "![All runs: the gap to the optimum over seconds](curves.png)",
    ]
    for on in race.tasks:
        table = plain_table(task_rows(race, standing, on.name, rows)).markdown()
        parts += [f"## {in_markdown(on.name)}", table]
        parts.append("Median seconds and frames to each gap, and how many runs reached it.")
    parts += ["## Settings", *settings_parts(race, standing)]
    failed = [" ".join(map(str, key)) for key, found in standing.finals.items() if found is None]
    if failed:
        parts += ["## Failed", "These runs failed, and count as not having reached any target:"]
        parts += [f"- {in_markdown(each)}" for each in failed]
    return write_markdown(folder / "report.md", race.title, parts)


def draw(race: Race, standing: Standing, path: Path) -> None:
    """The gap over training time: a column of panels a task, a colour a contestant; the greedy
    policy above, the sampled one below."""
    levels = [Level(100 * target, color="#999999") for target in TARGETS]
    grid = []
    for way in WAYS:
        panels: list[Panel] = []
        for on in race.tasks:
            series = []
            for name, color in zip(race.contestants, PALETTE, strict=False):
                curves = [
                    (
                        time_scale("seconds") * np.array([p["seconds"] for p in result.points]),
                        np.array([p[way] for p in result.points]).clip(LEAST_GAP / 2, HIGHEST)
                        * 100,
                    )
                    for result in done(race, standing, on.name, name)
                ]
                if curves:
                    title = CONTESTANTS[name].title
                    series.append(Series(curves, title, color, middle=np.median))
            label = "" if panels else f"gap to the optimum (%, log), {way}"
            panels.append(Panel(series, label, on.name if way == WAYS[0] else "", "log", levels))
        grid.append(panels)
    draw_panels(path, grid, "seconds", beside=True, log=True)


# -- rows ------------------------------------------------------------------------------------------


def results_of(race: Race, standing: Standing, task: str, name: str) -> list[Result | None]:
    """The runs of one contestant on one task, by seed."""
    return [standing.finals[task, name, seed] for seed in race.final.seeds]


def done(race: Race, standing: Standing, task: str, name: str) -> list[Result]:
    """Those that have not failed."""
    return [result for result in results_of(race, standing, task, name) if result is not None]


def reached(result: Result | None, way: str, target: float, unit: str) -> float:
    """Seconds or frames to the first evaluation at which the gap is at most the target; `NEVER`
    where it is not within the budget, or where the run failed."""
    if result is None:
        return NEVER
    places = [point[unit] for point in result.points]
    return first_below(places, [point[way] for point in result.points], target)


def median_of(times: Sequence[float]) -> float | None:
    """The median of times of which some are `NEVER`; None where not more than half are times: it is
    not known then."""
    got = sum(time < NEVER for time in times)
    return float(median(times)) if 2 * got > len(times) else None


def table_rows(race: Race, standing: Standing) -> list[Row]:
    """A row for each task, way to play, target and contestant."""
    rows = []
    for on, way, target, name in product(race.tasks, WAYS, TARGETS, race.contestants):
        found = results_of(race, standing, on.name, name)
        row: Row = {"task": on.name, "policy": way, "target": target}
        row |= {"contestant": name, "runs": len(found)}
        for unit in UNITS:
            times = [reached(result, way, target, unit) for result in found]
            row["reached"] = sum(time < NEVER for time in times)
            row[f"median_{unit}"] = median_of(times)
            row[unit] = " ".join("-" if t == NEVER else f"{t:.6g}" for t in times)
        rows.append(row)
    return rows


def run_rows(standing: Standing) -> list[Row]:
    """A row for each run: what it ended with."""
    rows = []
    for (task, name, seed), result in standing.finals.items():
        row: Row = {"task": task, "contestant": name, "seed": seed, "failed": result is None}
        if result is not None:
            row |= result.points[-1]
            names = ("library", "torch", "commit", "processor")
            row |= {each: getattr(result, each) for each in names}
        rows.append(row)
    return rows


def trial_rows(race: Race, standing: Standing) -> list[Row]:
    """A row for each trial: its settings, and how it did on the held-out mazes."""
    return [
        {
            "task": task,
            "contestant": name,
            "trial": number,
            "chosen": standing.chosen[task, name] == number,
            **race.trials[number],
            **{
                f"gap on maze {place}": None if score is None else float(np.exp(score))
                for place, score in enumerate(scores, start=1)
            },
        }
        for (task, name, number), scores in standing.scores.items()
    ]


def curve_rows(standing: Standing) -> list[Row]:
    """A row for each evaluation of the race."""
    return [
        {"task": task, "contestant": name, "seed": seed, **point}
        for (task, name, seed), result in standing.finals.items()
        for point in (result.points if result else ())
    ]


def winner_rows(race: Race, standing: Standing, rows: list[Row]) -> list[Row]:
    """For each task, way to play and target, who is first by seconds and by frames."""
    found: list[Row] = []
    for on, way, target in product(race.tasks, WAYS, TARGETS):
        key = (on.name, way, target)
        some = [r for r in rows if (r["task"], r["policy"], r["target"]) == key]
        line: Row = {"task": on.name, "policy": way, "gap": f"{100 * target:g} %"}
        found.append(line | {f"first by {u}": first(race, standing, some, u) for u in UNITS})
    return found


def first(race: Race, standing: Standing, rows: list[Row], unit: str) -> str:
    """Who reaches a target first, and how surely; of rows that differ in the contestant alone."""
    column = f"median_{unit}"
    known = sorted((r for r in rows if r[column] is not None), key=lambda row: row[column])
    if not known:
        return "none"
    best, name = known[0], CONTESTANTS[known[0]["contestant"]].title
    if len(known) == 1:
        return f"{name} (alone)" if len(rows) > 1 else name
    second = known[1]
    ours, theirs = (
        [
            min(reached(result, row["policy"], row["target"], unit), 1e18)
            for result in results_of(race, standing, row["task"], row["contestant"])
        ]
        for row in (best, second)
    )
    return (
        f"{name} ({CONTESTANTS[second['contestant']].title} "
        f"{second[column] / best[column]:.2f} times, sooner in "
        f"{100 * float(improvement(ours, theirs)):.0f} % of the pairs of runs, "
        f"p = {permutation_p([ours], [theirs]):.2g})"
    )


def task_rows(race: Race, standing: Standing, task: str, rows: list[Row]) -> list[Row]:
    """One task, a row a contestant and way to play: times to each gap, and how its runs ended."""
    found: list[Row] = []
    for way, name in product(WAYS, race.contestants):
        line: Row = {"contestant": CONTESTANTS[name].title, "policy": way}
        for row in rows:
            if (row["task"], row["contestant"], row["policy"]) == (task, name, way):
                times = f"{shown(row['median_seconds'], 1, ' s')}, "
                times += shown(row["median_frames"], 1e-6, " M")
                count = f"{row['reached']} of {row['runs']}"
                line[f"to {100 * row['target']:g} %"] = f"{times} ({count})"
        ends = [result.points[-1] for result in done(race, standing, task, name)]
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
    """A time in words."""
    return "–" if value is None else f"{value * scale:.2f}{unit}"


# -- how it was made -------------------------------------------------------------------------------


def how(race: Race, standing: Standing) -> list[str]:
    """What was measured, where, and with which libraries."""
    found = [result for result in standing.finals.values() if result is not None]
    kinds = {
        name: ", ".join(sorted({getattr(result, name) or "unknown" for result in found}))
        for name in ("processor", "library", "torch", "commit")
    }
    shares = [100 * r.points[-1]["cpu_seconds"] / r.points[-1]["wall_seconds"] for r in found]
    core = f"{min(shares):.0f} to {max(shares):.0f} %" if shares else "none"
    return [
        f"Seeds: {', '.join(map(str, race.final.seeds))}; one core a run, contestants in turn. "
        f"Seconds are {CLOCK_WORDS[race.clock]} of playing and learning, without imports, "
        f"compilation and evaluations. Budget: {length(race.final)}. A run is evaluated at "
        f"{race.episodes} starts that are the same for all (a chaser exactly), greedily and as it "
        "draws. A target is reached at the first evaluation whose gap to the exact optimum is no "
        "larger. Medians stand only where more than half of the runs reached the target.",
        f"Processor: {in_markdown(kinds['processor'])}; the runs had {core} of their core. "
        f"Libraries: {kinds['library']}; torch {kinds['torch']}. Commit: {kinds['commit']}.",
    ]


def length(budget: Any) -> str:
    """A budget in words."""
    return f"{budget.seconds:g} s" if budget.seconds else f"{budget.frames:,} frames"


def settings_parts(race: Race, standing: Standing) -> list[str]:
    """How settings were searched, and those of the runs."""
    space = [{"setting": name, "drawn from": str(spec)} for name, spec in race.space.items()]
    mazes = [
        {"task": on.name, "held-out mazes": ", ".join(task.maze for task in on.held_out)}
        for on in race.tasks
    ]
    rows: list[Row] = []
    for (task, name), number in standing.chosen.items():
        found = done(race, standing, task, name)
        used = found[0].settings if found else race.trials[number]
        names = dict.fromkeys([*race.trials[number], "value_coef", "clip", "max_grad_norm"])
        row: Row = {"task": task, "contestant": CONTESTANTS[name].title, "trial": number}
        rows.append(row | {each: used.get(each, "") for each in names})
    return [
        f"Trials: {len(race.trials)}, drawn once at random from the space below and the same for "
        f"all, {length(race.tuning)} on each held-out maze. The trial with the least mean "
        "logarithm of the gap at the end (greedy or as it draws, the better one) is taken. Other "
        "settings are the defaults of each library (ours: its preset of the task, with its "
        "curriculum where there is one).",
        *(plain_table(each).markdown() for each in (space, mazes, rows)),
    ]
