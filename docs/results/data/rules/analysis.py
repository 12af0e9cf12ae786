"""Tables of docs/results/rules.md and the README here, from the rows of make_rows.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from train.experiments.committed import grouped, read_table
from train.reports.tables import plain_table

Row = dict[str, Any]


def share_text(share: float) -> str:
    """A share in per cent; with a digit behind the point unless it is 0 or 1."""
    return f"{100.0 * share:.{int(0 < share < 1)}f}"


def in_short(rows: list[Row]) -> list[Row]:
    """By order of moves and rule the least and the greatest share of forced captures of all mazes
    that have a row, for one to four chasers."""
    found = []
    for order, name in {"at once": "forced", "in turns": "turns_forced"}.items():
        for rule, own in grouped(rows, "rule").items():
            line: Row = {"moves": order, "rule": rule}
            for count in range(1, 5):
                shares = [r[name] for r in own if r["chasers"] == count and r[name] is not None]
                ends = dict.fromkeys(map(share_text, (min(shares), max(shares)))) if shares else ()
                text = f"{' to '.join(ends)} %" if shares else ""
                line["1 chaser" if count == 1 else f"{count} chasers"] = text
            found.append(line)
    return found


def capture(rows: list[Row], share: str, value: str, digits: int) -> list[Row]:
    """By maze and rule, for one to four chasers, the share of forced captures and a value."""
    found = []
    for (maze, rule), own in grouped(rows, "maze", "rule").items():
        line: Row = {"maze": maze, "rule": rule}
        by_team = {row["chasers"]: row for row in own}
        for count in range(1, 5):
            row, text = by_team.get(count, {}), ""
            if row.get(share) is not None:
                text = f"{share_text(row[share])} %, {row[value]:.{digits}f}"
            line["1 chaser" if count == 1 else f"{count} chasers"] = text
        found.append(line)
    return found


def classical(rows: list[Row]) -> list[Row]:
    """The classical domain."""
    return [
        {
            "moves": row["order"],
            "moves of the prey": row["prey_moves"],
            "optimum, mean": f"{row['mean_steps']:.3f}",
            "worst start": f"{row['worst_start']:.3f}",
            "scripted team, ± 95 %": f"{row['scripted_steps']:.2f} ± {row['scripted_ci95']:.2f}",
        }
        for row in rows
    ]


def escape(rows: list[Row]) -> list[Row]:
    """Games with exits."""
    heads = {
        "best team against scripted evader": "best_chasers",
        "equilibrium": "equilibrium",
        "scripted team against scripted evader": "scripted",
        "best evader against scripted team": "best_evader",
    }
    return [
        {"chasers": row["chasers"], "exits": row["exits"]}
        | {head: f"{row[name]:.3f}" for head, name in heads.items()}
        for row in rows
    ]


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    rows = {n: read_table(data / f"{n}.csv") for n in ("capture", "classical", "escape")}
    found = {
        "forced captures in short": in_short(rows["capture"]),
        "moves at once": capture(rows["capture"], "forced", "mean_steps", 2),
        "moves in turns": capture(rows["capture"], "turns_forced", "turns_rounds", 0),
        "classical domain": classical(rows["classical"]),
        "exits": escape(rows["escape"]),
    }
    return {title: plain_table(table).markdown() for title, table in found.items()}
