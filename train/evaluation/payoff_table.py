"""Payoff matrices as tables: chasers as rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

from train.files import Plain
from train.reports.tables import Column, ResultTable, Row, words
from train.settings.self_play import OPPOSING_ROLES


def payoff_table(
    chasers: Sequence[str],
    evaders: Sequence[str],
    steps: Sequence[Sequence[float]],
    ci95: Sequence[Sequence[float]],
    never: Sequence[Sequence[bool]] | None = None,
    roles: tuple[str, str] = OPPOSING_ROLES,
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
    value = "never" if row.get(f"{name} never caught") else f"{row[name]:z.2f}"
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
