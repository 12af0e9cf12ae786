"""`pursuit league`: runs and scripted agents against each other, with ratings and their doubts."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from pursuit.task import Task
from train.commands.parse import heard, parse
from train.files import write_json
from train.self_play.league import LeagueTable, enter, play_league, rate
from train.self_play.people import (
    enter_people,
    play_along,
    settings_of_people,
    split_people,
)
from train.self_play.pictures import draw_league
from train.settings.checks import check
from train.settings.self_play import ROLES


@dataclass(frozen=True)
class LeagueCommand:
    """All chasers against all evaders: payoff matrix, Elo, openskill, Nash averaging, cycles.

    Give the folders of runs (`pursuit train` of a chaser or evader, `pursuit self-play` for both),
    and the names of scripted agents: astar, random, optimal. A folder of games played by hand
    (`pursuit play --out`) has whoever played them rated with the rest.
    """

    entries: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Folders of runs and of games by hand, and names of scripted agents."""
    maze: str = "5x5"
    """Where scripted agents play if no run is given."""
    opponent_epsilon: float = 0.0
    """Share of random moves of astar."""
    greedy: bool = False
    """Learned policies take their most probable action instead of drawing."""
    games: int = 200
    """Games of each pair, from the same starts for all: what the ratings are made of."""
    seed: int = 0
    """Of those games; none is ever trained on, whatever the seed."""
    out: Path = Path("league")
    """Folder for league.json and league.png."""


def league(arguments: Sequence[str]) -> None:
    """`pursuit league`."""
    given = parse(LeagueCommand, arguments, "league")
    check(given.games >= 2, f"games={given.games}; at least 2")
    check(len(given.entries) > 0, "nobody to play; give folders of runs, or astar, random, optimal")
    with heard():
        by_hand, names = split_people(given.entries)
        played = settings_of_people(by_hand)
        how = (given.maze, given.opponent_epsilon, given.greedy, played)
        task, entries = enter(names, *how)
        people = enter_people(by_hand, task, [entry.name for entry in entries])
    table = play_league(task, entries, given.games, given.seed)
    policies = {role: [e.policy for e in entries if e.role == role] for role in ROLES}
    content = rate(table, given.seed, play_along(people, policies))
    given.out.mkdir(parents=True, exist_ok=True)
    write_json(given.out / "league.json", content)
    draw_league(given.out / "league.png", table, f"League on {task.mazes[0].name}")
    _print(task, table, content)
    print(f"\nfigure and table: {given.out}")


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
            ("never" if never else f"{value:.2f}") + (f" ± {half:.2f}" if half else "")
            for value, half, never in zip(
                table.payoff[i], table.ci95[i], content["never"][i], strict=True
            )
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
        rows = list(zip_longest(content[f"{role}_ratings"], shares))
        for row, share in sorted(rows, key=lambda pair: -pair[0]["elo"]):
            by_hand = row.get("games_by_hand")
            ratings.add_row(
                row["name"] + (f" (by hand: {by_hand})" if by_hand else ""),
                f"{row['elo']:.0f} [{row['elo_low']:.0f}, {row['elo_high']:.0f}]",
                f"{row['openskill_mu']:.1f} ± {row['openskill_sigma']:.1f}",
                "-" if by_hand else f"{100 * share:.1f} %",
                "-" if by_hand else f"{row['steps_against_nash']:.2f}",
            )
        console.print(ratings)
    for line in survival_lines(task, content):
        print(f"\nwarning: {line}", file=sys.stderr)
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


def survival_lines(task: Task, content: dict[str, Any]) -> list[str]:
    """What is to be said where evaders live for ever."""
    lines = []
    never, empty = content["never_caught"], content["never_catches"]
    if never:
        lines.append(
            f"never caught by any chaser here: {', '.join(never)}; the steps until capture are "
            f"infinite, and {task.max_steps} is only where the games are cut"
        )
    if "chaser" in content["ranks_mean_nothing"]:
        lines.append(
            "against such an evader every chaser is as good as any other, so ranks of chasers "
            "(above all an optimal one's, who plays for it) say only how they do against the rest"
        )
    if "evader" in content["ranks_mean_nothing"]:
        lines.append(f"no rank tells {', '.join(never)} apart: they all live for ever")
    if empty:
        lines.append(f"never catch anybody here: {', '.join(empty)}")
    return lines
