"""How hard a maze is, measured: its paths, and how long chases in it last.

`python -m scripted_agents.graphs.difficulty` writes the measures of the frozen suites beside them
anew, in an hour.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from pursuit.mazes.maze import Maze, load_maze
from pursuit.mazes.suites import freeze, load_suite, suite_names
from scripted_agents.agents.scripted import AStarChaser, AStarEvader
from scripted_agents.duel.best_response import best_response, evaluate_exactly, mean_over_starts
from scripted_agents.tours.tour import expected_tour_length

EPSILON = 0.2
"""Share of random moves of the evader of the chases."""

GOALS = 3
"""Of the tours."""

HORIZON = 200
"""Steps after which a chase is cut."""


@dataclass(frozen=True)
class Difficulty:
    """The measures of a maze.

    Attributes:
        cells: walkable ones.
        loops: independent cycles; 0 for a tree.
        dead_ends: cells with one neighbour.
        longest_path: steps of the longest shortest path.
        mean_path: mean steps of the shortest path between two cells, over all ordered pairs: the
            optimum of a runner with one goal.
        mean_tour: mean steps of the shortest tour of GOALS goals, over all placements.
        a_star_chase: mean steps, over all starts, in which the A* chaser (epsilon 0) catches the A*
            evader with epsilon EPSILON; at most HORIZON.
        optimal_chase: the same of the exact best response to that evader.
    """

    cells: int
    loops: int
    dead_ends: int
    longest_path: int
    mean_path: float
    mean_tour: float
    a_star_chase: float
    optimal_chase: float


def maze_difficulty(maze: str | Path | Maze) -> Difficulty:
    """The measures of a connected maze; 15x15 cells take half a second.

    Raises:
        ValueError: no such maze, or one that is not connected or has less than 4 cells.
    """
    maze = load_maze(maze)
    if maze.num_cells <= GOALS or not maze.is_connected:
        raise ValueError(
            f"{maze.name}: {maze.num_cells} cells in {maze.num_components} part(s); the measures "
            f"are of connected mazes of {GOALS + 1} cells or more"
        )
    evader = AStarEvader(epsilon=EPSILON).action_probabilities(maze)
    chaser = AStarChaser(epsilon=0.0).action_probabilities(maze)
    chased = evaluate_exactly(maze, chaser, evader, horizon=HORIZON)
    best = best_response("chaser", maze, evader, horizon=HORIZON)
    return Difficulty(
        maze.num_cells,
        maze.num_loops,
        len(maze.dead_ends),
        maze.longest_distance,
        float(expected_tour_length(maze, 1)),
        float(expected_tour_length(maze, GOALS)),
        mean_over_starts(chased, maze),
        mean_over_starts(best.values, maze),
    )


def difficulty_table(mazes: Sequence[Maze]) -> str:
    """The measures of mazes as CSV text, a maze a row, to four decimals."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["maze", *(field.name for field in fields(Difficulty))])
    for maze in mazes:
        measures = astuple(maze_difficulty(maze))
        told = [each if isinstance(each, int) else f"{each:.4f}" for each in measures]
        writer.writerow([maze.name, *told])
    return text.getvalue()


if __name__ == "__main__":
    for _name in suite_names():
        freeze({f"{_name}-difficulty.csv": difficulty_table(load_suite(_name)).encode()})
