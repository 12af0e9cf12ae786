"""`pursuit league`: runs and scripted agents against each other, with ratings."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pursuit.validation import at_least, check
from scripted_agents.exact.long_work import in_time
from train.commands.parse import parse
from train.commands.progress import ProgressLine
from train.files import Plain, check_output_folder, hold, write_json
from train.reports.tables import in_markdown, print_table
from train.settings.checks import Settings, check_default
from train.settings.self_play import MEMBERS

if TYPE_CHECKING:
    from train.self_play.league import LeagueTable

LEAGUE = "league.json"
FORMAT = 2
"""Of this file; the first had escapes minus captures and no number."""


@dataclass(frozen=True)
class LeagueCommand(Settings):
    """All chasers against all evaders: payoff matrix, Elo, Nash averaging, cycles.

    Give the folders of runs (`pursuit train` of a chaser or evader, `pursuit self-play` for both),
    exported policies (.onnx), saved Stable-Baselines3 models (.zip) and the names of scripted
    agents: astar, random, uniform, equilibrium, searching, sweeping, belief, gathering.

    In another game (that of the first run, or a small game by --game NAME) all policies of the
    first side against all of the second, by returns: runs, and named policies of the game. In a
    general-sum game there are the payoffs of both, and no ratings.
    """

    entries: Annotated[tuple[str, ...], MEMBERS, tyro.conf.Positional] = ()
    """Folders of runs, and names of scripted agents."""
    at: tuple[str, ...] = ()
    """Times of training of which policies of runs play, each as an entry of its own: frames at
    which they were kept, or best; as in pursuit evaluate. None: the last ones."""
    maze: str | None = None
    """The maze, if no run is given. None: 5x5."""
    game: str | None = None
    """A small game of two players, as in `pursuit train --game`. None: the game of the first run;
    without runs a chase."""
    opponent_epsilon: float = 0.0
    """Probability of random moves of astar."""
    greedy: bool = False
    """Learned policies take their most probable action instead of sampling."""
    games: Annotated[int, at_least(2)] = 200
    """Games per pair for the ratings, from the same starts for all."""
    seed: int = 0
    """Seed of these games; training never uses their starts."""
    names: tuple[str, ...] = ()
    """Names of the entries in tables and figures, in their order; by default the shortest unique
    ends of their paths."""
    model_roles: tuple[str, ...] = ()
    """Roles of Stable-Baselines3 models without a description file (as model.save() writes them):
    chaser or evader; one for all, or one for each in their order."""
    model_observations: tuple[str, ...] = ()
    """Observations of these models, such as one_hot; one for all, or one for each."""
    out: Path = Path("league")
    """Folder for report.html, league.json, league.png and the tables (table.csv, chasers.csv and
    evaders.csv; for teams teams.csv, their best responses)."""
    overwrite: bool = False
    """Write to --out even if it has other files, and replace those with the same names."""


def league(arguments: Sequence[str]) -> None:
    """`pursuit league`."""
    given = parse(LeagueCommand, arguments, "league")
    check(bool(given.entries), "no entries; give folders of runs, or astar, random, equilibrium")
    names, out = given.entries, given.out
    check_output_folder(out, lambda folder: (folder / LEAGUE).exists(), given.overwrite)
    from pursuit.replays.viewer.data import Builder
    from train.machine import machine, versions  # torch is slow to import
    from train.reports.pages import PLAYER_ELEMENT, section, write_page
    from train.runs.folder import REPORT
    from train.runs.provenance import command_line
    from train.runs.report import made_with
    from train.self_play.league import enter, entries_name, play_league, rate
    from train.self_play.payoffs import (
        add_notable_pairs,
        draw_league,
        page_parts,
        payoff_tables,
        ratings_table,
        teams_table,
    )

    runs = any(path.is_dir() for path in map(Path, names))
    check(runs or not given.at, "--at is for runs, but none is entered; leave it out")
    if given.game is not None:
        of_mazes = ("maze", "opponent_epsilon", "model_roles", "model_observations")
        check_default(given, LeagueCommand, of_mazes, "it is for games in mazes")
    how = (given.maze, given.opponent_epsilon, given.greedy, given.names)
    models = (given.model_roles, given.model_observations)
    game, entered = enter(names, *how, *models, given.game, given.at)
    place, max_steps, where = game.place(), game.task.max_steps, game.describe_game()
    lock = hold(out, "league")
    with closing(ProgressLine()) as tell:
        how_far = partial(tell, f"league {place}")
        table = play_league(game, entered, given.games, given.seed, report=how_far)
        teams = in_time(lambda: game.team_rows(entered, table), None, tell)[0]
    content: Plain = rate(table, given.seed)
    content |= {
        "format": FORMAT,
        "task": where["task"],
        "maze": where["maze"],
        **({"game": where["game"]} if "game" in where else {}),
        "max_steps": max_steps,
        "seed": given.seed,
        "greedy": given.greedy,
        "opponent_epsilon": given.opponent_epsilon,
        "entries": list(names),
        "command": command_line(),
        "versions": versions(),
        "machine": machine(),
    }
    content |= {"team": teams} if teams else {}
    write_json(out / LEAGUE, content)
    title = f"League {place.replace('maze ', '').replace('game ', '')}"
    figures = draw_league(out / "league.png", table, title)
    tables = payoff_tables(table, content)
    if table.first is None:
        tables |= {entries_name(role): ratings_table(role, content) for role in table.roles}
    if any(row["best_response"] is not None for row in teams):
        tables["teams"] = teams_table(teams, table.measure)
    for stem, each in tables.items():
        each.write(out, stem)
    head, warnings = headline(place, max_steps, table), warnings_of(max_steps, table, content)
    notes = ["general-sum game: no Nash averaging and no ratings"] * (table.first is not None)
    for role, other, why in dict.fromkeys((r["role"], r["against"], r["reason"]) for r in teams):
        if why:
            notes.append(f"no exact best response of the {role}s against {other}: {why}")
    if legend := game.legend(names, given.opponent_epsilon):
        notes.append(legend)
    print(head)
    for each in tables.values():
        print_table(each)
        print()
    print("".join(f"warning: {line}\n" for line in warnings), end="", file=sys.stderr)
    print("".join(f"{line}\n" for line in notes), end="")
    parts = [in_markdown(f"Payoffs: {head}."), *page_parts(figures, tables, [*warnings, *notes])]
    add_notable_pairs(builder := Builder(), game, entered, table, content)
    parts += section("Games of notable pairs", PLAYER_ELEMENT)
    made = section("Command", made_with(content["command"], content))
    write_page(out / REPORT, title, [*parts, *made], builder.data(title))
    lock.release()
    print(f"report: {out / REPORT}\nfigures and tables: {out}")


def headline(place: str, max_steps: int, table: LeagueTable) -> str:
    """What the payoffs are, and of which policies."""
    exact = "exact" if not table.ci95.any() else "± is the 95 % interval"
    first, second = table.roles
    unit = table.measure.unit
    if table.first is not None:
        unit = f"returns of {first}, then of {second},"
    rows, columns = (policies_of(role, table) for role in table.roles)
    return f"{unit} {place}, at most {max_steps} ({exact}); rows: {rows}, columns: {columns}"


def policies_of(role: str, table: LeagueTable) -> str:
    """The policies of a role in words."""
    return f"{role}s" if table.counts_captures else f"policies of {role}"


def warnings_of(max_steps: int, table: LeagueTable, content: Plain) -> list[str]:
    """Where ratings mean little: policies that are never caught, and cycles."""
    if table.first is not None:
        return []
    lines = survival_lines(max_steps, content) if table.counts_captures else []
    for role in table.roles:
        if cycle := content[f"{role}_cycle"]:
            lines.append(
                f"the {policies_of(role, table)} are not transitive, so ratings cannot order "
                f"them: {' > '.join([*cycle, cycle[0]])}"
            )
    if cycle := content["cycle"]:
        lines.append(
            "these results are not transitive, so there is no single ranking; each is the best "
            f"response to the previous one: {' -> '.join([*cycle, cycle[0]])}"
        )
    return lines


def survival_lines(max_steps: int, content: Plain) -> list[str]:
    """Warnings on evaders that are never caught."""
    lines = []
    never, empty = content["never_caught"], content["never_catches"]
    if never:
        lines.append(
            f"never caught by any chaser here: {', '.join(never)}; the steps until capture are "
            f"infinite, and {max_steps} is only the time limit"
        )
    if "chaser" in content["ranks_mean_nothing"]:
        lines.append(
            "against such an evader all chasers are equal, so ranks of chasers only reflect the "
            "other evaders"
        )
    if "evader" in content["ranks_mean_nothing"]:
        lines.append(f"ranks of {', '.join(never)} are meaningless: they are never caught")
    if empty:
        lines.append(f"never catch an evader here: {', '.join(empty)}")
    return lines
