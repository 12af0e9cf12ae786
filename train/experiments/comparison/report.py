"""The report of a race: who reaches which gap when, all settings, and a figure of all runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from train.experiments.comparison.contestants import CONTESTANTS
from train.experiments.comparison.plan import Race
from train.experiments.comparison.run import Result, Standing
from train.experiments.comparison.tables import (
    TARGETS,
    UNITS,
    WAYS,
    curve_rows,
    reached,
    results_of,
    run_rows,
    table_rows,
    trial_rows,
)
from train.experiments.power import power_line
from train.experiments.search import LEAST_GAP
from train.experiments.statistics import distance_interval, improvement, permutation_p
from train.files import write_csv, write_text
from train.reports.curves import Level, Panel, Series, draw_panels
from train.reports.figures import PALETTE, PLAIN, Look, time_scale
from train.reports.pages import page_of
from train.reports.tables import ResultTable, Row, in_markdown, plain_table

CLOCK_WORDS = {"wall": "wall clock", "cpu": "processor time (of the run's own process)"}
HIGHEST = 3.0
"""Gaps above are drawn there: policies that solve nothing yet."""


def race_report(race: Race, standing: Standing, out: Path, look: Look = PLAIN) -> Path:
    """Write the report of a race that is over.

    Args:
        race: what was done.
        standing: how it went.
        out: the folder of the race; `report/` in it is written.
        look: of the figure; over seconds if it does not say.

    Returns:
        `report.md`; beside it `report.html`, `table.csv` (a row for each task, contestant, way to
        play and target), `runs.csv` (a row for each bout of the race), `trials.csv`, `curves.csv`.
    """
    folder = out / "report"
    folder.mkdir(parents=True, exist_ok=True)
    rows = table_rows(race, standing)
    ResultTable(rows).write(folder)
    write_csv(folder / "runs.csv", run_rows(race, standing))
    write_csv(folder / "trials.csv", trial_rows(race, standing))
    write_csv(folder / "curves.csv", curve_rows(standing))
    draw(race, standing, folder / "curves.png", look)
    write_text(folder / "report.md", page(race, standing, rows))
    page_of(folder / "report.md")
    return folder / "report.md"


def draw(race: Race, standing: Standing, path: Path, look: Look) -> None:
    """The gap over training time: a column of panels a task, a colour a contestant; the greedy
    policy above, the sampled one below."""
    unit = look.x or "seconds"
    levels = [Level(100 * target, color="#999999") for target in TARGETS]
    grid = []
    for way in WAYS:
        panels: list[Panel] = []
        for on in race.tasks:
            series = []
            for name, color in zip(race.contestants, PALETTE, strict=False):
                curves = []
                for result in results_of(race, standing, on.name, name):
                    if result is not None:
                        times = np.array([point[unit] for point in result.points])
                        gaps = np.array([point[way] for point in result.points])
                        gaps = 100 * gaps.clip(LEAST_GAP / 2, HIGHEST)
                        curves.append((times * time_scale(unit), gaps))
                if curves:
                    series.append(Series(curves, title_of(name), color, middle=np.median))
            label = "" if panels else f"gap to the optimum (%, log), {way}"
            title = on.name if way == WAYS[0] else ""
            panels.append(Panel(series, label, title, "log", levels))
        grid.append(panels)
    draw_panels(path, grid, unit, Look(look.formats, unit, log=True), beside=True)


# -- words -----------------------------------------------------------------------------------------


def in_percent(gap: float) -> str:
    """A gap in words."""
    return f"{100 * gap:.2f} %"


def shown(value: float | None, unit: str) -> str:
    """A time in words."""
    if value is None:
        return "–"
    return f"{value:.1f} s" if unit == "seconds" else f"{value / 1e6:.2f} M"


def counted(number: int, what: str) -> str:
    """So many of something."""
    return f"{number} {what}" + ("s" if number != 1 else "")


def title_of(name: str) -> str:
    """Of a contestant."""
    return CONTESTANTS[name].title


def page(race: Race, standing: Standing, rows: list[Row]) -> str:
    """The whole report as Markdown."""
    runs = len(race.seeds)
    parts = [
        f"# {in_markdown(race.title)}",
        how(race, standing),
        "## First to each gap",
        winners(race, standing, rows).markdown(),
        "In brackets: how much longer the second takes, in how many pairs of runs the first is the "
        "faster one (ties half), and the two-sided p of a permutation test. "
        f"The power of one comparison, {power_line([(runs, runs)])}. "
        "With so many comparisons some p below 0.05 are chance.",
        "![All runs: the gap to the optimum over seconds](curves.png)",
    ]
    for on in race.tasks:
        parts += [
            f"## {in_markdown(on.name)}",
            times_table(race, on.name, rows).markdown(),
            "Median seconds and frames to each gap, and how many runs reached it.",
            ends_table(race, standing, on.name).markdown(),
        ]
    parts += ["## Settings", settings_words(race), settings_table(race, standing).markdown()]
    failed = [" ".join(map(str, key)) for key, found in standing.finals.items() if found is None]
    if failed:
        parts += ["## Failed", "These runs failed, and count as not having reached any target: "]
        parts += [f"- {in_markdown(each)}" for each in failed]
    return "\n\n".join(parts) + "\n"


def how(race: Race, standing: Standing) -> str:
    """What was measured, where, and with which libraries."""
    found = [result for result in standing.finals.values() if result is not None]
    kinds = {
        name: sorted({getattr(result, name) or "unknown" for result in found})
        for name in ("processor", "library", "torch", "commit")
    }
    shares = [100 * r.points[-1]["cpu_seconds"] / r.points[-1]["wall_seconds"] for r in found]
    core = f"{min(shares):.0f} to {max(shares):.0f} %" if shares else "none"
    return (
        f"{counted(len(race.seeds), 'seed')}, one core a run, contestants in turn (seeds outside). "
        f"Seconds are {CLOCK_WORDS[race.clock]} of playing and learning, without imports, "
        f"compilation and evaluations. Each has {length(race.final)}. A run is evaluated at "
        f"{race.episodes} starts that are the same for all (a chaser exactly), greedily and as it "
        "draws. A target is reached at the first evaluation whose gap to the exact optimum is no "
        "larger; evaluations lie a twentieth of the budget apart, two more before the first of "
        "them. Medians stand only where more than half of the runs reached the target.\n\n"
        f"Processor: {in_markdown(', '.join(kinds['processor']))}. "
        f"The runs had {core} of their core. "
        f"Libraries: {', '.join(kinds['library'])}; torch {', '.join(kinds['torch'])}. "
        f"Commit: {', '.join(each[:12] for each in kinds['commit'])}."
    )


def length(budget: Any) -> str:
    """A budget in words."""
    return f"{budget.seconds:g} s" if budget.seconds else f"{budget.frames:,} frames"


def winners(race: Race, standing: Standing, rows: list[Row]) -> ResultTable:
    """For each task, way to play and target, who is first by seconds and by frames."""
    found: list[Row] = []
    for on in race.tasks:
        for way in WAYS:
            for target in TARGETS:
                key = (on.name, way, target)
                some = [r for r in rows if (r["task"], r["policy"], r["target"]) == key]
                line: Row = {"task": on.name, "policy": way, "gap": f"{100 * target:g} %"}
                line |= {f"first by {u}": first(race, standing, some, u) for u in UNITS}
                found.append(line)
    return plain_table(found)


def first(race: Race, standing: Standing, rows: list[Row], unit: str) -> str:
    """Who reaches a target first, and how surely; of rows that differ in the contestant alone."""
    column = f"median_{unit}"
    known = sorted((r for r in rows if r[column] is not None), key=lambda row: row[column])
    if not known:
        most = max(row["reached"] for row in rows)
        names = [title_of(row["contestant"]) for row in rows if row["reached"] == most]
        return f"none ({most} of {rows[0]['runs']}: {', '.join(names)})" if most else "none"
    best, name = known[0], title_of(known[0]["contestant"])
    if len(known) == 1:
        return f"{name} (alone)" if len(rows) > 1 else name
    second = known[1]
    ours, theirs = (capped(race, standing, row, unit) for row in (best, second))
    pairs = f"{float(improvement(ours, theirs)) * len(ours) * len(theirs):g}"
    return (
        f"{name} ({title_of(second['contestant'])} {second[column] / best[column]:.2f} times, "
        f"{pairs} of {len(ours) * len(theirs)} pairs, p = {permutation_p([ours], [theirs]):.2g})"
    )


def capped(race: Race, standing: Standing, row: Row, unit: str) -> list[float]:
    """The times of a row; what was not reached counts as later than all that was."""
    found = results_of(race, standing, row["task"], row["contestant"])
    times = [reached(result, row["policy"], row["target"], unit) for result in found]
    return [min(time, 1e18) for time in times]


def times_table(race: Race, task: str, rows: list[Row]) -> ResultTable:
    """Medians and counts of one task: a row a contestant and way to play."""
    found: list[Row] = []
    for way in WAYS:
        for name in race.contestants:
            line: Row = {"contestant": title_of(name), "policy": way}
            for row in rows:
                if (row["task"], row["contestant"], row["policy"]) == (task, name, way):
                    times = ", ".join(shown(row[f"median_{unit}"], unit) for unit in UNITS)
                    count = f"{row['reached']} of {row['runs']}"
                    line[f"to {100 * row['target']:g} %"] = f"{times} ({count})"
            found.append(line)
    return plain_table(found)


def ends_table(race: Race, standing: Standing, task: str) -> ResultTable:
    """What the runs of one task ended with: every one, and Student's interval of the mean."""
    rows: list[Row] = []
    for name in race.contestants:
        found = [r for r in results_of(race, standing, task, name) if r is not None]
        for way in WAYS if found else ():
            gaps = [result.points[-1][way] for result in found]
            solved = [result.points[-1][f"{way}_success"] for result in found]
            ends = " to ".join(map(in_percent, distance_interval([gaps])))
            rows.append(
                {
                    "contestant": title_of(name),
                    "policy": way,
                    "gaps at the end": ", ".join(map(in_percent, gaps)),
                    "95 % interval of the mean": ends if len(gaps) > 1 else "",
                    "unsolved": in_percent(1.0 - float(np.mean(solved))),
                    "frames/s": f"{speed(found):,.0f}",
                }
            )
    return plain_table(rows)


