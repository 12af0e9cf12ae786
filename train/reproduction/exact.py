"""Table 3.1 of the thesis, which needs no runs: numbers against numbers."""

from __future__ import annotations

from collections.abc import Mapping

from pursuit.maze import load_maze
from scripted_agents.tour import expected_tour_length, num_states
from train.reproduction.rules import CONFIRMED, REFUTED, UNDECIDED, Verdict

GOALS = 3
STATES = {3: 855, 4: 9304, 5: 58375, 6: 258894, 7: 906255, 8: 2672480, 9: 6920559}
"""By the maze's side, 3 goals: unique states as the thesis' table 3.1 has them."""
TOURS = {3: 4.97, 4: 6.91, 5: 8.99, 6: 13.6, 7: 14.07, 8: 19.91, 9: 23.42}
"""The same of the mean baselines, in steps."""
NEAR = 0.05
"""Of the optimum: means over 1000 episodes lie within it nearly always."""


def states_table() -> tuple[Verdict, list[str]]:
    """Whether the table's unique states are those of formula 3.2, and a table of both."""
    lines = ["| maze | formula 3.2 | table 3.1 |", "|---|---|---|"]
    found = {side: num_states(side * side, GOALS) for side in STATES}
    lines += [f"| {n}x{n} | {found[n]:,} | {told:,} |" for n, told in STATES.items()]
    same = all(found[side] == told for side, told in STATES.items())
    return Verdict(CONFIRMED if same else REFUTED, {}), lines


def tours_table(mazes: Mapping[str, str]) -> tuple[Verdict, list[str]]:
    """Whether the table's mean tours are the optimal ones of a user's mazes, and a table of both.

    Args:
        mazes: files by their size; without any, those of ours stand in the table and decide
            nothing.
    """
    lines = ["| maze | optimal mean tour, exact | table 3.1 | difference |", "|---|---|---|---|"]
    off = []
    for side, told in TOURS.items():
        name = f"{side}x{side}"
        if mazes and name not in mazes:
            continue
        exact = float(expected_tour_length(load_maze(mazes.get(name, name)), GOALS))
        off.append(told / exact - 1.0)
        lines.append(f"| {name} | {exact:.3f} | {told:.2f} | {100 * off[-1]:+.1f} % |")
    if not mazes:
        note = "these are our mazes; give the thesis' with --mazes FOLDER"
        return Verdict(UNDECIDED, {}, note), lines
    verdict = CONFIRMED if max(map(abs, off)) <= NEAR else REFUTED
    return Verdict(verdict, {}), lines
