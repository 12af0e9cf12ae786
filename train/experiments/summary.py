"""The tables of studies: rows of runs, summarised by setting; their columns and explanations."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from train.evaluation.scores import OUTCOMES, UNTIL_CAPTURE, Measure
from train.experiments.contestants import CONTESTANTS
from train.experiments.rows import StudyRows
from train.experiments.statistics import (
    LEVEL,
    Interval,
    bounded,
    distance_interval,
    interquartile_mean,
    mean_interval,
)
from train.experiments.study import THRESHOLDS, Layout
from train.experiments.variants import MAZE_GAP, TARGETS, Distance, equal_results, p_text
from train.reports.tables import Column, ResultTable, Row, in_markdown, numeric, short, words
from train.runs.folder import RUN

REFERENCES = {
    "random": "random_steps",
    "scripted": "scripted_steps",
    "optimal": "optimal_steps",
    "learned": "mean_steps",
    "chaser vs A*": "chaser_vs_astar",
    "evader vs A*": "evader_vs_astar",
}
"""Those of measures in steps, and of self-play: steps."""
HEADS = {
    "objective_gap": "gap of the objective's optimum, %",
    "success": "success, %",
    "less": "less than at the start, %",
    "least": "of the worst seed, %",
}
NOTES = tomllib.loads(Path(__file__).with_name("notes.toml").read_text(encoding="utf-8"))
SPENT = 0.8
"""Variants with a smaller share of frames on the hardest stage are marked."""


GAP, REGRET = Measure("optimality_gap", "%"), Measure("return_regret", "return")


def measure_of(rows: list[Row]) -> Measure:
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
        return REFERENCES
    found = {each: f"{each}_{measure.name}" for each in ("random", "scripted", "optimal")}
    return {**found, "behind the optimum": f"{measure.name}_regret"}


def size_of(value: object) -> tuple[float, str]:
    """A sort key that orders 3x3 before 10x10, and numbers by value."""
    text = str(value)
    digits = "".join(c if c.isdigit() or c == "." else " " for c in text).split()
    return (float(digits[0]) if digits else 0.0, text)


# -- settings of a sweep ---------------------------------------------------------------------------


def summary(rows: list[Row], x: str | None) -> list[Row]:
    """One row for each x and group: means over seeds with their intervals, gaps in per cent."""
    measure, table = measure_of(rows), []
    keys = dict.fromkeys((row["_x"], row["_group"]) for row in rows)
    known = {name for name in rows[0] if all(row.get(name) is not None for row in rows)}
    for value, name in sorted(keys, key=lambda key: size_of(key[0])):
        chosen = [row for row in rows if (row["_x"], row["_group"]) == (value, name)]

        def mean(column: str, chosen: list[Row] = chosen) -> float:
            return float(np.mean([row[column] for row in chosen]))

        line: Row = {x: value} if x else {}
        line |= {"group": name, "seeds": len(chosen)}
        shown = references_of(measure)
        line |= {word: mean(column) for word, column in shown.items() if column in known}
        values = [measure.factor * row[measure.column] for row in chosen]
        line |= bounded(measure.name, float(np.mean(values)), interval_of(measure, values))
        line[f"{measure.name}_iqm"] = interquartile_mean(values)
        line["each_run"] = values
        before = f"{measure.column}_at_start"
        if before in known:
            ratios = [row[measure.column] / row[before] if row[before] else 1.0 for row in chosen]
            less = [100.0 * (1.0 - ratio) for ratio in ratios]
            line |= {"less": float(np.mean(less)), "least": min(less)}
        if measure == GAP and "objective_gap" in known:
            line["objective_gap"] = 100.0 * mean("objective_gap")
        if "success_rate" in known and measure != REGRET:
            line["success"] = 100.0 * mean("success_rate")
        table.append(line | {"seconds": mean("seconds"), "frames": mean("frames")})
    return table


def sweep_table(rows: list[Row], x: str | None) -> ResultTable:
    """The summary of runs as a table."""
    table, measure = summary(rows, x), measure_of(rows)
    unit = measure.name
    heads = HEADS | {unit: f"{measure.title} [95 %]", f"{unit}_iqm": "interquartile mean"}
    columns = []
    for name in table[0]:
        head = heads.get(name, name.replace("_", " "))
        if name in (x, "group"):
            columns.append(Column(head, partial(_setting, name), left=True))
        elif name == unit:
            columns.append(Column(head, partial(_with_interval, name, "z.2f")))
        elif name not in (f"{unit}_low", f"{unit}_high", "frames", "each_run"):
            whole = name in ("seeds", "success", "seconds")
            columns.append(numeric(head, name, ".0f" if whole else "z.2f"))
    return ResultTable(table, columns)


def _setting(name: str, row: Row) -> str:
    return short(row[name])


def _with_interval(name: str, form: str, row: Row) -> str:
    """A value with its interval, in a format or, for an empty one, with three digits."""
    value, low, high = (row[key] for key in (name, f"{name}_low", f"{name}_high"))
    if np.isnan(value):
        return ""
    shown = [format(each, form) if form else _number(each) for each in (value, low, high)]
    return shown[0] + ("" if np.isnan(low) else f" [{shown[1]}, {shown[2]}]")


def _number(value: float) -> str:
    if np.isinf(value):
        return "never"
    size = abs(value)
    return f"{value:.0f}" if size >= 100 else f"{value:.1f}" if size >= 10 else f"{value:z.2f}"


def sweep_notes(rows: list[Row]) -> list[str]:
    """The explanation of the table and the figures."""
    measure, single = measure_of(rows), all(row["kind"] == RUN for row in rows)
    lines = [note("sweep.intervals", test=" (`pursuit ablate` makes one)" if single else "")]
    lines += [note("gaps.cut")] if measure == GAP else []
    kinds = policies_of(rows)
    if measure.name in ("gap", "steps") and kinds:
        lines.append(note("sweep.steps", kinds=kinds))
    elif measure.name == "nash_conv":
        games = any(row.get("game") is not None for row in rows)
        exits = any(row.get("outcome") is not None for row in rows)
        unit = (OUTCOMES if exits else UNTIL_CAPTURE).unit
        lines.append(note("sweep.game") if games else note("sweep.nash_conv", unit=unit))
    elif measure == REGRET:
        lines.append(note("sweep.regret"))
    if measure == GAP and all(row.get("objective_gap") is not None for row in rows):
        lines.append(note("sweep.objective"))
    return lines


def policies_of(rows: list[Row]) -> str:
    """The evaluated policies, greedy or sampled."""
    return " or ".join(sorted({row["evaluate"] for row in rows if row.get("evaluate")}))


def note(place: str, **values: object) -> str:
    """An explanation of `notes.toml`, by "section.name", with its values."""
    section, _, key = place.partition(".")
    text: str = NOTES[section][key]
    return text.strip().format(**values)


# -- variants of an ablation -----------------------------------------------------------------------


def variant_columns(layout: Layout) -> list[Column]:
    """The columns of variants that are compared by gaps."""
    control = layout.control
    return [
        words("variant"),
        words("verdict"),
        numeric("runs", "runs"),
        Column("final gap, mean, % [95 %]", partial(_with_interval, "gap", "")),
        Column("best to worst", _extremes),
        *(Column(f"to {t:g} %: seconds, frames (runs)", partial(_time, t)) for t in THRESHOLDS),
        Column(f"log-rank p, to {layout.threshold:g} %", lambda row: p_text(row["p_time"])),
        Column("optimality over training [95 %]", partial(_with_interval, "area", "")),
        HARDEST,
        Column(f"P(better than {control}) [95 %]",
               lambda row: "" if row["variant"] == control
               else _with_interval("improvement", "", row)),
    ]  # fmt: skip


def _extremes(row: Row) -> str:
    return f"{_number(row['best'])} to {_number(row['worst'])}"


def _hardest(row: Row) -> str:
    share = row["hardest_share"]
    if np.isnan(share):
        return ""
    text = f"{100 * share:.0f} %" + ("" if share >= SPENT else f", below {100 * SPENT:.0f} %")
    never = row["never_hardest"]
    return text + (f"; none in {never} of {row['runs']} runs" if never else "")


HARDEST = Column("frames on the hardest stage", _hardest)


def _time(gap: float, row: Row) -> str:
    reached, runs = row[f"reached_{gap:g}"], row["runs"]
    seconds, frames = row[f"seconds_to_{gap:g}"], row[f"frames_to_{gap:g}"]
    if not np.isfinite(seconds):
        return f"median not reached ({reached} of {runs})"
    scale, unit = (1e6, "M") if frames >= 1e6 else (1e3, "k")
    return f"{_number(seconds)}, {_number(frames / scale)} {unit} ({reached} of {runs})"


def paired_columns(layout: Layout, distance: Distance) -> list[Column]:
    """The columns of variants that are paired by maze or game."""
    hardest = [HARDEST] if distance is MAZE_GAP else []
    return [
        words("variant"),
        words("verdict"),
        numeric("runs", "runs"),
        numeric(f"{distance.name}, geometric mean", "distance", ".3f"),
        numeric("worst", "worst", ".3f"),
        Column(f"ratio to {layout.control} [95 %]", partial(_with_interval, "ratio", ".2f")),
        words(f"{distance.unit}s below {layout.control}", "lower_in"),
        *hardest,
    ]


def budget_note(study: StudyRows) -> str:
    """The budgets of the runs."""
    budgets = {(row["budget_seconds"], row["budget_frames"]) for row in study.rows}
    texts = (f"{s:g} s" if s is not None else f"{f:,} frames" for s, f in budgets)
    return f"Budget per run: {'; '.join(texts)}."


def ablation_notes(study: StudyRows) -> list[str]:
    """The explanation of the table of variants that are compared by gaps."""
    layout, kinds = study.layout, policies_of(study.rows)
    pairs = [in_markdown(f"Variants {one} and {other}") for one, other in equal_results(study)]
    lines = [
        *(note("gaps.equal", pair=pair) for pair in pairs),
        budget_note(study),
        note("gaps.verdict", level=LEVEL),
        note("gaps.times", kinds=kinds, cut=note("gaps.cut")),
        note("gaps.hardest", spent=100 * SPENT),
    ]
    if layout.primary is None:
        lines.append(note("gaps.no_primary"))
    else:
        pair = in_markdown(f"{layout.primary} against {layout.control}")
        lines.append(note("gaps.primary", pair=pair))
    return lines + ([note("gaps.margin", margin=layout.margin)] if layout.margin else [])


def paired_notes(study: StudyRows, table: Sequence[Row], distance: Distance) -> list[str]:
    """The explanation of the table of variants that are paired by maze or game."""
    unit = distance.unit
    units = "mazes" if max(row[f"{unit}s"] for row in table) > 1 else "runs"
    named = {"unit": unit, "units": f"{unit}s".capitalize(), "level": LEVEL}
    values = note(f"paired.{distance.note}", least=distance.least, scale=distance.scale)
    hardest = [note("gaps.hardest", spent=100 * SPENT)] if distance is MAZE_GAP else []
    return [budget_note(study), note(f"paired.{units}", **named), values, *hardest]


# -- contestants -----------------------------------------------------------------------------------


def title_of(contestant: str | None) -> str:
    """The name of a library in reports; "none" for None."""
    return "none" if contestant is None else CONTESTANTS[contestant].title


def contestant_columns() -> list[Column]:
    """The columns of contestants, by task and policy."""
    return [
        words("task"),
        words("policy"),
        Column("contestant", lambda row: title_of(row["contestant"]), left=True),
        *(Column(f"to {t:g} %: seconds, frames (runs)", partial(_time, t)) for t in TARGETS),
        Column("gap at the end, mean, % [95 %]", partial(_with_interval, "gap", "")),
        Column("best to worst", _extremes),
        numeric("unsolved, %", "unsolved", ".2f"),
        numeric("frames/s", "frames_per_second", ",.0f"),
    ]


def first_columns() -> list[Column]:
    """The columns of the fastest contestants."""
    return [
        words("task"),
        words("policy"),
        numeric("gap, %", "gap", "g"),
        words("unit"),
        Column("first", lambda row: title_of(row["first"]), left=True),
        Column("second", lambda row: title_of(row["second"]), left=True),
        numeric("times as long", "ratio", ".2f"),
        numeric("faster in, % of pairs of runs", "faster_in", ".0f", scale=100),
        numeric("p", "p", ".2g"),
    ]


def contestant_notes(study: StudyRows) -> list[str]:
    """The method, and the versions of the libraries."""
    rows = study.rows
    clock = "processor time" if rows[0]["clock"] == "processor" else "wall clock"
    shares = [100 * row["processor_seconds"] / row["wall_seconds"] for row in rows]
    ends = {"least": min(shares), "most": max(shares)}
    libraries, torch = (
        in_markdown(", ".join(sorted({str(row[name]) for row in rows})))
        for name in ("library", "torch_version")
    )
    method = note("contestants.method", clock=clock, **ends, cut=note("gaps.cut"))
    versions = note("contestants.libraries", libraries=libraries, torch=torch)
    return [f"{budget_note(study)} {method}", versions]
