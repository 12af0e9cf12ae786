"""The report of a race: who reaches which gap when, all settings, and a figure of all runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from train.experiments.page import page_of
from train.experiments.power import power_line
from train.experiments.statistics import distance_interval, improvement, permutation_p
from train.figures import PLAIN, Look
from train.files import write_csv, write_text
from train.race.contestants import CONTESTANTS
from train.race.figure import draw
from train.race.plan import Race
from train.race.run import Result, Standing
from train.race.tables import (
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
from train.result_table import Column, ResultTable, Row, in_markdown, words

CLOCK_WORDS = {"wall": "wall clock", "cpu": "processor time (of the run's own process)"}


def race_report(race: Race, standing: Standing, out: Path, look: Look = PLAIN) -> Path:
    """Write the report of a race that is over.

    Args:
        race: what was done.
        standing: how it went.
        out: the folder of the race; `report/` in it is written.
        look: of the figure.

    Returns:
        `report.md`; beside it `report.html`, `table.csv` (a row for each task, contestant, way to
        play and target), `runs.csv` (a row for each bout of the race), `trials.csv`, `curves.csv`.
    """
    folder = out / "report"
    folder.mkdir(parents=True, exist_ok=True)
    rows = table_rows(race, standing)
    ResultTable(rows, []).write(folder)
    write_csv(folder / "runs.csv", run_rows(race, standing))
    write_csv(folder / "trials.csv", trial_rows(race, standing))
    write_csv(folder / "curves.csv", curve_rows(standing))
    draw(race, standing, folder / "curves.png", look)
    write_text(folder / "report.md", page(race, standing, rows))
    page_of(folder / "report.md")
    return folder / "report.md"


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
    parts = [
        f"# {in_markdown(race.title)}",
        how(race, standing),
        "## Who wins what",
        winners(race, standing, rows),
    ]
    parts += ["![All runs: the gap to the optimum over seconds](curves.png)"]
    for on in race.tasks:
        parts += [f"## {in_markdown(on.name)}", times_table(race, standing, on.name, rows)]
        parts += [ends_table(race, standing, on.name)]
    parts += ["## Settings", settings_words(race), settings_table(race, standing)]
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
        f"Seconds are {CLOCK_WORDS[race.clock]} of playing and learning: imports, compilation and "
        "evaluations are not "
        f"counted. {budget_words(race)} A run is evaluated at {race.episodes} starts that are the "
        "same for everybody (a chaser exactly), greedily and as it draws, and a target is reached "
        "at the first evaluation whose gap to the exact optimum is no larger; evaluations lie a "
        "twentieth of the budget apart, two more before the first of them. Medians stand only "
        "where more than half of the runs reached the target within the budget.\n\n"
        f"Processor: {in_markdown(', '.join(kinds['processor']))}. "
        f"The runs had {core} of their core. "
        f"Libraries: {', '.join(kinds['library'])}; torch {', '.join(kinds['torch'])}. "
        f"Commit: {', '.join(each[:12] for each in kinds['commit'])}."
    )


def budget_words(race: Race) -> str:
    """The budget of the runs in a sentence."""
    one = race.final
    return f"Each has {one.seconds:g} s." if one.seconds else f"Each has {one.frames:,} frames."


def winners(race: Race, standing: Standing, rows: list[Row]) -> str:
    """A table: for each task, way to play and target, who is first by seconds and by frames."""
    told = []
    for on in race.tasks:
        for way in WAYS:
            for target in TARGETS:
                some = [
                    row
                    for row in rows
                    if (row["task"], row["policy"], row["target"]) == (on.name, way, target)
                ]
                line: Row = {"task": on.name, "policy": way, "gap": f"{100 * target:g} %"}
                for unit in UNITS:
                    line[unit] = first(race, standing, some, unit)
                told.append(line)
    heads = [words(name) for name in ("task", "policy", "gap")]
    heads += [words("first by seconds", "seconds"), words("first by frames", "frames")]
    runs = len(race.seeds)
    note = (
        "In brackets: how much longer the second takes, in how many pairs of runs the first is the "
        "faster one (ties half), and the two-sided p of a permutation test. "
        f"The power of one comparison, {power_line([(runs, runs)])}. "
        "With so many comparisons some p below 0.05 are chance."
    )
    return f"{ResultTable(told, heads).markdown()}\n\n{note}"


def first(race: Race, standing: Standing, rows: list[Row], unit: str) -> str:
    """Who reaches a target first, and how surely; of rows that differ in the contestant alone."""
    known = sorted(
        (row for row in rows if row[f"median_{unit}"] is not None),
        key=lambda row: row[f"median_{unit}"],
    )
    if not known:
        most = max(row["reached"] for row in rows)
        names = [title_of(row["contestant"]) for row in rows if row["reached"] == most]
        return f"nobody ({most} of {rows[0]['runs']}: {', '.join(names)})" if most else "nobody"
    best = known[0]
    name = f"**{title_of(best['contestant'])}**"
    if len(rows) == 1:
        return name
    times = {row["contestant"]: capped(race, standing, row, unit) for row in rows}
    if len(known) == 1:
        return f"{name} (alone)"
    second = known[1]
    ours, theirs = times[best["contestant"]], times[second["contestant"]]
    ratio = second[f"median_{unit}"] / best[f"median_{unit}"]
    pairs = f"{float(improvement(ours, theirs)) * len(ours) * len(theirs):g}"
    p = permutation_p([ours], [theirs])
    return (
        f"{name} ({title_of(second['contestant'])} {ratio:.2f} times, {pairs} of "
        f"{len(ours) * len(theirs)} pairs, p = {p:.2g})"
    )


def capped(race: Race, standing: Standing, row: Row, unit: str) -> list[float]:
    """The times of a row; what was not reached counts as later than all that was."""
    found = results_of(race, standing, row["task"], row["contestant"])
    times = [reached(result, row["policy"], row["target"], unit) for result in found]
    return [min(time, 1e18) for time in times]


def times_table(race: Race, standing: Standing, task: str, rows: list[Row]) -> str:
    """Medians and counts of one task: a row a contestant and way to play."""
    told: list[Row] = []
    for way in WAYS:
        for name in race.contestants:
            line: Row = {"contestant": title_of(name), "policy": way}
            for row in rows:
                if (row["task"], row["contestant"], row["policy"]) == (task, name, way):
                    texts = [shown(row[f"median_{unit}"], unit) for unit in UNITS]
                    count = f"{row['reached']} of {row['runs']}"
                    line[f"to {100 * row['target']:g} %"] = f"{texts[0]}, {texts[1]} ({count})"
            told.append(line)
    heads = [words(name) for name in told[0]]
    note = "Median seconds and frames to each gap, and how many runs reached it."
    return f"{ResultTable(told, heads).markdown()}\n\n{note}"


def ends_table(race: Race, standing: Standing, task: str) -> str:
    """What the runs of one task ended with: every one, and Student's interval of the mean."""
    told = []
    for name in race.contestants:
        found = [r for r in results_of(race, standing, task, name) if r is not None]
        for way in WAYS if found else ():
            gaps = [result.points[-1][way] for result in found]
            solved = [result.points[-1][f"{way}_success"] for result in found]
            interval = distance_interval([gaps])
            told.append(
                {
                    "contestant": title_of(name),
                    "policy": way,
                    "gaps at the end": ", ".join(map(in_percent, gaps)),
                    "95 % interval of the mean": ""
                    if len(gaps) < 2
                    else f"{in_percent(interval[0])} to {in_percent(interval[1])}",
                    "unsolved": in_percent(1.0 - float(np.mean(solved))),
                    "frames/s": f"{speed(found):,.0f}",
                }
            )
    return ResultTable(told, [words(name) for name in told[0]]).markdown() if told else ""


