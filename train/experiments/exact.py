"""The part of a sweep that needs no learning: states and mean optimal tours."""

from __future__ import annotations

from pathlib import Path

from pursuit.mazes.maze import load_maze
from scripted_agents.tours.tour import expected_tour_length, num_states
from train.experiments.forms import EXACT, Exact
from train.files import write_text
from train.reports.tables import Row, in_markdown, plain_table


def write_exact(title: str, exact: Exact, out: Path) -> str:
    """The table of states and mean optimal tours that needs no learning.

    Returns:
        The table as Markdown, which is in `out/exact.md` too.
    """
    mazes, goals = exact.mazes, exact.goals
    words = {g: f"{g} goal{'s' if g > 1 else ''}" for g in goals}
    rows = []
    for name in mazes:
        maze = load_maze(name)
        row: Row = {"maze": name, "cells": maze.num_cells}
        row |= {
            f"states, {told}": f"{num_states(maze.num_cells, g):,}" for g, told in words.items()
        }
        for number, told in words.items():
            mean = expected_tour_length(maze, number)
            row[f"mean optimum, {told}"] = (
                f"{mean:.4f}" if mean.exact else f"{mean:.3f} ± {mean.ci95:.3f}"
            )
        rows.append(row)
    text = (
        f"# {in_markdown(title)}\n\n{plain_table(rows).markdown()}\n\n"
        "Means over all placements; those with ± are of samples, the others exact.\n"
    )
    write_text(out / EXACT, text)
    return text
