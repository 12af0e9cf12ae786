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
    "ippo": "IPPO",
    "mappo": "MAPPO",
    "sb3": "Stable-Baselines3 with SuperSuit",
    "ippo-local": "IPPO, own rewards",
    "astar": "A* chasers, which see everything",
    "random": "random",
}
URGENCY = 0.8
"""What the eight agents lose together in a step."""
Row = dict[str, Any]


def mean_of(rows: Sequence[Row], name: str) -> float:
    """The mean of a column."""
    return fmean(row[name] for row in rows)


def runs(data: Path) -> str:
    """A row for every learner and its seconds."""
    found, usual = list[Row](), set[str]()
    for (learner, seconds), own in grouped(
        read_table(data / "former.csv"), "learner", "seconds"
    ).items():
        places = grouped(own, "played_in")
        inside, here = (places.get(place, []) for place in ("pettingzoo", "simulator"))
        shown, returns = inside or here, [row["mean_return"] for row in inside]
        text = f"{fmean(returns):.1f}" if inside else ""
        if len(returns) > 1:
            text += " [{:.1f}, {:.1f}]".format(*mean_interval([returns]))
        again = f", {seconds:.0f} s" if learner in usual else ""
        usual.add(learner)
        total = mean_of(shown, "total_return") + URGENCY * mean_of(shown, "mean_steps")
        steps = mean_of(shown, "agent_steps") / 1e6
        found.append({
            "learner": NAMES[learner] + again,
            "return of an agent [95 %]": text,
            "in our simulator": f"{mean_of(here, 'mean_return'):.1f}" if here else "",
            "of all agents, without urgency": f"{total:.0f}",
            "evaders caught": f"{mean_of(shown, 'mean_caught'):.1f}",
            "steps": f"{mean_of(shown, 'mean_steps'):.0f}",
            "million agent steps": f"{steps:.2f}" if steps else "",
        })  # fmt: skip
    return plain_table(found).markdown()


def published(data: Path) -> str:
    """What the tutorial of the environment publishes."""
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
    return {"runs": runs(data), "published": published(data)}
