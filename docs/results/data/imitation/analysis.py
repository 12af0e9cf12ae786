"""Tables of docs/results/imitation.md, from the rows of study.toml."""

from __future__ import annotations

from math import log
from pathlib import Path
from statistics import median
from typing import Any

from train.experiments.recorded import read_recorded
from train.experiments.statistics import holm, ratio_with_interval, sign_flip_p
from train.reports.figures import BLUE, GREEN, GREY, ORANGE, log_axis, pyplot, save, tidy
from train.reports.tables import plain_table

VARIANTS = ("none", "start-distance", "astar", "optimal")
CLAIMS = [
    ("optimal", "none"),
    ("astar", "none"),
    ("optimal", "astar"),
    ("optimal", "start-distance"),
]
"""The first of each pair has the smaller gap; the first claim is the primary one."""
COLORS = {"none": GREY, "start-distance": GREEN, "astar": ORANGE, "optimal": BLUE}
Row = dict[str, Any]


def figures(data: Path, out: Path) -> None:
    """The gap over frames, a thin line for each maze and a thick one for their median."""
    rows = read_recorded(data / "runs.csv").values()
    figure, axis = pyplot().subplots(figsize=(7.2, 4.4), layout="constrained")
    for name in VARIANTS:
        gaps = [
            [100.0 * float(value) for value in str(row["curve"]).split()]
            for row in rows
            if row["variant"] == name
        ]
        frames = [0.3 * (place + 1) / len(gaps[0]) for place in range(len(gaps[0]))]
        for own in gaps:
            axis.plot(frames, own, lw=0.6, alpha=0.35, color=COLORS[name])
        middle = [median(values) for values in zip(*gaps, strict=True)]
        axis.plot(frames, middle, lw=2.2, color=COLORS[name], label=name)
    axis.axvline(0.1, color="#333333", lw=1.0, ls=":")
    log_axis(axis, "y")
    axis.set_xlabel("frames (millions); the imitation ends at the dotted line")
    axis.set_ylabel("gap of the greedy policy to the optimum (%)")
    axis.set_title("Chases in ten mazes of 9x9 (thin) and their median (thick)", fontsize=11)
    figure.legend(loc="outside right upper", frameon=False)
    tidy(axis)
    save(figure, out / "curves.png")


def gaps_in(data: Path) -> dict[str, dict[str, float]]:
    """The gap in per cent by variant and maze."""
    gaps: dict[str, dict[str, float]] = {name: {} for name in VARIANTS}
    for row in read_recorded(data / "runs.csv").values():
        gaps[row["variant"]][row["maze"]] = 100.0 * row["optimality_gap"]
    return gaps


def logs_of(gaps: dict[str, dict[str, float]], one: str, two: str) -> list[float]:
    """Of each maze the logarithm of the ratio of the gaps of two variants."""
    return [log(gaps[one][maze] / gaps[two][maze]) for maze in gaps[one]]


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    gaps = gaps_in(data)
    ends = [
        {
            "variant": name,
            "gap: least, median, largest": ", ".join(
                f"{value:.1f}" for value in (min(own), median(own), max(own))
            )
            + " %",
            "mazes within 5 %": f"{sum(gap <= 5.0 for gap in own)} of {len(own)}",
        }
        for name, own in ((name, list(gaps[name].values())) for name in VARIANTS)
    ]
    logs = [logs_of(gaps, one, two) for one, two in CLAIMS]
    claims = [
        {
            "claim": f"{one} below {two}",
            "ratio of gaps [95 %]": "{:.3f} [{:.3f}, {:.3f}]".format(*ratio_with_interval(own)),
            "mazes": f"{sum(value < 0.0 for value in own)} of {len(own)}",
            "p (Holm)": f"{p:.2g}",
        }
        for (one, two), own, p in zip(CLAIMS, logs, holm([*map(sign_flip_p, logs)]), strict=True)
    ]
    return {"gaps": plain_table(ends).markdown(), "claims": plain_table(claims).markdown()}