def speed(found: Sequence[Result]) -> float:
    """The median of frames per second of learning."""
    return median(result.points[-1]["frames"] / result.points[-1]["seconds"] for result in found)


def settings_words(race: Race) -> str:
    """How settings were searched."""
    one = race.tuning
    length = f"{one.seconds:g} s" if one.seconds else f"{one.frames:,} frames"
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
        f"same for everybody, {length} {where}. The trial with the least mean of the "
        "logarithm of the gap at the end, greedy or as it draws, whichever is the better, is raced "
        "with. All trials: `trials.csv`. Whatever is not in the space is what the library sets by "
        "default (ours: its preset of the task, with its curriculum where there is one).\n\n"
        f"{space}\n\nHeld-out mazes:\n\n{mazes}"
    )


def spec_words(spec: dict[str, Any]) -> str:
    """What a setting is drawn from."""
    if "choices" in spec:
        return ", ".join(map(str, spec["choices"]))
    return f"{spec['low']:g} to {spec['high']:g}" + (
        ", even on a logarithmic scale" if spec.get("scale") == "log" else ""
    )


def settings_table(race: Race, standing: Standing) -> str:
    """The settings that were raced with."""
    told: list[Row] = []
    for (task, name), number in standing.chosen.items():
        found = [r for r in results_of(race, standing, task, name) if r is not None]
        used = found[0].settings if found else race.trials[number]
        names = [*race.trials[number], "value_coef", "clip", "max_grad_norm", "shared"]
        told.append(
            {"task": task, "contestant": title_of(name), "trial": number}
            | {each: used.get(each, "") for each in dict.fromkeys(names)}
        )
    heads: list[Column] = [words(name) for name in told[0]]
    return ResultTable(told, heads).markdown()
