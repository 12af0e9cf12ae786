"""Table 3.1 of the thesis against exact values; it needs no runs."""

from __future__ import annotations

from collections.abc import Mapping
from math import comb

from pursuit.mazes.maze import load_maze
from scripted_agents.exact.tours.tour import expected_tour_length, num_states
from train.experiments.claims import CONFIRMED, REFUTED, UNDECIDED
from train.reports.tables import Row, plain_table

GOALS = 3
STATES = {3: 855, 4: 9304, 5: 58375, 6: 258894, 7: 906255, 8: 2672480, 9: 6920559}
"""Unique states with 3 goals in table 3.1 of the thesis, by side length of the maze."""
TOURS = {3: 4.97, 4: 6.91, 5: 8.99, 6: 13.6, 7: 14.07, 8: 19.91, 9: 23.42}
"""Mean baselines in steps in the same table, by side length of the maze."""
NEAR = 0.05
"""Relative tolerance; means over 1000 episodes are nearly always this close to the optimum."""


def swapped_states(num_cells: int) -> int:
    """Formula 3.2 for 3 goals with the factors of one and of two goals swapped.

    The formula is the sum of C(n, i) (n - i) over i = 1, 2, 3 goals. This function uses n - 2 for
    one goal and n - 1 for two.
    """
    return sum(comb(num_cells, i) * (num_cells - k) for i, k in ((1, 2), (2, 1), (3, 3)))


def states_table() -> tuple[str, str, str]:
    """The verdict on "the table's unique states are those of formula 3.2", a note, and a table."""
    found = {side: num_states(side * side, GOALS) for side in STATES}
    rows: list[Row] = [
        {
            "maze": f"{n}x{n}",
            "formula 3.2": f"{found[n]:,}",
            "formula 3.2, two factors swapped": f"{swapped_states(n * n):,}",
            "table 3.1": f"{printed:,}",
        }
        for n, printed in STATES.items()
    ]
    return CONFIRMED if found == STATES else REFUTED, "", plain_table(rows).markdown()


def tours_table(mazes: Mapping[str, str]) -> tuple[str, str, str]:
    """The verdict on "the table's mean tours are optimal", a note, and a table.

    Args:
        mazes: maze files of the thesis by size; if empty, our mazes are tabulated and the verdict
            is undecided.
    """
    rows: list[Row] = []
    off = []
    for side, reported in TOURS.items():
        name = f"{side}x{side}"
        if mazes and name not in mazes:
            continue
        exact = float(expected_tour_length(load_maze(mazes.get(name, name)), GOALS))
        off.append(reported / exact - 1.0)
        row: Row = {"maze": name, "optimal mean tour, exact": f"{exact:.3f}"}
        row |= {"table 3.1": f"{reported:.2f}", "difference": f"{100 * off[-1]:+.1f} %"}
        rows.append(row)
    table = plain_table(rows).markdown()
    if not mazes:
        return UNDECIDED, "mazes of pursuit; give those of the thesis with --mazes FOLDER", table
    return CONFIRMED if max(map(abs, off)) <= NEAR else REFUTED, "", table
