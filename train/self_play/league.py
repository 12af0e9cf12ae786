"""`pursuit league`: runs and scripted agents against each other, with ratings and their doubts."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from pursuit.policy import Policy
from pursuit.task import Task
from scripted_agents.environments import SCRIPTED, scripted_policy
from train.commands.main import parse
from train.evaluation.matchups import is_exact, match, play_pair
from train.runs.folder import CONFIG, load_settings, write_beside, write_json
from train.runs.run import load_policy
from train.self_play.ratings import (
    best_response_cycle,
    elo_ratings,
    nash_average,
    openskill_ratings,
    pairwise_wins,
    preference_cycle,
)
from train.self_play.trainee import check_fits
from train.settings.checks import check
from train.settings.run import TaskSettings
from train.settings.self_play import ROLES, SETTINGS


@dataclass(frozen=True)
class LeagueCommand:
    """All chasers against all evaders: payoff matrix, Elo, openskill, Nash averaging, cycles.

    Give the folders of runs (`pursuit train` of a chaser or evader, `pursuit self-play` for both),
    and the names of scripted agents: astar, random, optimal.
    """

    entries: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Folders of runs, and names of scripted agents."""
    maze: str = "5x5"
    """Where scripted agents play if no run is given."""
    opponent_epsilon: float = 0.0
    """Share of random moves of astar."""
    greedy: bool = False
    """Learned policies take their most probable action instead of drawing."""
    games: int = 200
    """Games of each pair, from the same starts for all: what the ratings are made of."""
    seed: int = 0
    """Of those games."""
    out: Path = Path("league")
    """Folder for league.json and league.png."""


@dataclass(frozen=True)
class Entry:
    """Somebody in one role."""

    name: str
    role: str
    policy: Policy


@dataclass(frozen=True, eq=False)
class LeagueTable:
    """What a league found; payoffs are steps until capture, cut at the task's horizon.

    Attributes:
        payoff, ci95: [chasers, evaders] float64; the half width is 0 where the payoff is exact.
        lengths: [chasers, evaders, games] int64, of the games played.
        chasers, evaders: their names.
    """

    chasers: list[str]
    evaders: list[str]
    payoff: NDArray[np.float64]
    ci95: NDArray[np.float64]
    lengths: NDArray[np.int64]


def league(arguments: Sequence[str]) -> None:
    """`pursuit league`."""
    given = parse(LeagueCommand, arguments, "league")
    check(given.games >= 2, f"games={given.games}; at least 2")
    check(len(given.entries) > 0, "nobody to play; give folders of runs, or astar, random, optimal")
    task, entries = enter(given)
    table = play_league(task, entries, given.games, given.seed)
    content = rate(table, given.seed)
    given.out.mkdir(parents=True, exist_ok=True)
    write_json(given.out / "league.json", content)
    draw_league(given.out / "league.png", table, f"League on {task.mazes[0].name}")
    _print(task, table, content)
    print(f"\nfigure and table: {given.out}")


def enter(given: LeagueCommand) -> tuple[Task, list[Entry]]:
    """The task of the league, and whoever takes part.

    Raises:
        ValueError: an entry that is no run, of another game, given twice, or a role without entry.
    """
    runs: list[tuple[str, Path]] = []
    for name in given.entries:
        check(given.entries.count(name) == 1, f"two entries are called {name!r}; give it once")
        if name in SCRIPTED:
            continue
        folder = Path(name)
        check(
            folder.is_dir(),
            f"{name}: no folder of a run, and no scripted agent ({', '.join(SCRIPTED)})",
        )
        if (folder / SETTINGS).exists():
            inner = [folder / role for role in ROLES if (folder / role / CONFIG).exists()]
            check(bool(inner), f"{name}: self-play that has not saved anything yet")
            runs += [(name, path) for path in inner]
        else:
            runs.append((name, folder))
    task = TaskSettings(maze=given.maze).build()
    if runs:
        task = load_settings(runs[0][1]).task.build()
        check(
            bool(task.num_chasers and task.num_evaders),
            f"{runs[0][0]}: learned in task {task.name!r}; a league is between chasers and evaders",
        )
        check(not task.num_runners, f"{runs[0][0]}: learned among runners; a league has none")
    entries = []
    for name, folder in runs:
        settings = load_settings(folder)
        role = settings.task.agent.split("_")[0]
        check(role in ROLES, f"{name}: learned to be {role!r}; a league has chasers and evaders")
        drawn = not given.greedy and settings.algorithm not in ("dqn", "q_learning")
        policy: Any = load_policy(folder, greedy=not drawn)
        check_fits(policy, role, task, name)
        entries.append(Entry(name, role, policy))
    for name in given.entries:
        if name in SCRIPTED:
            rest: Any = (given.opponent_epsilon if name == "astar" else 0.0, task.move_order)
            for role in ROLES:
                entries.append(Entry(name, role, scripted_policy(name, role, *rest)))
    for role in ROLES:
        check(
            any(entry.role == role for entry in entries),
            f"no {role} among the entries; add astar, say, or a run of one",
        )
    return task, entries


def play_league(task: Task, entries: Sequence[Entry], games: int, seed: int) -> LeagueTable:
    """Every chaser against every evader: exact payoffs where they can be had, and games."""
    sides = {role: [entry for entry in entries if entry.role == role] for role in ROLES}
    shape = (len(sides["chaser"]), len(sides["evader"]))
    payoff, ci95 = np.zeros(shape), np.zeros(shape)
    lengths = np.zeros((*shape, games), dtype=np.int64)
    for i, chaser in enumerate(sides["chaser"]):
        for j, evader in enumerate(sides["evader"]):
            lengths[i, j], _ = play_pair(task, chaser.policy, evader.policy, games, seed)
            if is_exact(task, chaser.policy, evader.policy):
                payoff[i, j] = match(task, chaser.policy, evader.policy).steps
            else:
                payoff[i, j] = lengths[i, j].mean()
                ci95[i, j] = 1.96 * lengths[i, j].std(ddof=1) / games**0.5
    names = [[entry.name for entry in sides[role]] for role in ROLES]
    return LeagueTable(names[0], names[1], payoff, ci95, lengths)


