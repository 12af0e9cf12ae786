"""Speed of the simulator by size, view, agents and games; bench_peers.py: one size, and peers.

python tools/benchmarks/bench_simulator.py [--seconds 1]
python tools/benchmarks/bench_simulator.py --against 501f81b [--turns 15] [--only 8v8]

`--against` compares this version with another one, a folder or a git revision, in separate
processes, and prints the time per step of both and the ratio. Measurements of a case alternate, as
the speed of a machine changes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from itertools import cycle
from time import perf_counter
from typing import Any

import numpy as np
from in_turns import add_options, compare

from pursuit.mazes.generation import generate_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents.environments import default_policies


def rate(step: Callable[[], object], per_call: int, seconds: float) -> float:
    """`per_call` times the calls per second, the best of three measurements."""
    step()
    best = 0.0
    for _ in range(3):
        calls, began = 0, perf_counter()
        while perf_counter() - began < seconds / 3:
            for _ in range(8):
                step()
            calls += 8
        best = max(best, calls * per_call / (perf_counter() - began))
    return best


def simulator_step(
    task: Task, num_games: int, scripted: bool = True, encoding: str | None = None
) -> Callable[[], None]:
    """A step of a batch: the first agent moves at random, the others are scripted.

    Args:
        task: the task.
        num_games: games in the batch.
        scripted: whether the others are scripted; False: precomputed random moves for all.
        encoding: also encode the observation of the first agent in each step.
    """
    simulator = Simulator(task, num_games)
    generator = np.random.default_rng(0)
    shape = (16, num_games, task.num_agents)
    drawn = generator.integers(task.num_actions, size=shape, dtype=np.int32)
    policies = default_policies(task, 0.2)
    seats = [policies[role] if scripted else None for role in task.seat_roles]
    seats[0] = None
    out = simulator.observe(encoding, 0) if encoding else None
    turns = cycle(drawn)

    def step() -> None:
        actions = next(turns)
        simulator.act(seats, actions)
        simulator.step(actions)
        if encoding:
            simulator.observe(encoding, 0, out=out)

    return step


def simulator_rate(task: Task, num_games: int, seconds: float = 1.0, **options: Any) -> float:
    """Game steps per second of `simulator_step`."""
    return rate(simulator_step(task, num_games, **options), num_games, seconds)


SIGHTS: dict[str, dict[str, object]] = {
    "full": {},
    "radius 2": {"view_radius": 2},
    "line of sight": {"line_of_sight": True},
    "radius 2, unknown maze": {"view_radius": 2, "unknown_maze": True},
}


def sights(seconds: float, turns: int = 5) -> None:
    """Print the best steps per second by encoding and view, and their ratio to full view."""
    drawn = np.random.default_rng(0).integers(4, size=(16, 4096, 2), dtype=np.int32)
    for encoding in ("index", "one_hot", "planes", "window:2"):

        def step(
            simulator: Simulator, out: np.ndarray, turn: int, encoding: str = encoding
        ) -> None:
            simulator.step(drawn[turn % 16])
            simulator.observe(encoding, out=out)

        games = [
            Simulator(make_task("chase", maze="7x7", **sight), 4096) for sight in SIGHTS.values()
        ]
        outs = [simulator.observe(encoding) for simulator in games]
        best = [float("inf")] * len(games)
        for _ in range(turns):
            for number, (simulator, out) in enumerate(zip(games, outs, strict=True)):
                began = perf_counter()
                while perf_counter() - began < seconds / turns:
                    start = perf_counter()
                    for turn in range(8):
                        step(simulator, out, turn)
                    best[number] = min(best[number], (perf_counter() - start) / 8)
        for name, least in zip(SIGHTS, best, strict=True):
            share = best[0] / least
            print(f"{encoding:>10}  {name:<24}{4096 / least:>14,.0f}{share:>8.0%}")


# -- comparison of two versions --------------------------------------------------------------------

# Runs in both versions, so it uses only names that exist in both.
MEASURE = """
import json, sys
from time import perf_counter
from typing import Any
import numpy as np
from pursuit import Simulator, Task, chase_v0, make_task
from pursuit import chase_v0
from pursuit.mazes.generation import generate_maze
from scripted_agents.environments import default_policies

