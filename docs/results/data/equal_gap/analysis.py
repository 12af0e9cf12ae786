"""Tables and figure of docs/results/equal_gap.md, from the rows of make_rows.py."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, combinations_with_replacement
from pathlib import Path
from statistics import fmean, median
from typing import Any

from train.experiments.committed import read_table
from train.experiments.statistics import holm, mean_interval, sign_flip_p
from train.reports.figures import PlottedEstimate, draw_intervals
from train.reports.tables import plain_table

CURRICULA = ("none", "start-distance", "opponent-epsilon")
FRAMES, THRESHOLD = 1_000_000, 0.05
LENGTH = 0.1
"""Of the curricula, as a share of the frames, so that most runs stop in the task itself."""
CLAIMS = {
    "all three curricula": CURRICULA,
    "none and start-distance alone": CURRICULA[:2],
}
"""By name the curricula between which runs are compared; the first is the primary one."""
Row = dict[str, Any]


def similarity(pairs: Sequence[Row], maze: str, one: str, two: str) -> float:
    """The mean correlation of runs of two curricula, or of one, in a maze."""
    return fmean(
        row["spearman"]
        for row in pairs
        if row["maze"] == maze and sorted((row["one"], row["two"])) == sorted((one, two))
    )


def differences(pairs: Sequence[Row], curricula: Sequence[str]) -> list[float]:
    """Of every maze the mean similarity within a curriculum minus that between two."""
    found = []
    for maze in dict.fromkeys(row["maze"] for row in pairs):
        within = fmean(similarity(pairs, maze, name, name) for name in curricula)
        between = fmean(similarity(pairs, maze, *both) for both in combinations(curricula, 2))
        found.append(within - between)
    return found


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    runs, pairs = (read_table(data / f"{name}.csv") for name in ("runs", "pairs"))
    mazes = list(dict.fromkeys(row["maze"] for row in runs))
    alike = [
        {"curricula": " and ".join(dict.fromkeys(both)),
         "similarity": f"{fmean(similarity(pairs, maze, *both) for maze in mazes):.3f}"}
        for both in combinations_with_replacement(CURRICULA, 2)
    ]  # fmt: skip
    ends = []
    for name in CURRICULA:
        own = [row for row in runs if row["curriculum"] == name]
        frames = sorted(row["frames"] for row in own)
        reached = sum(row["gap"] <= THRESHOLD for row in own)
        early = 0 if name == "none" else sum(count < LENGTH * FRAMES for count in frames)
        line: Row = {"curriculum": name, "runs": len(own), "to 5 %": reached}
        line["stopped before its end"] = early
        ends.append(line | {"frames, median": f"{median(frames):,.0f}",
                            "least to most": f"{frames[0]:,} to {frames[-1]:,}"})  # fmt: skip
    values = {name: differences(pairs, own) for name, own in CLAIMS.items()}
    claims = []
    for (name, own), p in zip(values.items(), holm([sign_flip_p(own) for own in values.values()]),
                              strict=True):  # fmt: skip
        low, high = mean_interval([own])
        line = {"within minus between": name}
        line["mean [95 %]"] = f"{fmean(own):.3f} [{low:.3f}, {high:.3f}]"
        line["mazes above 0"] = f"{sum(value > 0 for value in own)} of {len(own)}"
        claims.append(line | {"p": f"{p:.2g}"})
    found = {"differences": claims, "similarities": alike, "runs": ends}
    return {title: plain_table(rows).markdown() for title, rows in found.items()}


def figures(data: Path, out: Path) -> None:
    """Of every maze the difference of the similarities, with the mean and its interval."""
    pairs, shown = read_table(data / "pairs.csv"), list[PlottedEstimate]()
    for name, curricula in CLAIMS.items():
        values = differences(pairs, curricula)
        shown.append(PlottedEstimate(name, fmean(values), *mean_interval([values]), values))
    label = "rank correlation within one curriculum\nminus that between two (0: no difference)"
    title = "Similarity of errors at a gap of 5 %: twelve mazes (strokes), mean, 95 % interval"
    draw_intervals(out / "differences.png", {label: ("linear", shown)}, title, also="png")
