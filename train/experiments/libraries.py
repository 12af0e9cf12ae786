"""Libraries against each other: the analysis of a comparison, from rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from train.evaluation.scores import Measure
from train.experiments import figures
from train.experiments.library_runs import COMPARED_LIBRARIES
from train.experiments.measures import budget_note, note
from train.experiments.rows import Content, StudyRows
from train.experiments.statistics import NAN, bounded, distance_interval, improvement, permutation_p
from train.experiments.variants import EXTREMES, NEVER, UNITS, time_columns, times_row
from train.reports.tables import (
    Column,
    ResultTable,
    Row,
    in_markdown,
    numeric,
    with_interval,
    words,
)

POLICY_GAPS = [Measure(policy, f"%, {policy}") for policy in ("greedy", "sampled")]
"""The measures of libraries."""
TARGETS = (5.0, 2.0, 1.0)
"""Gaps in per cent to which libraries are compared."""


def library_rows(study: StudyRows) -> list[Row]:
    """A row for each task, policy (greedy or sampled) and library: times to the gaps of
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
    """For each task, policy, gap and unit the library with the smallest median, the second, and
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


def library_columns() -> list[Column]:
    """The columns of libraries, by task and policy."""
    return [
        words("task"),
        words("policy"),
        Column("contestant", lambda row: title_of(row["contestant"]), left=True),
        *time_columns(TARGETS),
        with_interval("gap at the end, mean, % [95 %]", "gap"),
        EXTREMES,
        numeric("unsolved, %", "unsolved", ".2f"),
        numeric("frames/s", "frames_per_second", ",.0f"),
    ]


def first_columns() -> list[Column]:
    """The columns of the fastest libraries."""
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


def library_notes(study: StudyRows) -> list[str]:
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


def title_of(library: str | None) -> str:
    """The name of a library in reports; "none" for None."""
    known = COMPARED_LIBRARIES.get(str(library))
    return known.title if known else str(library or "none")


def libraries_content(study: StudyRows, folder: Path, how: figures.Drawing) -> Content:
    """The report of a comparison of libraries."""
    rows = library_rows(study)
    first = ResultTable(first_to_gaps(study, rows), first_columns())
    figures.draw_curves(folder / "curves.png", study, POLICY_GAPS, replace(how, log=True))
    paragraphs = [*library_notes(study), "## First to each gap", first.markdown()]
    paragraphs.append(note("contestants.first"))
    return ResultTable(rows, library_columns()), paragraphs, ["curves.png"]
