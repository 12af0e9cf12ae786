"""Tables and figures of docs/results/self_play_mixing.md and the READMEs here and in
../self_play_entropy: the study of self-play by mixed share.

The runs with exchanged entropy bonuses are in ../self_play_entropy/runs.csv.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations, product
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr, ttest_1samp

from train.experiments.committed import ablation_of, chosen_trials, read_table, tried_settings
from train.experiments.recorded import read_recorded
from train.experiments.search import Range, range_of
from train.experiments.statistics import holm, ratio_with_interval, regression
from train.experiments.tuning import score
from train.reports.figures import pyplot, save
from train.reports.tables import plain_table

FILES = ("self-play-mixing", "self-play-mixing-populations")
"""The files of the study."""
LEAST = 1e-3
"""Added to NashConv, in shares of the range of returns."""
STRATA = (("0", 0.0), ("below 1 %", 0.01), ("1 to 5 %", 0.05), ("above 5 %", 1.0))
"""By name the largest mixed share of a stratum."""
PPO, MMD = "ppo", "mmd"
RIVALS = ("ppo with momentum", "ppo by default", MMD, "rnad", "pfsp")
"""The methods on all games, but for PPO."""
POPULATIONS = ("psro", "nfsp")
"""The methods on 14 games."""
COLUMNS = {"ppo by default": "nash_conv_average_likely", "psro": "mixture_high"}
"""The columns of NashConv that is judged, other than `PLAYED`: of psro the upper bound."""
PLAYED = "played_nash_conv"
MATRIX = "rock_paper_scissors"
"""Matrix games are shown, and are not part of the analysis."""
FRAMES = 6_000_000
"""Of the judged runs; those of the short versions, which may be beside them, have fewer."""
RESAMPLES = 10_000
Row = dict[str, Any]
Array = NDArray[np.float64]
Logs = dict[str, float]
Properties = dict[str, Row]
"""The rows of games.csv by game."""


def judged(data: Path, matrix: bool = False) -> list[Row]:
    """The judged runs of the games of the analysis, or of the matrix games."""
    every = read_recorded(data / "runs.csv").values()
    rows = [row for row in every if row["budget_frames"] == FRAMES]
    return [row for row in rows if row["game"].startswith(MATRIX) == matrix]


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


def slope_of(own: Logs, *regressors: Logs) -> Row:
    """The slope over games of a log-ratio on the first regressor: "slope" with its interval, and
    the number of games."""
    columns = [[column[game] for game in own] for column in regressors]
    return {"games": len(own), "slope": regression([*own.values()], *columns)[0]}


def bootstrapped(own: Logs, share: Logs) -> list[float]:
    """The slope of a log-ratio on the mixed share, with its 95 % percentile interval over
    `RESAMPLES` samples of games: the primary endpoint."""
    x, y = np.array([share[game] for game in own]), np.array([*own.values()])
    drawn = np.random.default_rng(0).integers(len(x), size=(RESAMPLES, len(x)))

    def fitted(x: Array, y: Array) -> Array:
        away = x - x.mean(axis=-1, keepdims=True)
        return np.asarray((away * y).sum(axis=-1) / (away**2).sum(axis=-1))

    ends = np.percentile(fitted(x[drawn], y[drawn]), [2.5, 97.5])
    return [float(value) for value in (fitted(x, y), *ends)]


def ratio_at(own: Logs, share: Logs, where: float) -> list[float]:
    """The ratio at a mixed share on the line of least squares, with its interval by HC3."""
    constant = regression([*own.values()], [share[game] - where for game in own])[-1]
    return [float(np.exp(value)) for value in constant]


def slopes(rows: Sequence[Row], about: Properties) -> list[Row]:
    """The primary endpoint, the slope of log(PPO / MMD) on the mixed share, and how far it depends
    on games, weights and regressors."""
    own, share = ratios(logs_of(rows, PPO), logs_of(rows, MMD)), shares(rows)
    found: list[Row] = [
        {"what": "primary: bootstrap over games", "games": len(own),
         "slope": bootstrapped(own, share)},
        {"what": "primary: HC3", **slope_of(own, share)},
    ]  # fmt: skip
    for left in (1, 2):
        parts = [
            slope_of({g: v for g, v in own.items() if g not in out}, share)["slope"][0]
            for out in combinations(own, left)
        ]
        ends = [float(np.median(parts)), min(parts), max(parts)]
        what = f"without any {('one game', 'two games')[left - 1]}: median, least, largest"
        found.append({"what": what, "games": len(own) - left, "slope": ends})
    mazes = {game: value for game, value in own.items() if game.startswith("maze_game")}
    found.append({"what": "mazes only", **slope_of(mazes, share)})
    for one, other in product(("average", "last"), repeat=2):
        logs = logs_of(rows, PPO, f"nash_conv_{one}"), logs_of(rows, MMD, f"nash_conv_{other}")
        what = f"{one} weights of PPO, {other} weights of MMD"
        found.append({"what": what, **slope_of(ratios(*logs), share)})
    sizes = [
        {game: float(np.log(row[name])) for game, row in about.items()}
        for name in ("joint_actions", "most_actions")
    ]
    found.append({"what": "beside the logarithms of joint actions and of the most actions",
                  **slope_of(own, share, *sizes)})  # fmt: skip
    for name, what in (("weighted_gap", "on the gap of pure play, weighted by visits"),
                       ("purified", "on log NashConv of the purified equilibrium")):  # fmt: skip
        values = {game: row[name] for game, row in about.items()}
        if name == "purified":
            values = {game: float(np.log(value + LEAST)) for game, value in values.items()}
        found.append({"what": what, **slope_of(own, values)})
    for at in (0.0, 0.5):
        found.append({"what": f"the ratio itself at a mixed share of {at:g} (HC3)",
                      "games": len(own), "slope": ratio_at(own, share, at)})  # fmt: skip
    rho = spearmanr([share[game] for game in own], [*own.values()]).statistic
    found.append({"what": "Spearman's rank correlation", "games": len(own), "slope": float(rho)})
    return found


def contrary(rows: Sequence[Row], matrix: Sequence[Row], about: Properties) -> list[Row]:
    """What does not fit the slope, or depends on settings: slopes by HC3, geometric means of ratios
    with their intervals, and rank correlations."""
    ppo, mmd, share = logs_of(rows, PPO), logs_of(rows, MMD), shares(rows)
    own, default = ratios(ppo, mmd), logs_of(rows, RIVALS[1])
    every = [*rows, *matrix]
    above = {game: value for game, value in own.items() if stratum(share[game]) == STRATA[-1][0]}
    scaled = [about[game]["scaled_range"] for game in own]
    found: list[Row] = [
        {"what": what, "games": len(logs), "value": slope_of(logs, by)["slope"]}
        for what, logs, by in (
            ("slope of PPO / MMD, games above 5 % only", above, share),
            ("slope of PPO / MMD, with the two matrix games",
             ratios(logs_of(every, PPO), logs_of(every, MMD)), shares(every)),
            ("slope of PPO by default / MMD", ratios(default, mmd), share),
            ("slope of PPO by default / PPO", ratios(default, ppo), share),
        )
    ]  # fmt: skip
    for what, logs in (
        ("PPO / MMD, games above 5 %", above),
        ("PSRO / PPO, upper bound of PSRO", ratios(logs_of(rows, "psro"), ppo)),
        ("PSRO / PPO, lower bound of PSRO", ratios(logs_of(rows, "psro", "mixture_low"), ppo)),
    ):
        ratio = ratio_with_interval([*logs.values()])
        found.append({"what": what, "games": len(logs), "value": ratio})
    for what, by in (
        ("the mixed share", [share[game] for game in own]),
        ("the range of scaled returns", scaled),
    ):
        rho = float(spearmanr(by, [*own.values()]).statistic)
        found.append({"what": f"rank correlation of PPO / MMD with {what}", "games": len(own),
                      "value": rho})  # fmt: skip
    return found


def properties(data: Path) -> Properties:
    """The rows of games.csv by game; see `measure_games` in make_rows.py."""
    return {row["game"]: row for row in read_table(data / "games.csv")}


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
    lines.append((f"{PPO} / {RIVALS[0]}", [*own.values()]))
    for method in RIVALS[1:]:
        own = ratios(logs_of(rows, method), ppo)
        for name, _ in STRATA:
            part = [value for game, value in own.items() if stratum(share[game]) == name]
            lines.append((f"{method} / ppo, mixed share {name}", part))
    for method in POPULATIONS:
        if logs := logs_of(rows, method):
            lines.append((f"{method} / ppo", [*ratios(logs, ppo).values()]))
    found: list[Row] = []
    for what, values in lines:
        line: Row = {"what": what, "games": len(values), "ratio": ratio_with_interval(values)}
        found.append(line | {"p": float(ttest_1samp(values, 0.0).pvalue)})
    for row, p in zip(found, holm([row["p"] for row in found]), strict=True):
        row["p_holm"] = p
    return found


def present(rows: Sequence[Row]) -> list[str]:
    """The methods that have runs."""
    known = {row["variant"] for row in rows}
    return [method for method in (PPO, *RIVALS, *POPULATIONS) if method in known]


def by_stratum(rows: Sequence[Row]) -> list[Row]:
    """Of every method the geometric mean over games of NashConv, in per cent of the range, by
    stratum; and its games."""
    share, found = shares(rows), []
    for method in present(rows):
        logs = logs_of(rows, method)
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
        for method in present(rows):
            value = logs_of(rows, method).get(game)
            line[method] = None if value is None else 100.0 * (float(np.exp(value)) - LEAST)
        found.append(line)
    return found


def improved(rows: Sequence[Row]) -> list[Row]:
    """Of every method whose curve is that of what is judged, and every stratum, the ratio of
    NashConv at the end to that at half of the frames; geometric means over games and seeds."""
    share, found = shares(rows), []
    # The curve of psro is that of its latest best response; ppo by default has a threshold.
    for method in present(rows):
        if method in (RIVALS[1], POPULATIONS[0]):
            continue
        line: Row = {"method": method}
        for name, _ in STRATA:
            logs = []
            for row in rows:
                if (
                    row["variant"] == method
                    and stratum(share[row["game"]]) == name
                    and row["curve"]
                ):
                    curve = [float(v) / row["payoff_range"] + LEAST for v in row["curve"].split()]
                    logs.append(np.log(curve[-1] / curve[len(curve) // 2]))
            line[name] = float(np.exp(fmean(logs))) if logs else None
        found.append(line)
    return found


# -- exchanged entropy bonuses ---------------------------------------------------------------------


def by_bonus(rows: Sequence[Row], exchanged: Sequence[Row]) -> list[Row]:
    """PPO and MMD, each with the entropy bonus of both; of seed 0 on all games: NashConv by stratum
    in per cent of the range."""
    share, found = shares(rows), []
    for (method, bonus), logs in with_bonuses(rows, exchanged).items():
        line: Row = {"method": method, "entropy bonus of": bonus}
        for name, _ in STRATA:
            part = [value for game, value in logs.items() if stratum(share[game]) == name]
            line[name] = 100.0 * (float(np.exp(fmean(part))) - LEAST)
        found.append(line)
    return found


def with_bonuses(rows: Sequence[Row], exchanged: Sequence[Row]) -> dict[tuple[str, str], Logs]:
    """By method and whose bonus it has: its logarithms by game."""
    own = [*(row for row in rows if row["seed"] == 0), *exchanged]
    names = {(PPO, PPO): PPO, (PPO, MMD): "ppo, entropy of mmd",
             (MMD, PPO): "mmd, entropy of ppo", (MMD, MMD): MMD}  # fmt: skip
    return {pair: logs_of(own, name) for pair, name in names.items()}


def slopes_by_bonus(rows: Sequence[Row], exchanged: Sequence[Row]) -> list[Row]:
    """The slopes on the mixed share of the ratios between the four of `by_bonus`."""
    logs, share, found = with_bonuses(rows, exchanged), shares(rows), []
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


# -- settings --------------------------------------------------------------------------------------


def chosen(tuning: Sequence[Row]) -> dict[str, list[Row]]:
    """By method the runs of the trial that was chosen."""
    files = map(ablation_of, FILES)
    return {method: own for file in files for method, own in chosen_trials(file, tuning).items()}


def near_ends(method: str, row: Row) -> str:
    """The chosen numbers within a tenth of the end of their range, on its scale, and the first or
    last of at least three choices."""
    found = []
    for file_name in FILES:
        tuning = ablation_of(file_name).tuning
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


def stopped(tuning: Sequence[Row]) -> list[Row]:
    """Of every method on how many tuning games twice the frames do not lower NashConv + `LEAST` of
    its chosen setting below 80 %, between the last two rungs."""
    found = []
    for method, last in chosen(tuning).items():
        names = ("variant", "trial")
        same = [row for row in tuning if all(row[name] == last[0][name] for name in names)]
        earlier = {row["game"]: row for row in same if row["rung"] == last[0]["rung"] - 1}
        ends = [score([row]) - score([earlier[row["game"]]]) for row in last]
        falls = sum(end < np.log(0.8) for end in ends)
        rises = sum(end > np.log(1.25) for end in ends)
        line: Row = {"method": method, "frames": last[0]["budget_frames"], "games": len(ends)}
        found.append(line | {"stopped": len(ends) - falls, "of these rises": rises})
    return found


def settings(tuning: Sequence[Row]) -> list[Row]:
    """A column for every method, and a row for every setting."""
    best = {method: tried_settings(own[0]) for method, own in chosen(tuning).items()}
    names = dict.fromkeys(name for own in best.values() for name in own)
    return [{"setting": n} | {m: str(own.get(n, "")) for m, own in best.items()} for n in names]


# -- figures ---------------------------------------------------------------------------------------


def draw_ratios(path: Path, rows: Sequence[Row]) -> None:
    """The ratio of PPO to MMD over the mixed share, a point for each game."""
    own, share = ratios(logs_of(rows, PPO), logs_of(rows, MMD)), shares(rows)
    x = np.array([100.0 * share[game] for game in own])
    y = np.exp([*own.values()])
    figure, axis = pyplot().subplots(figsize=(7.2, 4.2), layout="constrained")
    axis.axhline(1.0, color="0.6", lw=1.0)
    ends = np.linspace(0.0, max(share.values()), 201)
    line = [ratio_at(own, share, float(at))[0] for at in ends]
    axis.plot(100.0 * ends, line, color="0.6", ls="--", label="least squares")
    mazes = np.array([game.startswith("maze_game") for game in own])
    axis.plot(x[mazes], y[mazes], "o", color="#0072b2", label="mazes")
    axis.plot(x[~mazes], y[~mazes], "s", color="#d55e00", label="other games")
    axis.set_xscale("symlog", linthresh=0.1)
    axis.set_xlim(-0.02, 120.0)
    axis.set_xticks([0, 0.1, 1, 5, 10, 50, 100], ["0", "0.1", "1", "5", "10", "50", "100"])
    axis.set_yscale("log")
    axis.set_yticks([0.2, 0.5, 1, 2, 5, 10, 20], ["0.2", "0.5", "1", "2", "5", "10", "20"])
    axis.minorticks_off()
    axis.set_xlabel("mixed share of the game (%)")
    axis.set_ylabel("NashConv of PPO / of MMD\n(below 1: PPO is nearer)")
    axis.legend(frameon=False)
    save(figure, path, dpi=150)


def draw_curves(path: Path, rows: Sequence[Row]) -> None:
    """NashConv over frames of all methods in one game of each stratum; medians over seeds."""
    share = shares(rows)
    populations = {row["game"] for row in rows if row["variant"] == POPULATIONS[0]}
    figure, axes = pyplot().subplots(2, 2, figsize=(9.0, 6.4), layout="constrained",
                                  sharex=True, sharey=True)  # fmt: skip
    for (name, _), axis in zip(STRATA, axes.ravel(), strict=True):
        games = [game for game, own in share.items() if stratum(own) == name]
        game = next((game for game in games if game in populations), games[0])
        # The curve of psro would be that of its latest best response, not of its mixture.
        for number, method in enumerate((PPO, *RIVALS, POPULATIONS[1])):
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
        axis.yaxis.set_major_formatter("{x:g}")
        axis.set_title(f"{game}\nmixed share {100.0 * share[game]:.2g} %", fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    for axis in axes[1]:
        axis.set_xlabel("million frames")
    for axis in axes[:, 0]:
        axis.set_ylabel("NashConv (% of the range)")
    save(figure, path, dpi=150)


def figures(data: Path, out: Path) -> None:
    """Both figures."""
    rows = judged(data)
    draw_ratios(out / "ratios.png", rows)
    draw_curves(out / "curves.png", rows)


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    rows, matrix, about = judged(data), judged(data, matrix=True), properties(data)
    tuning = [*read_recorded(data / "tuning.csv").values()]
    exchanged = [*read_recorded(data.parent / "self_play_entropy" / "runs.csv").values()]
    found = {
        "Slope of log(PPO / MMD)": slopes(rows, about),
        "What depends on settings and games": contrary(rows, matrix, about),
        "NashConv by stratum, % of the range": by_stratum(rows),
        "Comparisons": comparisons(rows),
        "NashConv at the end / at half of the frames": improved(rows),
        "NashConv by game, % of the range": by_game(rows),
        "Matrix games": by_game(matrix),
        "NashConv by stratum with exchanged bonuses, % of the range": by_bonus(rows, exchanged),
        "Slopes with exchanged bonuses": slopes_by_bonus(rows, exchanged),
        "Settings": settings(tuning),
        "Methods that had stopped improving": stopped(tuning),
        "Processor seconds of a million frames": read_table(data / "costs.csv"),
    }
    return {title: plain_table(table).markdown() for title, table in found.items()}
