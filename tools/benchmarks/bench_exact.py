"""Milliseconds of the exact references: `python tools/benchmarks/bench_exact.py`."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze
from scripted_agents.exact.duel.best_response import best_response, evaluate_exactly
from scripted_agents.exact.tours.tour import (
    expected_tour_length,
    shortest_path,
    shortest_tour,
    tour_lengths,
)


def greedy_table(maze: Maze, epsilon: float, flees: bool) -> NDArray[np.float64]:
    """A random move with probability epsilon, otherwise one that shortens (lengthens) the path."""
    after = maze.neighbors[:, :4]
    moves = after != np.arange(maze.num_cells)[:, None]
    distances = maze.distances[after].transpose(0, 2, 1) * (-1 if flees else 1)
    distances = np.where(moves[:, None], distances, 2**30)
    best = distances == distances.min(axis=2, keepdims=True)
    uniform = (moves / moves.sum(axis=1, keepdims=True))[:, None]
    table: NDArray[np.float64] = epsilon * uniform + (1 - epsilon) * best / best.sum(
        axis=2, keepdims=True
    )
    return table


def show(name: str, call: Callable[..., Any], *arguments: Any, **settings: Any) -> None:
    """Print the shortest of three calls, and the first call, which includes compilation."""
    times = []
    for _ in range(4):
        start = time.perf_counter()
        call(*arguments, **settings)
        times.append(1000 * (time.perf_counter() - start))
    print(f"{name:50s} {min(times[1:]):10.2f} ms   (first {times[0]:.0f} ms)", flush=True)


def main() -> None:
    """Run all benchmarks."""
    for size in (5, 9, 15, 31):
        maze = generate_maze("prim", height=size, width=size, loops=0.1, seed=0)
        chaser, evader = greedy_table(maze, 0.2, False), greedy_table(maze, 0.2, True)
        name = f"{size}x{size}, horizon"
        show(f"best_response chaser {name} 200", best_response, "chaser", maze, evader)
        show(f"best_response evader {name} 200", best_response, "evader", maze, chaser)
        show(f"evaluate_exactly {name} 200", evaluate_exactly, maze, chaser, evader)
        show(f"best_response chaser {name} None", best_response, "chaser", maze, evader, None)
    for size in (9, 15):
        maze = generate_maze("prim", height=size, width=size, loops=0.1, seed=0)
        show(f"expected_tour_length {size}x{size}, 3 goals", expected_tour_length, maze, 3)
        show(f"20 000 samples {size}x{size}, 8 goals", expected_tour_length, maze, 8)
    rng = np.random.default_rng(0)
    for num_goals in (10, 15, 18, 30, 100):
        places = rng.choice(maze.num_cells, num_goals + 1, replace=False)
        show(f"shortest_tour, {num_goals} goals", shortest_tour, maze, places[0], places[1:])
    places = rng.random((4096, maze.num_cells)).argsort(axis=1)[:, :4]
    show("tour_lengths, 4096 x 3 goals", tour_lengths, maze, places[:, 0], places[:, 1:])
    maze = generate_maze("prim", height=1000, width=1000, loops=0.1, seed=0)
    show("shortest_path across 1000x1000", shortest_path, maze, 0, maze.num_cells - 1)


if __name__ == "__main__":
    main()
