"""Tables of docs/results/thesis.md: the claims of the thesis, decided by the runs beside them."""

from __future__ import annotations

from pathlib import Path
from statistics import fmean, median
from typing import Any

from train.experiments.claims import Decision, cell_in_words
from train.experiments.claims_page import decide_all
from train.experiments.committed import grouped
from train.experiments.recorded import read_recorded
from train.experiments.replication import load_replication
from train.experiments.rows import StudyRows
from train.experiments.statistics import distance_interval
from train.experiments.study import Claim, Layout
from train.experiments.variants import p_text
from train.reports.tables import plain_table

SETTINGS = ("algorithm", "maze", "observation", "rewards")
"""What differs between the runs of a study."""
Row = dict[str, Any]


def number(value: float) -> str:
    """A number with three digits, at most two of them behind the point."""
    return (
        f"{value:.0f}"
        if abs(value) >= 99.95
        else f"{value:.1f}"
        if abs(value) >= 9.995
        else f"{value:z.2f}"
    )


def with_interval(values: list[list[float]]) -> str:
    """The mean over mazes of the means of runs, with its interval."""
    low, high = distance_interval(values)
    return f"{number(fmean(map(fmean, values)))} [{number(low)}, {number(high)}]"


def measured(claim: Claim, cell: Decision) -> str:
    """The distances of what a claim compares, or how many runs meet it."""
    if not claim.than:
        return f"{cell.meets} of {len(cell.groups[0].mazes[0])}"
    first, *others = (with_interval(group.values(claim)) for group in cell.groups)
    return f"{first} against {' and '.join(others)}"


def claims(studies: dict[str, list[Row]]) -> list[Row]:
    """Every claim, decided again."""
    made = {n: StudyRows(Layout(""), r, r, varying=[*SETTINGS]) for n, r in studies.items()}
    return [
        {
            "study": each.study.id.removeprefix("figure-"),
            "claim": each.claim.text,
            "of": cell_in_words(cell.groups[0].cell),
            "runs": measured(each.claim, cell),
            "p": p_text(cell.corrected),
            "verdict": cell.verdict,
        }
        for each in decide_all(load_replication([*studies]), made)
        for cell in each.cells
    ]


def verdicts(decided: list[Row]) -> list[Row]:
    """By study the claims of every verdict; claims about several mazes once, with the mazes."""
    found = []
    for study, rows in grouped(decided, "study").items():
        line: Row = {"figure": study}
        for verdict in ("confirmed", "refuted", "undecided"):
            texts = []
            for text, own in grouped(rows, "claim", "verdict").items():
                mazes = " and ".join(row["of"].split(", ")[-1] for row in own)
                if text[1] == verdict:
                    said = text[0].removesuffix(".")
                    texts.append(f"{said} on {mazes}" if len(own) > 1 else said)
            line[verdict] = "; ".join(texts)
        found.append(line)
    return found


def gaps(studies: dict[str, list[Row]]) -> list[Row]:
    """The gap of every setting."""
    found = []
    for study, rows in studies.items():
        varying = [name for name in SETTINGS if len({row[name] for row in rows}) > 1]
        for own in grouped(rows, *varying).values():
            percent = [100.0 * row["optimality_gap"] for row in own]
            ends = sorted((min(percent), max(percent)), key=abs)
            line: Row = {"study": study.removeprefix("figure-")}
            line["setting"] = ", ".join(str(own[0][name]) for name in varying)
            line["gap, %, mean [95 %]"] = with_interval([percent])
            line["best to worst"] = " to ".join(map(number, ends))
            frames = median(row["frames"] / 1e6 for row in own)
            found.append(line | {"frames, million (median)": f"{frames:.1f}"})
    return found


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    studies = grouped(read_recorded(data / "runs.csv").values(), "study")
    decided = claims(studies)
    found = {"verdicts": verdicts(decided), "claims": decided, "gaps": gaps(studies)}
    return {title: plain_table(rows).markdown() for title, rows in found.items()}
