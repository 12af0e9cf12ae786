"""What the study of self-play by mixed share chose, what it costs, and the games that it judges.

    python tools/self_play_mixing_settings.py [--cost] [--games]

Prints the chosen settings, whether methods had stopped improving, and what they cost. `--cost`
measures processor seconds of all methods in turns, and writes costs.csv; `--games` solves the
judged games and writes games.csv, which tools/self_play_mixing.py reads.
"""

from __future__ import annotations

import argparse
from itertools import pairwise, product
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
import torch
from self_play_mixing import DATA, MATRIX, Row, markdown, rows_of
from train.experiments.halving import score

from scripted_agents.games import equilibrium, load_game, mixed_share, nash_conv
from scripted_agents.games.episodes import return_range
from scripted_agents.games.mixing import apart, visits_of
from train.experiments.expansion import NO_SETTINGS
from train.experiments.recorded import settings_in
from train.experiments.search import Range, range_of
from train.experiments.study import StudyFile, choose_version, read_file
from train.files import read_csv, write_csv
from train.kinds import start
from train.runs.folder import SELF_PLAY
from train.self_play.parts import self_play_settings_of

FILES = ("self-play-mixing", "self-play-mixing-populations")
"""The files of the study."""
COSTS = DATA / "costs.csv"


def trials(rung: int | None = None) -> dict[str, dict[int, list[Row]]]:
    """The trials of a rung, by default the last one, by variant and number."""
    rows = rows_of("tuning")
    wanted = max(row["rung"] for row in rows) if rung is None else rung
    found: dict[str, dict[int, list[Row]]] = {}
    for row in rows:
        if row["rung"] == wanted:
            found.setdefault(row["variant"], {}).setdefault(row["trial"], []).append(row)
    return found


def chosen() -> dict[str, list[Row]]:
    """By method the runs of the trial that was chosen: all of them are complete."""
    found = {}
    for method, own in trials().items():
        whole = [n for n in own if all(row["status"] == "complete" for row in own[n])]
        found[method] = own[min(whole, key=lambda number: (score(own[number]), number))]
    return found


def settings_of(row: Row) -> Row:
    """The settings of a trial."""
    names = [name for name in settings_in([*row]) if name not in ("game", "variant", *NO_SETTINGS)]
    return {name: row[name] for name in names if row[name] is not None}


def near_ends(method: str, row: Row) -> str:
    """The chosen numbers within a tenth of the end of their range, on its scale, and the first or
    last of at least three choices."""
    found = []
    for file_name in FILES:
        tuning = read_file(file_name, "ablation", StudyFile)[1].tuning
        space = {} if tuning is None else tuning.space.get(method, {})
        for name, given in space.items():
            form, value = range_of(name, given), row[name]
            if isinstance(form, Range):
                ends, scale = (form.low, form.high), np.log if form.scale == "log" else float
                low, high, place = (float(scale(each)) for each in (*ends, value))
                near = not 0.1 <= (place - low) / (high - low) <= 0.9
            else:
                ends = form.choices[0], form.choices[-1]
                near = len(form.choices) > 2 and value in ends
            if near:
                found.append(f"{name} {value:g} in {ends[0]:g} to {ends[1]:g}")
    return ", ".join(found)


def stopped() -> list[Row]:
    """Of every method on how many tuning games twice the frames do not lower NashConv + `LEAST` of
    its chosen setting below 80 %, between the last two rungs."""
    last = max(row["rung"] for row in rows_of("tuning"))
    before, found = trials(last - 1), []
    for method, rows in chosen().items():
        earlier = {row["game"]: row for row in before[method][rows[0]["trial"]]}
        ends = [score([row]) - score([earlier[row["game"]]]) for row in rows]
        falls = sum(end < np.log(0.8) for end in ends)
        line: Row = {"method": method, "frames": rows[0]["budget_frames"], "games": len(ends)}
        line |= {
            "stopped": len(ends) - falls,
            "of these rises": sum(e > np.log(1.25) for e in ends),
        }
        found.append(line)
    return found


def tables() -> str:
    """The tables of the page: a column for every method, and a row for every setting."""
    best = {name: settings_of(own[0]) for name, own in chosen().items()}
    names = dict.fromkeys(name for settings in best.values() for name in settings)
    rows = [
        {"setting": name} | {m: f"{own.get(name, '')}" for m, own in best.items()} for name in names
    ]
    near = [
        f"{name}: {found}" for name, own in chosen().items() if (found := near_ends(name, own[0]))
    ]
    ends = f"Near the end of a range: {'; '.join(near) or 'none'}."
    spent: list[Row] = [
        {"method": row["method"], "seconds": float(row["seconds"])} for row in read_csv(COSTS)
    ]
    cost = "Processor seconds of a million frames on one core of an AMD EPYC, with these settings:"
    return "\n\n".join([markdown(rows), ends, markdown(stopped()), cost, markdown(spent)])


def costs(frames: int = 300_000, turns: int = 3) -> list[Row]:
    """Processor seconds of a million frames of every method with its chosen settings, on a core:
    medians over turns and over a game of each stratum of the short version."""

    torch.set_num_threads(1)
    best, taken = chosen(), dict[str, list[float]]()
    variants = {}
    for name in FILES:
        _, file = read_file(name, "ablation", StudyFile)
        like = file.tuning.like if file.tuning else {}
        for variant in file.variants or ():
            rows = best.get(like.get(variant["name"], variant["name"]))
            tuned = settings_of(rows[0]) if rows else {}
            variants[variant["name"]] = {**(file.settings or {}), **tuned, **variant}
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
    _, file = read_file(FILES[0], "ablation", StudyFile)
    games = [name for name in file.full.grid["game"] if not name.startswith(MATRIX)]  # type: ignore[union-attr, index]
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


def main() -> None:
    """Print the tables; or write costs.csv or games.csv."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cost", action="store_true", help="measure seconds, and write costs.csv")
    parser.add_argument("--games", action="store_true", help="solve the games, and write games.csv")
    given = parser.parse_args()
    if given.games:
        measure_games()
    elif given.cost:
        write_csv(COSTS, costs())
    else:
        print(tables())


if __name__ == "__main__":
    main()
