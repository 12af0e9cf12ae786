"""PPO and MMD with exchanged entropy bonuses: tables of docs/results/self_play_mixing.md.

    python tools/self_play_entropy.py

It reads docs/results/data/self_play_entropy/runs.csv and the runs of seed 0 of the study.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean

import numpy as np
from self_play_mixing import (
    DATA,
    LEAST,
    MMD,
    PPO,
    STRATA,
    Logs,
    Row,
    bootstrapped,
    judged,
    logs_of,
    markdown,
    ratio_at,
    ratios,
    shares,
    stratum,
)

from train.experiments.recorded import read_recorded

EXCHANGED = DATA.parent / "self_play_entropy" / "runs.csv"


def by_stratum(rows: Sequence[Row]) -> list[Row]:
    """PPO and MMD, each with the entropy bonus of both; of seed 0 on all games: NashConv by stratum
    in per cent of the range."""
    share, found = shares(rows), []
    for (method, bonus), logs in with_bonuses(rows).items():
        line: Row = {"method": method, "entropy bonus of": bonus}
        for name, _ in STRATA:
            part = [value for game, value in logs.items() if stratum(share[game]) == name]
            line[name] = 100.0 * (float(np.exp(fmean(part))) - LEAST)
        found.append(line)
    return found


def with_bonuses(rows: Sequence[Row]) -> dict[tuple[str, str], Logs]:
    """By method and whose bonus it has: its logarithms by game."""
    own = [row for row in rows if row["seed"] == 0]
    own += read_recorded(EXCHANGED).values()
    names = {(PPO, PPO): PPO, (PPO, MMD): "ppo, entropy of mmd",
             (MMD, PPO): "mmd, entropy of ppo", (MMD, MMD): MMD}  # fmt: skip
    return {pair: logs_of(own, name) for pair, name in names.items()}


def slopes(rows: Sequence[Row]) -> list[Row]:
    """The slopes on the mixed share of the ratios between the four of `by_stratum`."""
    logs, share, found = with_bonuses(rows), shares(rows), []
    for one, other, what in (
        ((PPO, PPO), (MMD, MMD), "PPO / MMD, each with its own bonus"),
        ((PPO, PPO), (MMD, PPO), "PPO / MMD, both with the bonus of PPO"),
        ((PPO, MMD), (MMD, MMD), "PPO / MMD, both with the bonus of MMD"),
        ((PPO, PPO), (PPO, MMD), "PPO, bonus of PPO / bonus of MMD"),
        ((MMD, PPO), (MMD, MMD), "MMD, bonus of PPO / bonus of MMD"),
    ):
        own = ratios(logs[one], logs[other])
        line = {"what": what, "games": len(own), "slope": bootstrapped(own, share)}
        found.append(line | {"ratio at 0.5": ratio_at(own, share, 0.5)})
    return found


def tables() -> dict[str, str]:
    """The tables as Markdown, by title."""
    rows = judged()
    found = {"NashConv by stratum, % of the range": by_stratum(rows), "Slopes": slopes(rows)}
    return {title: markdown(table) for title, table in found.items()}


def main() -> None:
    """Print the tables."""
    for title, table in tables().items():
        print(f"\n{title}\n\n{table}")


if __name__ == "__main__":
    main()
