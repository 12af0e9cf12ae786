"""Table and picture of docs/results/index.md: effects of the studies that are ratios, from their rows."""

from __future__ import annotations

from collections.abc import Iterator
from math import exp
from pathlib import Path
from typing import Any

from train.experiments.analysis import module_at
from train.experiments.rows import by_variant
from train.experiments.statistics import ratio_with_interval
from train.experiments.variants import MAZE_GAP, against_control, paired_row
from train.reports.figures import BLUE, GREEN, ORANGE, PINK, PlottedEstimate, draw_intervals
from train.reports.tables import plain_table

COLORS = {"curricula": BLUE, "imitation": GREEN, "self_play_mixing": ORANGE, "teams": PINK}
Row = dict[str, Any]


def row(study: str, what: str, of: str, units: str, ratio: list[float]) -> Row:
    """An effect: the ratio of the first to the second, with its 95 % interval."""
    return {"study": study, "what": what, "of": of, "units": units, "ratio": ratio}


def effects(data: Path) -> Iterator[Row]:
    """The primary effects of the studies, and those that their pages begin with."""

    def module(study: str) -> Any:
        return module_at(data / study / "analysis.py")

    curricula = module("curricula")
    studies = curricula.studies_in(data / "curricula")
    for name, variant, what in (
        ("adaptive", "linear", "goals near the start first, 4 M frames"),
        ("goal-spread-start", "linear", "the same, 12 M frames"),
        ("opponent-epsilon", "n=500", "annealed epsilon of the opponent"),
    ):
        (found,) = [r for r in against_control(studies[name]) if r["variant"] == variant]
        yield row("curricula", f"{what} / none", "gap", "12 mazes", ends_of(found))
    imitation = module("imitation").claim_logs(data / "imitation")
    for one, two in (("optimal", "astar"), ("optimal", "none")):
        names = {"optimal": "the optimum", "astar": "A*", "none": "nothing"}
        what = f"imitating {names[one]} / {names[two]}"
        yield row("imitation", what, "gap", "10 mazes", ratio_with_interval(imitation[one, two]))
