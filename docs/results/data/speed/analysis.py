"""Tables of docs/results/speed.md from peers.csv: the simulator beside other libraries."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import Any

from train.experiments.committed import grouped, read_table
from train.reports.tables import plain_table

OURS = "Pursuit"
"""The simulator by itself, in the file of the other libraries."""
Row = dict[str, Any]


def speeds(rows: list[Row]) -> dict[str, float]:
    """The median steps per second of everything measured, over turns."""
    measured = grouped(rows, "what").items()
    return {what: median(row["steps_per_second"] for row in own) for what, own in measured}


def speed(value: float) -> str:
    """As text; large speeds in millions."""
    return f"{value / 1e6:.1f} M" if value >= 1e6 else f"{value:,.0f}"


def ratio(value: float) -> str:
    """As text; two digits, or without a fraction."""
    return f"{value:,.0f} ×" if value >= 9.95 else f"{value:.2g} ×"


def peers(rows: list[Row]) -> list[Row]:
    """Every other environment beside ours, one game at a time and in a batch."""
    found = []
    for (peer, task), own in grouped(rows, "peer", "task").items():
        if peer != OURS:
            known = speeds(own)
            line: Row = {"environment": peer, "what is alike": task}
            line["steps/s"] = speed(known["peer"])
            for name, what in (("one game", "one game"), ("a batch", "batch")):
                here = known.get(what)
                line[f"ours, {name}"] = "" if here is None else speed(here)
                line[f"ratio, {name}"] = "" if here is None else ratio(here / known["peer"])
            found.append(line)
    return found


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    rows = read_table(data / "peers.csv")
    ours = speeds([row for row in rows if row["peer"] == OURS])
    alone = [
        {"with": what, "million steps/s": f"{value / 1e6:.1f}"} for what, value in ours.items()
    ]
    heads = {f"ratio, {name}": "ratio" for name in ("one game", "a batch")}
    return {
        "simulator": plain_table(alone).markdown(),
        "peers": plain_table(peers(rows), heads).markdown(),
        "idle": plain_table(peers(read_table(data / "peers_idle.csv")), heads).markdown(),
    }