def nanoseconds(call, per_call, seconds):
    times, began, turn = [], perf_counter(), 0
    while perf_counter() - began < seconds:
        start = perf_counter()
        for turn in range(turn, turn + 8):
            call(turn)
        times.append((perf_counter() - start) / 8)
    return float(np.quantile(times, 0.1)) * 1e9 / per_call

def batch(task, games, scripted=False, encoding=None, free=1):
    simulator = Simulator(task, games)
    simulator.reset()
    shape = (16, games, task.num_agents)
    drawn = np.random.default_rng(0).integers(task.num_actions, size=shape, dtype=np.int32)
    policies = default_policies(task, 0.2)
    seats = [policies[role] if scripted else None for role in task.seat_roles]
    seats[:free] = [None] * free
    out = simulator.observe(encoding, 0) if encoding else None
    def call(turn):
        simulator.act(seats, drawn[turn % 16])
        simulator.step(drawn[turn % 16])
        if encoding:
            simulator.observe(encoding, 0, out=out)
    return call, games

def single():
    env = chase_v0.parallel_env(maze="5x5")
    env.reset(seed=0)
    pairs = np.random.default_rng(0).integers(4, size=(256, 2)).tolist()
    drawn = [dict(zip(env.possible_agents, pair)) for pair in pairs]
    def call(turn):
        env.step(drawn[turn % 256])
        if not env.agents:
            env.reset()
    return call, 1

duel = make_task("chase", maze="7x7")
cases = {
    "duel, random actions": (duel, 4096),
    "duel, scripted evader": (duel, 4096, True),
    "duel, scripted evader and index": (duel, 4096, True, "index"),
    "duel, one game": (duel, 1),
    "one runner, 3 goals": (Task("7x7", num_runners=1, num_goals=3), 4096),
    "one PettingZoo game": (),
}
for team in (2, 4, 8):
    task = Task("7x7", num_chasers=team, num_evaders=team)
    cases[f"{team}v{team}, random actions"] = (task, 4096)
    cases[f"{team}v{team}, scripted"] = (task, 4096, True)
    cases[f"{team}v{team}, all scripted"] = (task, 4096, True, None, 0)
cases["duel, all scripted"] = (duel, 4096, True, None, 0)
for size, team, games in ((100, 1, 64), (300, 50, 1), (1000, 50, 1)):
    maze = generate_maze("prim", size, loops=0.1, seed=0)
    task = Task(maze, num_chasers=team, num_evaders=team, max_steps=100)
    cases[f"{size}x{size}, {team}v{team}, all scripted"] = (task, games, True, None, 0)
print(json.dumps(list(cases)), flush=True)
made = {}
for line in sys.stdin:
    name, seconds = json.loads(line)
    if name not in made:
        call, per_call = made[name] = batch(*cases[name]) if cases[name] else single()
        began = perf_counter()
        for turn in range(300):
            call(turn)
            if perf_counter() - began > 3:
                break
    print(json.dumps(nanoseconds(*made[name], seconds)), flush=True)
"""


def main() -> None:
    """Run all benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="time of each measurement")
    add_options(parser, turns=15)
    given = parser.parse_args()
    seconds = given.seconds
    if given.against:
        compare(MEASURE, given.against, seconds, given.turns, given.only)
        return
    chase = make_task("chase", maze="7x7")
    print("steps per second by maze, 1v1, scripted evader, 4096 games")
    print("(above 4096 cells: searches, no tables)")
    for size in (5, 9, 15, 31, 64, 100):
        maze = generate_maze("prim", size, loops=0.1, seed=0)
        speed = simulator_rate(make_task("chase", maze=maze), 4096, seconds)
        print(f"{f'{size}x{size}':>10}{speed:>16,.0f}")
    print("\nby view, 7x7, random actions, both agents observe, 4096 games: steps/s")
    sights(seconds)
    print("\nby agents, 7x7, all but the first chaser scripted, 4096 games")
    for team in (1, 2, 4, 8):
        task = Task("7x7", num_chasers=team, num_evaders=team)
        print(f"{f'{team}v{team}':>10}{simulator_rate(task, 4096, seconds):>16,.0f}")
    print("\nby games, 7x7, 1v1, scripted evader")
    for games in (1, 16, 256, 4096, 65536):
        print(f"{games:>10}{simulator_rate(chase, games, seconds):>16,.0f}")


if __name__ == "__main__":
    main()