def rate(table: LeagueTable, seed: int = 0) -> dict[str, Any]:
    """Ratings of both roles, Nash averaging and a cycle of best responses, as plain values."""
    content: dict[str, Any] = {
        "chasers": table.chasers,
        "evaders": table.evaders,
        "payoff": table.payoff.tolist(),
        "ci95": table.ci95.tolist(),
        "games": table.lengths.shape[2],
    }
    average = nash_average(table.payoff)
    content["nash"] = {
        "value": average.value,
        "chaser_mixture": average.chasers.tolist(),
        "evader_mixture": average.evaders.tolist(),
    }
    for role, names, results, nash in (
        ("chaser", table.chasers, -table.lengths, table.payoff @ average.evaders),
        ("evader", table.evaders, table.lengths.swapaxes(0, 1), average.chasers @ table.payoff),
    ):
        wins = pairwise_wins(results)
        elo = elo_ratings(wins, seed)
        skill = openskill_ratings(results, seed)
        content[f"{role}_ratings"] = [
            {
                "name": name,
                "elo": elo[n][0],
                "elo_low": elo[n][1],
                "elo_high": elo[n][2],
                "openskill_mu": skill[n][0],
                "openskill_sigma": skill[n][1],
                "steps_against_nash": float(nash[n]),
            }
            for n, name in enumerate(names)
        ]
        content[f"{role}_cycle"] = [names[n] for n in preference_cycle(wins)]
    cycle = best_response_cycle(table.payoff, table.ci95)
    content["cycle"] = [
        ("chaser " + table.chasers[n]) if role == "chaser" else ("evader " + table.evaders[n])
        for role, n in cycle
    ]
    return content


def _print(task: Task, table: LeagueTable, content: dict[str, Any]) -> None:
    console = Console(width=None if sys.stdout.isatty() else 120)
    exact = "exact" if not table.ci95.any() else "± is the 95 % interval"
    print(
        f"steps until capture on maze {task.mazes[0].name}, at most {task.max_steps} ({exact}); "
        "chasers down, evaders across"
    )
    grid = Table(box=None, pad_edge=False)
    grid.add_column("")
    for name in table.evaders:
        grid.add_column(name, justify="right")
    for i, name in enumerate(table.chasers):
        cells = [
            f"{value:.2f}" + (f" ± {half:.2f}" if half else "")
            for value, half in zip(table.payoff[i], table.ci95[i], strict=True)
        ]
        grid.add_row(name, *cells)
    console.print(grid)
    mixtures = {"chaser": "chaser_mixture", "evader": "evader_mixture"}
    for role in ROLES:
        print()
        ratings = Table(box=None, pad_edge=False)
        for head in (role, "Elo [95 %]", "openskill", "Nash share", "steps against Nash"):
            ratings.add_column(head, justify="left" if head == role else "right")
        shares = content["nash"][mixtures[role]]
        rows = list(zip(content[f"{role}_ratings"], shares, strict=True))
        for row, share in sorted(rows, key=lambda pair: -pair[0]["elo"]):
            ratings.add_row(
                row["name"],
                f"{row['elo']:.0f} [{row['elo_low']:.0f}, {row['elo_high']:.0f}]",
                f"{row['openskill_mu']:.1f} ± {row['openskill_sigma']:.1f}",
                f"{100 * share:.1f} %",
                f"{row['steps_against_nash']:.2f}",
            )
        console.print(ratings)
    for role in ROLES:
        if content[f"{role}_cycle"]:
            chain = " > ".join([*content[f"{role}_cycle"], content[f"{role}_cycle"][0]])
            print(
                f"\nwarning: the {role}s are not transitive, ratings cannot order them: {chain}",
                file=sys.stderr,
            )
    if content["cycle"]:
        chain = " -> ".join([*content["cycle"], content["cycle"][0]])
        print(
            "\nwarning: these results are not transitive, so no single order says who is better; "
            f"each is the best answer to the one before: {chain}",
            file=sys.stderr,
        )


def draw_league(path: Path, table: LeagueTable, title: str) -> None:
    """The payoff matrix as a heat map."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    chasers, evaders = table.payoff.shape
    figure, axis = pyplot.subplots(
        figsize=(3.2 + 0.85 * evaders, 1.8 + 0.55 * chasers), layout="constrained"
    )
    image = axis.imshow(table.payoff, cmap="viridis", aspect="auto")
    low, high = table.payoff.min(), table.payoff.max()
    for i in range(chasers):
        for j in range(evaders):
            value = table.payoff[i, j]
            dark = value < low + 0.6 * (high - low)
            axis.text(
                j, i, f"{value:.1f}", ha="center", va="center", fontsize=9,
                color="white" if dark else "black",
            )  # fmt: skip
    axis.set_yticks(range(chasers), [_short(name) for name in table.chasers])
    axis.set_xticks(
        range(evaders), [_short(name) for name in table.evaders], rotation=30, ha="right"
    )
    axis.set_ylabel("chaser")
    axis.set_xlabel("evader")
    figure.colorbar(image, label="steps until capture")
    axis.set_title(title, fontsize=11)
    write_beside(path, lambda beside: figure.savefig(beside, dpi=130, format="png"))
    pyplot.close(figure)


def _short(name: str) -> str:
    return name if len(name) <= 24 else "…" + name[-23:]
