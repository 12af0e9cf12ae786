"""Measure what the methods of this study cost, and what its games are.

    python docs/results/data/self_play_mixing/make_rows.py (costs | games)

"costs" measures processor seconds of all methods in turns, and writes costs.csv; "games" solves the
judged games, and writes games.csv.
"""

from __future__ import annotations

import sys
from itertools import pairwise, product
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from scripted_agents.games import equilibrium, load_game, mixed_share, nash_conv
from scripted_agents.games.episodes import return_range
from scripted_agents.games.mixing import apart, visits_of
from train.experiments.analysis import module_at
from train.experiments.committed import tried_settings
from train.experiments.recorded import read_recorded
from train.experiments.study import StudyFile, choose_version, read_file
from train.files import write_csv
from train.kinds import start
from train.runs.folder import SELF_PLAY
from train.self_play.parts import self_play_settings_of

DATA = Path(__file__).parent
STUDY = module_at(DATA / "analysis.py")
Row = dict[str, Any]


def costs(frames: int = 300_000, turns: int = 3) -> list[Row]:
    """Processor seconds of a million frames of every method with its chosen settings, on a core:
    medians over turns and over a game of each stratum of the short version."""
    torch.set_num_threads(1)
    tuning = [*read_recorded(DATA / "tuning.csv").values()]
    best, taken = STUDY.chosen(tuning), dict[str, list[float]]()
    variants = {}
    for name in STUDY.FILES:
        _, file = read_file(name, "ablation", StudyFile)
        like = file.tuning.like if file.tuning else {}
        for variant in file.variants or ():
            rows = best.get(like.get(variant["name"], variant["name"]))
            tuned = tried_settings(rows[0]) if rows else {}
            variants[variant["name"]] = {**file.settings, **tuned, **variant}
    games = choose_version(file, "short").grid["game"]  # type: ignore[index]
    for _, game in product(range(turns), games):
        for name, own in variants.items():
            given = {n: value for n, value in own.items() if n != "name"}
            settings = self_play_settings_of(
                **{**given, "game": game, "frames": frames, "clock": "processor"}
            )
            with TemporaryDirectory() as folder:
                run = start(SELF_PLAY, settings, Path(folder) / "run")
                run.train(lambda run, row: None)
                taken.setdefault(name, []).append(run.seconds * 1e6 / run.trainee.frames)
    return [{"method": name, "seconds": median(values)} for name, values in taken.items()]


def measure_games() -> None:
    """Write games.csv: of every judged game its size, its value as a share of the range of returns,
    how much its equilibrium mixes, and what pure play costs.

    "weighted_gap" is the mean over the visits of equilibrium play of minimax minus maximin over
    pure actions, "purified" NashConv of the most probable actions of the equilibrium, both in
    shares of the range of returns. "scaled_range" is the range of the returns as training scales
    them, so that the largest is 1.
    """
    _, file = read_file(STUDY.FILES[0], "ablation", StudyFile)
    games = [name for name in file.full.grid["game"] if not name.startswith(STUDY.MATRIX)]  # type: ignore[union-attr, index]
    found: list[Row] = []
    for name in games:
        game = load_game(name)
        solution = equilibrium(game, 0.95)
        low, high = return_range(game, game.players[0], 0.95)
        size = high - low
        visits = visits_of(game, solution.policies, 0.95)
        gap = float(visits @ apart(game, solution.values, 0.95) / size)
        pure = {}
        for seat, player in enumerate(game.players):
            offsets, table = game.offsets(seat), np.zeros(game.offsets(seat)[-1])
            for first, last in pairwise(offsets.tolist()):
                table[first + int(solution.policies[player][first:last].argmax())] = 1.0
            pure[player] = table
        found.append({
            "game": name, "states": game.num_states, "joint_actions": len(game.choices),
            "most_actions": max(len(row) for rows in game.actions for row in rows),
            "value": (solution.mean - low) / size,
            "mixed_share": mixed_share(game, 0.95, None, solution),
            "weighted_gap": gap, "purified": nash_conv(game, pure, 0.95).nash_conv / size,
            "scaled_range": size / max(abs(low), abs(high)),
        })  # fmt: skip
    write_csv(DATA / "games.csv", found)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["costs"]:
            write_csv(DATA / "costs.csv", costs())
        case ["games"]:
            measure_games()
        case _:
            sys.exit(__doc__)
