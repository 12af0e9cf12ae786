"""Table 3.1 of the thesis against exact values: unique states, and the mean optimal tour.

    python tools/thesis_table.py [FOLDER]

FOLDER has the mazes of the thesis as text files, one of each size; without it the tours are those
of our mazes, which are others.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from math import comb
from pathlib import Path

from pursuit.mazes.maze import load_maze
from scripted_agents import expected_tour_length, num_states
from train.experiments.replication import mazes_by_size
from train.reports.tables import plain_table

GOALS = 3
STATES = {3: 855, 4: 9304, 5: 58375, 6: 258894, 7: 906255, 8: 2672480, 9: 6920559}
"""Unique states with 3 goals in the table, by side length of the maze."""
TOURS = {3: 4.97, 4: 6.91, 5: 8.99, 6: 13.6, 7: 14.07, 8: 19.91, 9: 23.42}
"""Mean baselines in steps in the table (means over 1000 episodes), by side length of the maze."""


def swapped_states(num_cells: int) -> int:
    """Formula 3.2, the sum of C(n, i) (n - i) over i = 1, 2, 3 goals, with n - 2 for one goal and
    n - 1 for two, which gives all seven counts of the table."""
    return sum(comb(num_cells, i) * (num_cells - k) for i, k in ((1, 2), (2, 1), (3, 3)))


def states_table() -> list[dict[str, str]]:
    """The states of formula 3.2 beside those of the table."""
    return [
        {
            "maze": f"{side}x{side}",
            "formula 3.2": f"{num_states(side * side, GOALS):,}",
            "formula 3.2, two factors swapped": f"{swapped_states(side * side):,}",
            "table 3.1": f"{printed:,}",
        }
        for side, printed in STATES.items()
    ]


def tours_table(mazes: Mapping[str, str]) -> list[dict[str, str]]:
    """The exact mean tours of mazes, by size, beside those of the table."""
    rows = []
    for side, reported in TOURS.items():
        name = f"{side}x{side}"
        if mazes and name not in mazes:
            continue
        exact = float(expected_tour_length(load_maze(mazes.get(name, name)), GOALS))
        row = {"maze": name, "optimal mean tour, exact": f"{exact:.3f}", "table 3.1": f"{reported}"}
        rows.append(row | {"difference": f"{100 * (reported / exact - 1):+.1f} %"})
    return rows


if __name__ == "__main__":
    own = mazes_by_size(Path(sys.argv[1])) if len(sys.argv) > 1 else {}
    tables = plain_table(states_table()), plain_table(tours_table(own))
    print("\n\n".join(table.markdown() for table in tables))
