"""The part of a sweep that needs no learning: states and mean optimal tours."""

from __future__ import annotations

from pathlib import Path

from pursuit.maze import load_maze
from scripted_agents.tour import MAX_EXACT_GOALS, expected_tour_length, num_states
from train.experiments.forms import EXACT, Exact
from train.files import write_text
from train.result_table import in_markdown


def write_exact(title: str, exact: Exact, out: Path) -> str:
    """The table of states and mean optimal tours that needs no learning.

    Returns:
        The table as Markdown, which is in `out/exact.md` too.
    """
    mazes, goals = exact.mazes, exact.goals
    heads = [f"states, {g} goal{'s' if g > 1 else ''}" for g in goals]
    heads += [
        f"mean {'optimum' if g <= MAX_EXACT_GOALS else 'heuristic tour'}, {g} goal"
        f"{'s' if g > 1 else ''}"
        for g in goals
    ]
    lines = [f"# {in_markdown(title)}", "", "| maze | cells | " + " | ".join(heads) + " |"]
    lines.append("|---|---|" + "---|" * len(heads))
    for name in mazes:
        maze = load_maze(name)
        cells = [f"{num_states(maze.num_cells, g):,}" for g in goals]
        for number in goals:
            mean = expected_tour_length(maze, number)
            cells.append(f"{mean:.4f}" if mean.exact else f"{mean:.3f} ± {mean.ci95:.3f}")
        lines.append(f"| {in_markdown(name)} | {maze.num_cells} | " + " | ".join(cells) + " |")
    lines += ["", "Means over all placements; those with ± are of samples, the others exact."]
    text = "\n".join(lines) + "\n"
    write_text(out / EXACT, text)
    return text
