"""Tables of docs/results/elo.md: do Elo ratings order snapshots as exact exploitability does?"""

from __future__ import annotations

from pathlib import Path
from statistics import fmean
from typing import Any

from scipy.stats import kendalltau

from train.experiments.committed import grouped, read_table
from train.reports.figures import BLUE, ORANGE, log_axis, pyplot, save, tidy
from train.reports.tables import plain_table

LATER = 20
"""The first snapshot of the later half."""
SHOWN = 9
"""The seed of the figure, the only one that supports the claim."""
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


def figures(data: Path, out: Path) -> None:
    """Elo and exploitability of both sides over frames, of one run."""
    rows = [row for row in read_table(data / "snapshots.csv") if row["seed"] == SHOWN]
    figure, (above, below) = pyplot().subplots(
        2, 1, figsize=(7.2, 6.0), sharex=True, layout="constrained"
    )
    for (role, own), color in zip(grouped(rows, "role").items(), (ORANGE, BLUE), strict=True):
        frames = [row["frames"] / 1e6 for row in own]
        style = {"marker": "o", "ms": 4.0, "lw": 1.3, "color": color, "label": f"{role}s"}
        above.plot(frames, [row["elo"] for row in own], **style)
        below.plot(frames, [row["exploitability"] for row in own], **style)
    log_axis(below, "y")
    above.set_title(f"Snapshots of self-play on 5x5-tree, seed {SHOWN}", fontsize=11)
    above.set_ylabel("Elo")
    below.set_ylabel("exact exploitability (discounted steps)")
    below.set_xlabel("frames (millions)")
    above.legend(frameon=False)
    tidy(above)
    tidy(below)
    save(figure, out / "seed9.png")


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    rows = read_table(data / "snapshots.csv")
    found = {"orders": orders(rows), "pairs": pairs(rows)}
    return {title: plain_table(table).markdown() for title, table in found.items()}
