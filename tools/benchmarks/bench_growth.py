"""Scaling of the simulator with cells, agents and games: a table, and a plot on log axes.

python tools/benchmarks/bench_growth.py [--seconds 0.5] [--large 1000] [--plot docs/growth.png]

One core; half of the agents are chasers, half are evaders. Agent steps per second are game steps
times agents. Random: precomputed random actions. Scripted: all agents are A*, with their time.
"""

from __future__ import annotations

import argparse
import resource
from pathlib import Path
from time import perf_counter

import numpy as np

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import AStarChaser, AStarEvader
from train.reports.figures import pyplot, save

Row = tuple[str, int, int, int, float, float, float]
"""Varied quantity, cells, agents, games; agent steps per second: random, A* evaders, all A*."""


def agent_steps(task: Task, games: int, seconds: float, roles: tuple[str, ...]) -> float:
    """Agent steps per second, the best of five measurements; A* agents play `roles`."""
    simulator = Simulator(task, games)
    players = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
    seats = [players[role] if role in roles else None for role in task.seat_roles]
    shape = (8, games, task.num_agents)
    drawn = np.random.default_rng(0).integers(task.num_actions, size=shape, dtype=np.int32)

    def step(turn: int) -> None:
        actions = drawn[turn % 8]
        simulator.act(seats, actions)
        simulator.step(actions)

    step(0)
    best = 0.0
    for _ in range(5):
        turns, began = 0, perf_counter()
        while perf_counter() - began < seconds / 5:
            step(turns)
            turns += 1
        best = max(best, turns * games * task.num_agents / (perf_counter() - began))
    return best


def measured(what: str, maze: Maze, agents: int, games: int, seconds: float) -> Row:
    """One row of the table."""
    half = agents // 2
    task = Task(maze, num_chasers=half, num_evaders=half, max_steps=1000)
    speeds = [
        agent_steps(task, games, seconds, roles)
        for roles in ((), ("evader",), ("chaser", "evader"))
    ]
    row = (what, maze.num_cells, agents, games, *speeds)
    print("{:<8}{:>10,}{:>8}{:>8}{:>16,.0f}{:>16,.0f}{:>16,.0f}".format(*row), flush=True)
    return row  # type: ignore[return-value]


def draw(rows: list[Row], path: str) -> None:
    """Three plots on log axes: agent steps per second by cells, by agents, by games."""
    figure, axes = pyplot().subplots(1, 3, figsize=(11, 3.4), sharey=True)
    names = (("cells", "cells of the maze"), ("agents", "agents"), ("games", "games"))
    for axis, (column, (what, label)) in zip(axes, enumerate(names, start=1), strict=True):
        chosen = [row for row in rows if row[0] == what]
        for speed, name in ((4, "random"), (5, "scripted evaders"), (6, "all scripted")):
            axis.loglog(
                [row[column] for row in chosen],
                [row[speed] for row in chosen],
                marker="o",
                label=name,
            )
        axis.set_xlabel(label)
        axis.grid(visible=True, which="major", alpha=0.3)
    axes[0].set_ylabel("agent steps per second")
    axes[0].legend()
    figure.tight_layout()
    save(figure, Path(path), dpi=110)


def main() -> None:
    """Print the table, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=0.5, help="time of each measurement")
    parser.add_argument("--large", type=int, default=1000, help="rows of the largest maze")
    parser.add_argument("--plot", help="where to write the plot")
    given = parser.parse_args()
    heads = ("varied", "cells", "agents", "games", "random", "evaders", "all scripted")
    print("agent steps per second\n{:<8}{:>10}{:>8}{:>8}{:>16}{:>16}{:>16}".format(*heads))

    def maze(size: int) -> Maze:
        return generate_maze("prim", size, loops=0.1, seed=0)

    rows = []
    for agents in (2, 4, 8, 16, 32, 64, 128):
        rows.append(measured("agents", maze(15), agents, 1024, given.seconds))
    for games in (1, 16, 256, 4096, 32768):
        rows.append(measured("games", maze(15), 8, games, given.seconds))
    for size in (10, 20, 50, 100, 300, given.large):
        rows.append(measured("cells", maze(size), 100, 1, given.seconds))
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of the process: {most:,.0f} MB")
    if given.plot:
        draw(rows, given.plot)


if __name__ == "__main__":
    main()
