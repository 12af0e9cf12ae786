"""Tables of docs/results/imitation.md, from the rows of study.toml."""

from __future__ import annotations

from math import log
from pathlib import Path
from statistics import median
from typing import Any

from train.experiments.recorded import read_recorded
from train.experiments.statistics import holm, ratio_with_interval, sign_flip_p
from train.reports.tables import plain_table

VARIANTS = ("none", "start-distance", "astar", "optimal")
CLAIMS = [
    ("optimal", "none"),
    ("astar", "none"),
    ("optimal", "astar"),
    ("optimal", "start-distance"),
]
"""The first of each pair has the smaller gap; the first claim is the primary one."""
Row = dict[str, Any]


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    rows = list(read_recorded(data / "runs.csv").values())
    gaps: dict[str, dict[str, float]] = {name: {} for name in VARIANTS}
    for row in rows:
        gaps[row["variant"]][row["maze"]] = 100.0 * row["optimality_gap"]
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
    logs = [[log(gaps[one][maze] / gaps[two][maze]) for maze in gaps[one]] for one, two in CLAIMS]
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
