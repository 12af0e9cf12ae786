"""Tables of docs/results/pursuit_v5.md, from the runs of make_rows.py and published curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from train.experiments.committed import grouped, read_table
from train.experiments.statistics import mean_interval
from train.reports.tables import plain_table

NAMES = {
    "ippo": "IPPO, the preset",
    "imitation": "the same, imitating GatheringTeam at first",
    "ippo-local": "IPPO, own rewards",
    "mappo": "MAPPO, the preset",
    "sb3": "PPO of Stable-Baselines3 with SuperSuit",
    "gathering": "GatheringTeam, the same windows",
    "astar": "A* chasers, which see everything",
    "random": "random",
}
URGENCY = 0.8
"""What the eight agents lose together in a step."""
Row = dict[str, Any]


def mean_of(rows: Sequence[Row], name: str) -> float:
    """The mean of a column."""
    return fmean(row[name] for row in rows)


def returns_of(rows: Sequence[Row]) -> str:
    """The mean return over runs with Student's interval, where there are several."""
    values = [row["mean_return"] for row in rows]
    text = f"{fmean(values):.1f}"
    if len(values) > 1:
        text += " [{:.1f}, {:.1f}]".format(*mean_interval([values]))
    return text


def runs(path: Path) -> str:
    """A row for every learner and its seconds, by runs in PettingZoo."""
    rows = [row for row in read_table(path) if row["played_in"].startswith("pettingzoo")]
    rows.sort(key=lambda row: [*NAMES].index(row["learner"]))
    found = []
    for (learner, seconds), own in grouped(rows, "learner", "seconds").items():
        places = grouped(own, "played_in")
        shown, greedy = places["pettingzoo"], places.get("pettingzoo, greedy")
        total = mean_of(shown, "total_return") + URGENCY * mean_of(shown, "mean_steps")
        steps = mean_of(shown, "agent_steps") / 1e6
        found.append({
            "team": NAMES[learner],
            "minutes": f"{seconds / 60:.0f}" if seconds else "",
            "runs": len(shown) if seconds else "",
            "return of an agent [95 %]": returns_of(shown),
            "greedy": f"{mean_of(greedy, 'mean_return'):.1f}" if greedy else "",
            "evaders caught": f"{mean_of(shown, 'mean_caught'):.1f}",
            "steps": f"{mean_of(shown, 'mean_steps'):.0f}",
            "of all agents, without urgency": f"{total:.0f}",
            "million agent steps": f"{steps:.1f}" if steps else "",
        })  # fmt: skip
    return plain_table(found).markdown()


def published(data: Path) -> str:
    """The highest points of published learning curves."""
    found: list[Row] = [
        {
            "method": row["method"],
            "highest mean of all agents": f"{row['best_mean']:.0f}",
            "after episodes": row["episodes"] and f"{row['episodes']:,}",
            "hours": row["hours"] and f"{row['hours']:.1f}",
        }
        for row in read_table(data / "published.csv")
    ]
    return plain_table(found).markdown()


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    found = {name: runs(data / f"{name}.csv") for name in ("runs", "former")}
    return {**found, "published": published(data)}
