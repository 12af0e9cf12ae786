"""Tables of docs/results/pursuit_v5.md, from the runs of make_rows.py and published curves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from textwrap import fill
from typing import Any

from scipy.stats import ttest_1samp, ttest_ind

from train.experiments.committed import grouped, read_table
from train.experiments.statistics import NAN, difference_interval, holm, mean_interval
from train.reports.figures import BLUE, GREY, ORANGE, PlottedEstimate, draw_intervals
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
CHANGES: dict[str, dict[str, Any]] = {
    "none": {},
    "shared rewards": {"rewards": "pursuit_v5"},
    "windows divided by 30": {"observation": "pursuit_v5"},
    "no number of the agent": {"agent_id": False},
    "learning rate 0.002": {"learning_rate": 0.002},
    "entropy bonus 0.003": {"entropy_coef": 0.003},
    "discount 0.99": {"gamma": 0.99},
    "lambda 0.8": {"gae_lambda": 0.8},
    "minibatches of 16,384": {"minibatch_size": 16384},
    "shared layers": {"shared": True},
}
"""What pilots change in the preset, one at a time."""
URGENCY = 0.8
"""What the eight agents lose together in a step."""
Row = dict[str, Any]


def order(row: Row) -> tuple[int, float]:
    """The place of a run in tables and figures."""
    return [*NAMES].index(row["learner"]), row["seconds"]


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
    rows.sort(key=order)
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


def endpoints(path: Path) -> str:
    """The three endpoints of the protocol, with two-sided tests of Student and of Welch."""
    rows = [row for row in read_table(path) if row["played_in"] == "pettingzoo"]
    values = {
        key: [row["mean_return"] for row in own]
        for key, own in grouped(rows, "learner", "seconds").items()
    }
    ten, hour, other = (values[key] for key in (("ippo", 600), ("ippo", 3600), ("sb3", 600)))
    found: list[tuple[str, float, tuple[float, float], float]] = [
        (f"return of the preset after {minutes} minutes, above {least}", fmean(own),
         mean_interval([own]), float(ttest_1samp(own, least).pvalue))
        for minutes, own, least in ((10, ten, 45), (60, hour, 81))
    ]  # fmt: skip
    p = float(ttest_ind(ten, other, equal_var=False).pvalue)
    apart = difference_interval([ten], [other])
    found.append(("preset less Stable-Baselines3, 10 minutes", fmean(ten) - fmean(other), apart, p))
    ps = holm([p for *_, p in found])
    return plain_table([
        {"endpoint": name, "estimate [95 %]": "{:.1f} [{:.1f}, {:.1f}]".format(value, *ends),
         "p (Holm)": f"{p:.2g}"}
        for (name, value, ends, _), p in zip(found, ps, strict=True)
    ]).markdown()  # fmt: skip


def changes(path: Path) -> str:
    """The returns of pilots, a number for each run."""
    rows, found = [row for row in read_table(path) if row["seconds"] == 120], []
    for name, change in CHANGES.items():
        own = [row for row in rows if json.loads(row["settings"]) == change]
        places = grouped(own, "played_in")
        shown = {
            head: ", ".join(f"{row['mean_return']:.0f}" for row in places.get(place, []))
            for head, place in (("returns", "pettingzoo"), ("greedy", "pettingzoo, greedy"))
        }
        steps = mean_of(places["pettingzoo"], "agent_steps") / 1e6 if own else 0.0
        found.append({"change": name, **shown, "million agent steps": f"{steps:.1f}"})
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


def figures(data: Path, out: Path) -> None:
    """The returns of all teams, a dot for their mean and a stroke for each run."""
    rows = [row for row in read_table(data / "runs.csv") if row["played_in"] == "pettingzoo"]
    rows.sort(key=order)
    found = []
    for (learner, seconds), own in grouped(rows, "learner", "seconds").items():
        values = [row["mean_return"] for row in own]
        ends = mean_interval([values]) if len(values) > 1 else (NAN, NAN)
        label = NAMES[learner] + (f", {seconds / 60:.0f} minutes" if seconds else "")
        color = ORANGE if learner == "sb3" else BLUE if seconds else GREY
        found.append(PlottedEstimate(fill(label, 30), fmean(values), *ends, values, color))
    label = "return of an agent in PettingZoo's pursuit_v5"
    draw_intervals(out / "returns.png", {label: ("linear", found)}, "", also="png")


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    found = {name: runs(data / f"{name}.csv") for name in ("runs", "former")}
    found["endpoints"] = endpoints(data / "runs.csv")
    if (data / "pilots.csv").exists():
        found["changes"] = changes(data / "pilots.csv")
    return {**found, "published": published(data)}
