"""Payoff matrices as tables, a figure and a page: steps until capture, chasers as rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pursuit.replays.viewer.data import Builder
from train.evaluation.payoff_table import payoff_table
from train.evaluation.scores import Measure
from train.evaluation.sides import Sides
from train.files import Plain
from train.reports.figures import draw_matrix
from train.reports.pages import embedded_picture, section
from train.reports.tables import Column, ResultTable, Row, in_markdown, numeric, words
from train.self_play.league import Entry, LeagueTable


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
        never = content["never"] if table.counts_captures else None
        return {"table": payoff_table(own, other, content["payoff"], content["ci95"], never, roles)}
    return {
        f"table_{role}": payoff_table(own, other, payoff, table.ci95.tolist(), None, roles)
        for role, payoff in content["payoffs"].items()
    }


def draw_league(path: Path, table: LeagueTable, title: str) -> list[Path]:
    """The payoff matrix as a heat map; in a general-sum game also that of the first role, in a
    second file. Returns the paths."""
    names = [*zip(table.roles, (table.chasers, table.evaders), strict=True)]
    draw_matrix(path, table.shown, names[0], names[1], table.measure.unit, title)
    if table.first is None:
        return [path]
    role = table.roles[0]
    other = path.with_stem(f"{path.stem}_{role}")
    draw_matrix(other, table.first, names[0], names[1], f"return of {role}", title)
    return [other, path]


def notable_pairs(table: LeagueTable, content: Plain) -> dict[tuple[int, int], str]:
    """By row and column why a pair is notable: the least and the largest payoff, and where there
    are ratings the best of both roles."""
    found: dict[tuple[int, int], list[str]] = {}
    for why, place in (("least", table.shown.argmin()), ("largest", table.shown.argmax())):
        found.setdefault(divmod(int(place), len(table.evaders)), []).append(f"{why} payoff")
    if table.first is None:
        elo = [[row["elo"] for row in content[f"{role}_ratings"]] for role in table.roles]
        best = elo[0].index(max(elo[0])), elo[1].index(max(elo[1]))
        found.setdefault(best, []).append("best rated")
    return {pair: ", ".join(reasons) for pair, reasons in found.items()}


def add_notable_pairs(
    builder: Builder, game: Sides, entries: Sequence[Entry], table: LeagueTable, content: Plain
) -> None:
    """Add an episode of each of `notable_pairs` to a page, all from the same start.

    Raises:
        ValueError: a game that draws its states failed to.
    """
    sides = [[entry for entry in entries if entry.role == role] for role in table.roles]
    for (row, column), why in notable_pairs(table, content).items():
        one, two = sides[0][row], sides[1][column]
        labels = {one.role: one.name, two.role: two.name}
        policies = {one.role: one.policy, two.role: two.policy}
        game.add_episodes(builder, policies, {f"{one.name} against {two.name}: {why}": 0}, labels)


def page_parts(
    figures: Sequence[Path], tables: Mapping[str, ResultTable], notes: Sequence[str]
) -> list[str]:
    """What the page of a league shows: figures, tables by the names of their files, sentences."""
    parts: list[str] = [embedded_picture(path, path.stem) for path in figures]
    for name, table in tables.items():
        head = name.replace("table", "payoffs").replace("_", " ").title()
        parts += section(head, table.markdown())
    return parts + section("Notes", "\n".join(f"- {in_markdown(note)}" for note in notes))
