"""Payoff matrices as tables and a figure: steps until capture, chasers as rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

from train.evaluation.scores import Measure
from train.files import Plain
from train.reports.figures import draw_matrix
from train.reports.tables import Column, ResultTable, Row, numeric, words
from train.self_play.league import LeagueTable
from train.settings.self_play import ROLES


def payoff_table(
    chasers: Sequence[str],
    evaders: Sequence[str],
    steps: Sequence[Sequence[float]],
    ci95: Sequence[Sequence[float]],
    never: Sequence[Sequence[bool]] | None = None,
    roles: tuple[str, str] = ROLES,
) -> ResultTable:
    """A row for each chaser: "against NAME" and "against NAME ci95" for every evader.

    Args:
        chasers, evaders: their names, all different in each.
        steps: [chasers][evaders], until capture or the end.
        ci95: [chasers][evaders], half widths of confidence intervals; 0 for exact steps.
        never: [chasers][evaders], whether the evader is never caught.
        roles: of rows and columns.
    """
    own, other = roles
    rows = []
    for i, chaser in enumerate(chasers):
        row: Row = {own: chaser}
        for j, evader in enumerate(evaders):
            row[f"against {evader}"] = float(steps[i][j])
            row[f"against {evader} ci95"] = float(ci95[i][j])
            if never is not None:
                row[f"against {evader} never caught"] = bool(never[i][j])
        rows.append(row)
    cells = [Column(evader, partial(_cell, f"against {evader}")) for evader in evaders]
    return ResultTable(rows, [words(f"{own} \\ {other}", own), *cells])


def _cell(name: str, row: Row) -> str:
    half = row[f"{name} ci95"]
    value = "never" if row.get(f"{name} never caught") else f"{row[name]:.2f}"
    return value + (f" ± {half:.2f}" if half else "")


def matches_table(matches: Sequence[Plain]) -> ResultTable:
    """The "matches" of the results of self-play."""
    chasers = list(dict.fromkeys(str(row["chaser"]) for row in matches))
    evaders = list(dict.fromkeys(str(row["evader"]) for row in matches))
    by_pair = {(row["chaser"], row["evader"]): row for row in matches}

    def grid(name: str) -> list[list[float]]:
        return [[by_pair[chaser, evader][name] for evader in evaders] for chaser in chasers]

    exits = any("outcome" in row for row in matches)
    half = [[0.0] * len(evaders)] * len(chasers) if exits else grid("ci95")  # ci95 is of the steps
    return payoff_table(chasers, evaders, grid("outcome" if exits else "steps"), half)


def legend_of(names: Iterable[str], epsilon: float) -> str:
    """What the scripted agents among these names are: astar with this epsilon, and equilibrium."""
    meanings = {
        "astar": f"epsilon {epsilon:g}",
        "equilibrium": "an equilibrium policy of the discounted game, which is not always the best "
        "against these opponents",
    }
    return "; ".join(f"{name}: {meanings[name]}" for name in meanings if name in {*names})


def ratings_table(role: str, content: Plain) -> ResultTable:
    """The ratings of one role of a league, the best by Elo first."""
    ratings, shares = content[f"{role}_ratings"], content["nash"][f"{role}_mixture"]
    rows = [{**row, "nash_share": share} for row, share in zip(ratings, shares, strict=True)]
    of_game = "payoff_against_nash" in ratings[0]
    against = ("payoff_against_nash", "z.2f") if of_game else ("steps_against_nash", ".2f")
    columns = [
        words(role, "name"),
        Column("Elo [95 %]", lambda r: f"{r['elo']:.0f} [{r['elo_low']:.0f}, {r['elo_high']:.0f}]"),
        Column("Nash share", lambda r: f"{100 * r['nash_share']:.1f} %"),
        numeric(f"{content['unit']} against Nash", *against),
    ]
    return ResultTable(sorted(rows, key=lambda row: -row["elo"]), columns)


def teams_table(rows: Sequence[Row], measure: Measure) -> ResultTable:
    """The rows of `team_rows` with a best response."""
    known = [row for row in rows if row["best_response"] is not None]
    full = ", full view" if any(row["full_view"] for row in known) else ""
    gap = numeric("gap", "gap", "+.2f", 100, " %")
    columns = [
        words("team", "team"),
        words("against", "against"),
        numeric(measure.unit, "payoff", "z.3f"),
        numeric(f"best team response{full}", "best_response", "z.3f"),
        gap if measure.by_steps else numeric("difference", "gap", "z.3f"),
    ]
    return ResultTable(known, columns)


def payoff_tables(table: LeagueTable, content: Plain) -> dict[str, ResultTable]:
    """The payoffs of a league by the name of the file; of a general-sum game those of each role."""
    own, other, roles = table.chasers, table.evaders, table.roles
    if table.first is None:
        never = content["never"] if roles == ROLES else None
        return {"table": payoff_table(own, other, content["payoff"], content["ci95"], never, roles)}
    return {
        f"table_{role}": payoff_table(own, other, payoff, table.ci95.tolist(), None, roles)
        for role, payoff in content["payoffs"].items()
    }


def draw_league(path: Path, table: LeagueTable, title: str) -> None:
    """The payoff matrix as a heat map; in a general-sum game also that of the first role, in a
    second file."""
    names = [*zip(table.roles, (table.chasers, table.evaders), strict=True)]
    draw_matrix(path, table.shown, names[0], names[1], table.measure.unit, title)
    if table.first is not None:
        role = table.roles[0]
        path = path.with_stem(f"{path.stem}_{role}")
        draw_matrix(path, table.first, names[0], names[1], f"return of {role}", title)
