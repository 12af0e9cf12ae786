"""Tables of docs/results/elo.md: do Elo ratings order snapshots as exact exploitability does?"""

from __future__ import annotations

from pathlib import Path
from statistics import fmean
from typing import Any

from scipy.stats import kendalltau

from train.experiments.committed import grouped, read_table
from train.reports.tables import plain_table

LATER = 20
"""The first snapshot of the later half."""
APART = ((1, 1), (2, 3), (4, 7), (8, 15), (16, 39))
"""Ranges of how many snapshots two are apart."""
Row = dict[str, Any]


def agreement(rows: list[Row]) -> float:
    """Kendall's tau of Elo and minus exploitability."""
    elo, exploitability = zip(*((row["elo"], -row["exploitability"]) for row in rows), strict=True)
    return float(kendalltau(elo, exploitability).statistic)


def orders(rows: list[Row]) -> list[Row]:
    """By seed the agreement of both roles; the claim is that it ends."""
    found = []
    for seed, own in grouped(rows, "seed").items():
        roles = grouped(own, "role")
        whole, later = (
            [agreement(roles[role][first:]) for role in ("chaser", "evader")]
            for first in (0, LATER)
        )
        supports = fmean(whole) > 0.5 and fmean(later) < 0.2
        line: Row = {"seed": seed}
        line["whole run: chasers, evaders"] = ", ".join(f"{tau:.2f}" for tau in whole)
        line["later half: chasers, evaders"] = ", ".join(f"{tau:.2f}" for tau in later)
        found.append(line | {"supports the claim": "yes" if supports else "no"})
    return found


def pairs(rows: list[Row]) -> list[Row]:
    """The share of pairs of snapshots in different order, by how far they are apart."""
    found = []
    for least, most in APART:
        line: Row = {"snapshots apart": f"{least}" if least == most else f"{least} to {most}"}
        for role, head in (
            ("chaser", "pairs in different order, chasers"),
            ("evader", "evaders"),
        ):
            parted = [
                (one["elo"] - other["elo"]) * (one["exploitability"] - other["exploitability"]) > 0
                for own in grouped(rows, "seed", "role").values()
                if own[0]["role"] == role
                for place, one in enumerate(own)
                for other in own[place + least : place + most + 1]
            ]
            line[head] = f"{100.0 * fmean(parted):.1f} %"
        found.append(line)
    return found


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    rows = read_table(data / "snapshots.csv")
    found = {"orders": orders(rows), "pairs": pairs(rows)}
    return {title: plain_table(table).markdown() for title, table in found.items()}
