"""Games on graphs beside GraphChase's grid environment: equal captures, and steps per second.

git clone https://github.com/GraphChase/GraphChasePlatform
python tools/benchmarks/bench_graphs.py GraphChasePlatform [--games 300] [--seconds 1]

The clone must be of a commit with `env/grid_env.py`, such as bc3df5e. Random joint moves are played
in both; an agent that stays names its own cell in GraphChase.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import networkx
import numpy as np

import pursuit
from pursuit import chase_v0
from pursuit.mazes.maze import Maze
from pursuit.tasks.task import Task

SIDE, HORIZON = 7, 50


def play_both(grid_env: Any, grid_graph: Any, random: np.random.Generator) -> tuple[int, int, int]:
    """One game in both environments: the steps, and whether it ended by a capture, by a swap."""
    chaser, evader = (random.choice(SIDE * SIDE, 2, replace=False) + 1).tolist()
    theirs = grid_graph([chaser], [evader], [10**6], HORIZON, SIDE, SIDE, 0.9, 0.2)
    env = grid_env(theirs, nextstate_as_action=True)
    graph = networkx.Graph(theirs.graph)
    graph.remove_edges_from(list(networkx.selfloop_edges(graph)))
    graph = graph.subgraph(networkx.node_connected_component(graph, chaser))
    if evader not in graph:
        return 0, 0, 0
    maze = Maze.from_graph(graph)
    number = {int(name): cell for cell, name in enumerate(maze.cell_names)}
    task = Task(maze=maze, num_chasers=1, num_evaders=1, max_steps=HORIZON, stay_action=True)
    sim = pursuit.Simulator(task, num_games=1, auto_restart=False)
    sim.reset()
    sim.place([[number[chaser], number[evader]]])
    env.reset()
    for step in range(1, HORIZON):
        after = [int(random.choice([*graph[cell], cell])) for cell in (chaser, evader)]
        seen, _, ended, _, _ = env.step(np.array(after[::-1]))
        actions = [
            maze.num_moves
            if new == old
            else maze.neighbors[number[old]].tolist().index(number[new])
            for old, new in zip((chaser, evader), after, strict=True)
        ]
        sim.step(np.array([actions]))
        assert seen.tolist() == after[::-1]
        assert sim.positions[0].tolist() == [number[cell] for cell in after]
        swapped = after == [evader, chaser]
        assert bool(sim.terminated[0]) == (bool(ended) or swapped)
        if sim.terminated[0]:
            return step, int(ended), int(swapped)
        chaser, evader = after
    return step, 0, 0


def rate(step: Callable[[], object], per_call: int, seconds: float) -> float:
    """Steps per second."""
    step()
    calls, began = 0, perf_counter()
    while perf_counter() - began < seconds:
        step()
        calls += 1
    return calls * per_call / (perf_counter() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clone", type=Path)
    parser.add_argument("--games", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=1.0)
    given = parser.parse_args()
    sys.path.insert(0, str(given.clone))
    from env.grid_env import GridEnv  # type: ignore[import-not-found]
    from graph.grid_graph import GridGraph  # type: ignore[import-not-found]

    GridGraph.__abstractmethods__ = frozenset()  # one of its methods is missing, and not used
    random = np.random.default_rng(0)
    found = np.array([play_both(GridEnv, GridGraph, random) for _ in range(given.games)])
    steps, captures, swaps = found.sum(axis=0).tolist()
    print(f"{int((found[:, 0] > 0).sum())} games, {steps} steps with equal cells")
    print(f"{captures} equal captures, {swaps} swaps (a capture here, none there)")

    graph = networkx.grid_2d_graph(SIDE, SIDE)
    task = Task(maze=Maze.from_graph(graph), num_chasers=1, num_evaders=1, stay_action=True)
    theirs = GridEnv(GridGraph([1], [49], [10**6], 10**9, SIDE, SIDE))
    theirs.reset()
    one = chase_v0.parallel_env(maze=task.mazes[0], stay_action=True, observation="positions")
    one.reset(seed=0)
    batch = pursuit.Simulator(task, num_games=4096, seed=0)
    batch.reset()
    single = random.integers(5, size=(1000, 2))
    many = random.integers(5, size=(4096, 2)).astype(np.int32)

    def step_one(env: Any = one, at: list[int] = [0]) -> None:  # noqa: B006
        at[0] = (at[0] + 1) % 1000
        env.step(dict(zip(env.agents, single[at[0]].tolist(), strict=True)))
        if not env.agents:
            env.reset()

    def step_theirs(at: list[int] = [0]) -> None:  # noqa: B006
        at[0] = (at[0] + 1) % 1000
        theirs.step(single[at[0]])
        if at[0] == 0:
            theirs.reset()

    for name, step, per_call in (
        ("GraphChase GridEnv", step_theirs, 1),
        ("PettingZoo environment", step_one, 1),
        ("Simulator, 4096 games", lambda: batch.step(many), 4096),
    ):
        print(f"{name:<24}{rate(step, per_call, given.seconds):>14,.0f} steps/s")


if __name__ == "__main__":
    main()
