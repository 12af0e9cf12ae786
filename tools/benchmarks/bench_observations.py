"""Speed of the simulator with observations of all agents; beside other libraries: bench_peers.py.

python tools/benchmarks/bench_observations.py [--seconds 0.3] [--turns 5]

Environment steps per processor second, actions at random, the median of measurements in turns.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from itertools import count
from time import perf_counter, process_time

import numpy as np

from pursuit.mazes.generation import generate_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from train.machine import processor

Step = Callable[[], object]
SIDE, CHASERS, EVADERS = 45, 25, 50
CASES = (
    (f"{CHASERS} against {EVADERS}, {SIDE}x{SIDE}", 16, ("window:4",)),
    ("1 against 1, 7x7", 4096, ("planes", "window:3")),
)


def ours() -> Iterator[tuple[str, int, Step]]:
    """Name, games and step of every case without observations, and with those of all agents."""
    maze = generate_maze("prim", height=SIDE, width=SIDE, loops=0.1, seed=0)
    tasks = Task(maze, CHASERS, EVADERS, max_steps=200), make_task("chase", maze="7x7")
    for task, (name, games, encodings) in zip(tasks, CASES, strict=True):
        yield f"{name}, no observations", games, stepping(task, games)
        for encoding in encodings:
            for dtype in ("float32", "uint8"):
                yield f"{name}, {encoding} {dtype}", games, stepping(task, games, encoding, dtype)


def stepping(task: Task, games: int, encoding: str = "", dtype: str = "") -> Step:
    """A step of a batch of games, with observations into the same array each time."""
    simulator, turns = Simulator(task, games), count()
    drawn = np.random.default_rng(0).integers(
        task.num_actions, size=(16, games, task.num_agents), dtype=np.int32
    )
    out = simulator.observe(encoding, dtype=dtype) if encoding else None

    def step() -> None:
        simulator.step(drawn[next(turns) % 16])
        if encoding:
            simulator.observe(encoding, out=out, dtype=dtype)

    return step


def main() -> None:
    """Print all cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=0.3, help="time of each measurement")
    parser.add_argument("--turns", type=int, default=5, help="measurements of each case")
    given = parser.parse_args()
    cases = list(ours())
    found = np.zeros((len(cases), given.turns))
    for turn in range(given.turns):
        for number, (_, each, step) in enumerate(cases):
            step()
            calls, start, began = 0, process_time(), perf_counter()
            while perf_counter() - began < given.seconds:
                step()
                calls += 1
            found[number, turn] = calls * each / (process_time() - start)
    print(f"{processor()}: steps per processor second")
    for (name, _, _), rates in zip(cases, found, strict=True):
        print(f"{name:<52}{np.median(rates):>14,.0f}")


if __name__ == "__main__":
    main()
