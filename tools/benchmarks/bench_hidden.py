"""Processor time until the bounds of an optimum with limited view reach given widths.

This is the table of docs/results/partial_observability.md; compilation is not included.

    python tools/benchmarks/bench_hidden.py
"""

from __future__ import annotations

from time import process_time

from pursuit import load_maze
from scripted_agents import AStarEvader, solve_hidden_chase

WIDTHS = (0.02, 0.01, 0.001)

PROBLEMS = (("5x5", 0, 60), ("5x5", 1, 60), ("5x5", 2, 20), ("5x5", 3, 5), ("7x7", 2, 60))
"""Maze, view radius and seconds."""


def main() -> None:
    """Print one line per problem."""
    for name, radius, seconds in PROBLEMS:
        maze = load_maze(name)
        table = AStarEvader(epsilon=0.2).action_probabilities(maze)
        solution = solve_hidden_chase(maze, table, radius, seconds=0.0)
        began, reached = process_time(), dict.fromkeys(WIDTHS, float("nan"))
        while process_time() - began < seconds and solution.width > 1e-5:
            solve_hidden_chase(maze, table, radius, seconds=0.5, resume=solution)
            for width in WIDTHS:
                if solution.width <= width and reached[width] != reached[width]:
                    reached[width] = process_time() - began
        times = "  ".join(f"{100 * width:g} %: {time:.1f} s" for width, time in reached.items())
        print(
            f"{name} radius {radius}: [{solution.lower:.4f}, {solution.upper:.4f}] "
            f"{100 * solution.width:.4f} % after {process_time() - began:.0f} s; {times}"
        )


if __name__ == "__main__":
    main()
