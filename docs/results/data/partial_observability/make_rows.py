"""Optimal and scripted chasers with a limited view: data of docs/results/partial_observability.md.

    python docs/results/data/partial_observability/make_rows.py [--out FOLDER]

It writes bounds.csv (proven bounds of the optimum against `AStarEvader(0.2)`, discount 0.95) and
scripted.csv (mean steps of scripted chasers against it), in some five minutes of one core.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

import pursuit
from pursuit.simulator.policy import Policy
from scripted_agents import (
    AStarEvader,
    BeliefChaser,
    HiddenChaseSolution,
    SearchingChaser,
    SweepingChaser,
    solve_hidden_chase,
)
from train.files import write_csv

Row = dict[str, Any]
EPSILON = 0.2
PROBLEMS = (
    ("5x5", 0, 12.0),
    ("5x5", 1, 30.0),
    ("5x5", 2, 8.0),
    ("5x5", 3, 3.0),
    ("5x5", 4, 2.0),
    ("5x5", None, 2.0),
    ("7x7", 2, 20.0),
)
"""Maze, view radius and seconds of the search."""
VIEWS: dict[str, Row] = {
    "own cell": {"view_radius": 0},
    "radius 1": {"view_radius": 1},
    "radius 2": {"view_radius": 2},
    "radius 3": {"view_radius": 3},
    "line of sight": {"line_of_sight": True},
    "everything": {},
}
PROVEN = {"radius 2": 2, "radius 3": 3}
"""The views for which the policy of the bound plays too."""
EPISODES = 100_000


def solved(name: str, radius: int | None, seconds: float) -> HiddenChaseSolution:
    """The bounds after a search of as many seconds of the processor."""
    maze = pursuit.load_maze(name)
    table = AStarEvader(epsilon=EPSILON).action_probabilities(maze)
    return solve_hidden_chase(maze, table, radius, seconds=seconds)


def bounds() -> Iterator[Row]:
    """A row for each problem."""
    for name, radius, seconds in PROBLEMS:
        began = process_time()
        found = solved(name, radius, seconds)
        row = {"maze": name, "radius": "" if radius is None else radius}
        row |= {"lower": found.lower, "upper": found.upper, "width": found.width}
        yield row | {"seconds": process_time() - began}


def chasers(view: str) -> Iterator[tuple[str, Policy]]:
    """The chasers of a view, by name."""
    evader = AStarEvader(epsilon=EPSILON)
    yield "searching", SearchingChaser()
    yield "sweeping", SweepingChaser()
    yield "belief, expected", BeliefChaser(evader, "expected")
    yield "belief, most likely", BeliefChaser(evader, "most_likely")
    if view in PROVEN:
        yield "proven", solved("5x5", PROVEN[view], 15.0).policy


def scripted() -> Iterator[Row]:
    """A row for each view and chaser."""
    for view, sight in VIEWS.items():
        for name, chaser in chasers(view):
            found = pursuit.evaluate(
                chaser,
                "chase",
                "chaser",
                maze="5x5",
                opponent_epsilon=EPSILON,
                episodes=EPISODES,
                **sight,
            )
            row = {"view": view, "chaser": name, "episodes": found.episodes}
            yield row | {"mean_steps": found.mean_steps, "ci95": found.ci95}


def main() -> None:
    """Write both files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parent, help="the folder of the files"
    )
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for name, rows in (("bounds", bounds()), ("scripted", scripted())):
        found = []
        for row in rows:
            print(name, *row.values(), flush=True)
            found.append(row)
            write_csv(out / f"{name}.csv", found)


if __name__ == "__main__":
    main()