def speed(found: Sequence[Result]) -> float:
    """The median of frames per second of learning."""
    return median(result.points[-1]["frames"] / result.points[-1]["seconds"] for result in found)


def settings_words(race: Race) -> str:
    """How settings were searched."""
    space = "\n".join(f"- `{name}`: {spec_words(spec)}" for name, spec in race.space.items())
    mazes = "\n".join(
        f"- {on.name}: {', '.join(task.maze for task in on.held_out)}" for on in race.tasks
    )
    where = "on each held-out maze"
    if race.finalists < len(race.trials) and any(len(on.held_out) > 1 for on in race.tasks):
        where = (
            "on the first held-out maze of a task, and the best "
            f"{race.finalists} of a contestant there on the others too"
        )
    return (
        f"{counted(len(race.trials), 'trial')}, drawn once at random from the space below and the "
        f"same for all, {length(race.tuning)} {where}. The trial with the least mean logarithm of "
        "the gap at the end (greedy or as it draws, the better one) is taken. All trials: "
        "`trials.csv`. Other settings are the defaults of each library (ours: its preset of the "
        "task, with its curriculum where there is one).\n\n"
        f"{space}\n\nHeld-out mazes:\n\n{mazes}"
    )


def spec_words(spec: dict[str, Any]) -> str:
    """What a setting is drawn from."""
    if "choices" in spec:
        return ", ".join(map(str, spec["choices"]))
    scale = ", even on a logarithmic scale" if spec.get("scale") == "log" else ""
    return f"{spec['low']:g} to {spec['high']:g}{scale}"


def settings_table(race: Race, standing: Standing) -> ResultTable:
    """The settings of the runs."""
    rows: list[Row] = []
    for (task, name), number in standing.chosen.items():
        found = [r for r in results_of(race, standing, task, name) if r is not None]
        used = found[0].settings if found else race.trials[number]
        names = [*race.trials[number], "value_coef", "clip", "max_grad_norm", "shared"]
        row: Row = {"task": task, "contestant": title_of(name), "trial": number}
        rows.append(row | {each: used.get(each, "") for each in dict.fromkeys(names)})
    return plain_table(rows)
