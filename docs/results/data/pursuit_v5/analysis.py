"""Tables of docs/results/pursuit_v5.md, from the runs of make_rows.py and published curves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from train.experiments.committed import grouped, read_table
from train.experiments.statistics import mean_interval
from train.reports.tables import plain_table

NAMES = {
    "ippo": "IPPO, the preset",
    "imitation": "the same, imitating `gathering` at first",
    "sb3": "PPO of Stable-Baselines3 with SuperSuit",
    "gathering": "`GatheringTeam`, the same windows",
    "astar": "A* chasers, which see everything",
    "random": "random",
}
STEPS = {
    "the preset": {},
    "shared rewards": {"rewards": "pursuit_v5"},
    "windows divided by 30": {"observation": "pursuit_v5"},
    "without the agent's number": {"agent_id": False},
    "discount 0.95, lambda 0.8": {"gamma": 0.95, "gae_lambda": 0.8},
    "512 games at once, minibatches of 1,024": {"num_games": 512, "minibatch_size": 1024},
    "learning rate 0.002": {"learning_rate": 0.002},
    "entropy bonus 0.003": {"entropy_coef": 0.003},
    "`--imitate gathering`": {"imitate": "gathering", "imitate_frames": 4_000_000},
}
"""The settings of pilots that change one thing in the preset."""
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


def runs(data: Path) -> str:
    """A row for every learner and its seconds."""
    rows = sorted(read_table(data / "runs.csv"), key=lambda row: [*NAMES].index(row["learner"]))
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


def pilots(data: Path) -> str:
    """What each change of the preset costs or brings."""
    rows, found = read_table(data / "pilots.csv"), []
    for name, how in STEPS.items():
        own = [row for row in rows if json.loads(row["settings"]) == how]
        places = grouped(own, "played_in")
        values = {place: [row["mean_return"] for row in those] for place, those in places.items()}
        found.append({
            "change": name,
            "returns": ", ".join(f"{value:.0f}" for value in values["pettingzoo"]),
            "greedy": ", ".join(f"{value:.0f}" for value in values["pettingzoo, greedy"]),
            "million agent steps": f"{mean_of(places['pettingzoo'], 'agent_steps') / 1e6:.1f}",
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
    return {"runs": runs(data), "pilots": pilots(data), "published": published(data)}
