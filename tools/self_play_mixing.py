"""The analysis of the study of self-play by mixed share: tables and figures of its page.

    python tools/self_play_mixing.py [--tuning] [--cost]

It reads runs.csv and tuning.csv in docs/results/data/self_play_mixing/, prints the tables of
docs/results/self_play_mixing.md and draws its figures. A test compares the page with
these numbers.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np
import torch
from scipy.stats import ttest_1samp

from train.experiments.expansion import NO_SETTINGS
from train.experiments.halving import score
from train.experiments.recorded import read_recorded, settings_in
from train.experiments.statistics import holm, mean_interval
from train.experiments.study import StudyFile, choose_version, read_file

DATA = Path(__file__).parents[1] / "docs" / "results" / "data" / "self_play_mixing"
LEAST = 1e-3
"""Added to NashConv, in shares of the range of returns."""
STRATA = (("0", 0.0), ("below 1 %", 0.01), ("1 to 5 %", 0.05), ("above 5 %", 1.0))
"""By name the largest mixed share of a stratum."""
PPO, MMD = "ppo", "mmd"
RIVALS = ("ppo with momentum", "ppo by default", MMD, "rnad", "pfsp")
"""The methods on all games, but for PPO."""
POPULATIONS = ("psro", "nfsp")
"""The methods on 14 games."""
COLUMNS = {"ppo by default": "nash_conv_average_likely"}
"""The columns of NashConv that is judged, other than `PLAYED`."""
PLAYED = "played_nash_conv"
MATRIX = "rock_paper_scissors"
"""Matrix games are shown, and are not part of the analysis."""
FILES = ("self-play-mixing", "self-play-mixing-populations")
"""The files of the study."""
RESAMPLES = 10_000
Row = dict[str, Any]
Logs = dict[str, float]


def rows_of(name: str = "runs") -> list[Row]:
    """The rows of a file."""
    return [*read_recorded(DATA / f"{name}.csv").values()]


def judged() -> list[Row]:
    """The judged runs, without those of matrix games."""
    return [row for row in rows_of() if not row["game"].startswith(MATRIX)]


def shares(rows: Iterable[Row]) -> dict[str, float]:
    """The mixed share of every game, ascending."""
    found = {row["game"]: row["mixed_share"] for row in rows if row["status"] == "complete"}
    return dict(sorted(found.items(), key=lambda item: item[1]))


def stratum(share: float) -> str:
    """The name of the stratum of a mixed share."""
    return next(name for name, most in STRATA if share <= most or (share < 1e-9 and most == 0.0))


def logs_of(rows: Iterable[Row], method: str, column: str = "") -> Logs:
    """By game the mean over seeds of log(NashConv + `LEAST`), NashConv in shares of the range; of a
    failed run it is the whole range."""
    name = column or COLUMNS.get(method, PLAYED)
    found: dict[str, list[float]] = {}
    for row in rows:
        if row["variant"] == method:
            share = row[name] / row["payoff_range"] if row["status"] == "complete" else 1.0
            found.setdefault(row["game"], []).append(float(np.log(share + LEAST)))
    return {game: fmean(values) for game, values in found.items()}


def ratios(one: Logs, other: Logs) -> Logs:
    """By game the difference of two logarithms, where both are known."""
    return {game: one[game] - other[game] for game in one if game in other}


def slope(rows: Sequence[Row]) -> tuple[float, float, float, int]:
    """The primary endpoint: the slope over games of log(PPO / MMD) on the mixed share, with a 95 %
    bootstrap interval over games, and the number of games."""
    own, share = ratios(logs_of(rows, PPO), logs_of(rows, MMD)), shares(rows)
    x, y = np.array([share[game] for game in own]), np.array([*own.values()])
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(x), size=(RESAMPLES, len(x)))

    def fitted(x: Any, y: Any) -> Any:
        away = x - x.mean(axis=-1, keepdims=True)
        return (away * y).sum(axis=-1) / (away**2).sum(axis=-1)

    low, high = np.percentile(fitted(x[drawn], y[drawn]), [2.5, 97.5])
    return float(fitted(x, y)), float(low), float(high), len(x)


def comparisons(rows: Sequence[Row]) -> list[Row]:
    """The secondary comparisons: "what", "games", the ratio of NashConv with its interval, and p of
    a t-test of its logarithm over games, corrected together (Holm)."""
    share, ppo = shares(rows), logs_of(rows, PPO)
    lines: list[tuple[str, list[float]]] = []
    for what, column in (
        ("average of weights / last weights", "nash_conv_last"),
        ("threshold / no threshold", PLAYED),
    ):
        mine = "nash_conv_average_likely" if column == PLAYED else PLAYED
        own = ratios(logs_of(rows, PPO, mine), logs_of(rows, PPO, column))
        lines.append((f"ppo: {what}", [*own.values()]))
    own = ratios(ppo, logs_of(rows, RIVALS[0]))
    lines.append(("ppo: no momentum / momentum", [*own.values()]))
    for method in RIVALS[1:]:
        own = ratios(logs_of(rows, method), ppo)
        for name, _ in STRATA:
            part = [value for game, value in own.items() if stratum(share[game]) == name]
            lines.append((f"{method} / ppo, mixed share {name}", part))
    for method in POPULATIONS:
        lines.append((f"{method} / ppo", [*ratios(logs_of(rows, method), ppo).values()]))
    found: list[Row] = []
    for what, values in lines:
        if len(values) < 2:
            continue
        ends = np.exp([fmean(values), *mean_interval([values])]).tolist()
        p = float(ttest_1samp(values, 0.0).pvalue)
        found.append({"what": what, "games": len(values), "ratio": ends, "p": p})
    for row, p in zip(found, holm([row["p"] for row in found]), strict=True):
        row["p_holm"] = p
    return found


def by_stratum(rows: Sequence[Row]) -> list[Row]:
    """Of every method the geometric mean over games of NashConv, in per cent of the range, by
    stratum; and its games."""
    share, found = shares(rows), []
    for method in (PPO, *RIVALS, *POPULATIONS):
        logs = logs_of(rows, method)
        if not logs:
            continue
        line: Row = {"method": method, "games": len(logs)}
        for name, _ in STRATA:
            part = [value for game, value in logs.items() if stratum(share[game]) == name]
            line[name] = 100.0 * (float(np.exp(fmean(part))) - LEAST) if part else None
        found.append(line)
    return found


def by_game(rows: Sequence[Row]) -> list[Row]:
    """Of every game the mixed share and NashConv of all methods, in per cent of the range."""
    found = []
    for game, share in shares(rows).items():
        line: Row = {"game": game, "share": 100.0 * share}
        for method in (PPO, *RIVALS, *POPULATIONS):
            logs = logs_of(rows, method)
            value = logs.get(game)
            line[method] = None if value is None else 100.0 * (float(np.exp(value)) - LEAST)
        found.append(line)
    return found


def markdown(rows: Sequence[Row]) -> str:
    """Rows as a table; numbers with three digits."""
    if not rows:
        return ""

    def cell(value: object) -> str:
        if isinstance(value, list):
            return f"{value[0]:.2f} [{value[1]:.2f}, {value[2]:.2f}]"
        if isinstance(value, float):
            return f"{value:.3g}"
        return "" if value is None else str(value)

    heads = [*dict.fromkeys(name for row in rows for name in row)]
    cells = ([cell(row.get(name)) for name in heads] for row in rows)
    lines = [heads, ["---"] * len(heads), *cells]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


# -- tuning and cost -------------------------------------------------------------------------------


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
    """By method the runs of the trial that was chosen."""
    return {method: min(own.values(), key=score) for method, own in trials().items()}


def settings_of(row: Row) -> Row:
    """The settings of a trial."""
    names = [name for name in settings_in([*row]) if name not in ("game", "variant", *NO_SETTINGS)]
    return {name: row[name] for name in names if row[name] is not None}


def stopped() -> list[Row]:
    """Of every method on how many tuning games twice the frames do not lower NashConv + `LEAST` of
    its chosen setting below 80 %, between the last two rungs."""
    last = max(row["rung"] for row in rows_of("tuning"))
    before, found = trials(last - 1), []
    for method, rows in chosen().items():
        earlier = {row["game"]: row for row in before[method][rows[0]["trial"]]}
        ends = [score([row]) - score([earlier[row["game"]]]) for row in rows]
        still = sum(end < np.log(0.8) for end in ends)
        found.append({"method": method, "frames": rows[0]["budget_frames"], "games": len(ends),
                      "stopped": len(ends) - still})  # fmt: skip
    return found


def costs(frames: int = 300_000, turns: int = 3) -> list[Row]:
    """Processor seconds of a million frames of every method with its chosen settings, on a core:
    medians over turns and over a game of each stratum of the short version."""
    from tempfile import TemporaryDirectory

    from train.kinds import start
    from train.runs.folder import SELF_PLAY
    from train.self_play.parts import self_play_settings_of

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


# -- figures ---------------------------------------------------------------------------------------


def draw_ratios(path: Path, rows: Sequence[Row]) -> None:
    """The ratio of PPO to MMD over the mixed share, a point for each game."""
    from matplotlib import pyplot

    own, share = ratios(logs_of(rows, PPO), logs_of(rows, MMD)), shares(rows)
    x = np.array([100.0 * share[game] for game in own])
    y = np.exp([*own.values()])
    figure, axis = pyplot.subplots(figsize=(7.2, 4.2), layout="constrained")
    axis.axhline(1.0, color="0.6", lw=1.0)
    mazes = np.array([game.startswith("maze_game") for game in own])
    axis.plot(x[mazes], y[mazes], "o", color="#0072b2", label="mazes")
    axis.plot(x[~mazes], y[~mazes], "s", color="#d55e00", label="other games")
    axis.set_xscale("symlog", linthresh=0.1)
    axis.set_xlim(-0.02, 120.0)
    axis.set_xticks([0, 0.1, 1, 5, 10, 50, 100], ["0", "0.1", "1", "5", "10", "50", "100"])
    axis.set_yscale("log")
    axis.set_xlabel("mixed share of the game (%)")
    axis.set_ylabel("NashConv of PPO / NashConv of MMD")
    axis.legend(frameon=False)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def draw_curves(path: Path, rows: Sequence[Row]) -> None:
    """NashConv over frames of all methods in one game of each stratum; medians over seeds."""
    from matplotlib import pyplot

    share = shares(rows)
    populations = {row["game"] for row in rows if row["variant"] == POPULATIONS[0]}
    figure, axes = pyplot.subplots(2, 2, figsize=(9.0, 6.4), layout="constrained", sharex=True)
    for (name, _), axis in zip(STRATA, axes.ravel(), strict=True):
        games = [game for game, own in share.items() if stratum(own) == name]
        game = next((game for game in games if game in populations), games[0])
        for number, method in enumerate((PPO, *RIVALS, *POPULATIONS)):
            own = [row for row in rows if (row["game"], row["variant"]) == (game, method)]
            own = [row for row in own if row["status"] == "complete"]
            curves = [[float(value) for value in row["curve"].split()] for row in own]
            if not curves:
                continue
            length = min(map(len, curves))
            middle = [median(values) for values in zip(*(c[:length] for c in curves), strict=True)]
            frames = np.linspace(0.0, own[0]["frames"] / 1e6, length)
            low = 100.0 * np.array(middle) / own[0]["payoff_range"]
            axis.plot(frames, low, label=method, lw=1.6, color=f"C{number}")
        axis.set_yscale("log")
        axis.set_title(f"{game}\nmixed share {100.0 * share[game]:.2g} %", fontsize=8)
    axes[0, 0].legend(frameon=False, fontsize=8)
    for axis in axes[1]:
        axis.set_xlabel("million frames")
    for axis in axes[:, 0]:
        axis.set_ylabel("NashConv (% of the range)")
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def main() -> None:
    """Print the tables, and draw the figures; or print tuning or costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tuning", action="store_true", help="print what was chosen")
    parser.add_argument("--cost", action="store_true", help="measure processor seconds, in turns")
    given = parser.parse_args()
    if given.tuning:
        print(markdown([{"method": name, **settings_of(own[0])} for name, own in chosen().items()]))
        print(markdown(stopped()))
        return
    if given.cost:
        print(markdown(costs()))
        return
    rows = judged()
    print(
        "slope of log(PPO / MMD) on the mixed share: {:.2f} [{:.2f}, {:.2f}], {} games".format(
            *slope(rows)
        )
    )
    matrix = [row for row in rows_of() if row not in rows]
    for table in (by_stratum(rows), comparisons(rows), by_game(rows), by_game(matrix)):
        print(f"\n{markdown(table)}")
    draw_ratios(DATA / "ratios.png", rows)
    draw_curves(DATA / "curves.png", rows)


if __name__ == "__main__":
    main()
