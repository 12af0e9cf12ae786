"""Speed with observations of all agents: the simulator beside MAgent2, POGEMA and jumanji.

python tools/benchmarks/bench_observations.py [--seconds 0.3] [--turns 5]

Environment steps per processor second, actions at random, the median of measurements in turns. The
peers that are not installed are left out: pip install magent2 pogema jumanji.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from time import perf_counter, process_time
from typing import Any

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


def magent2() -> tuple[str, int, Step]:
    """MAgent2's adversarial pursuit: 25 predators and 50 prey on its default map."""
    from magent2.environments import adversarial_pursuit_v4

    env = adversarial_pursuit_v4.parallel_env(map_size=SIDE)
    env.reset(seed=0)
    most = {agent: env.action_space(agent).n for agent in env.possible_agents}
    drawn = np.random.default_rng(0).random(4096)
    turns = count()

    def step() -> None:
        turn = next(turns)
        chosen = {
            agent: int(drawn[(turn + 7 * number) % 4096] * most[agent])
            for number, agent in enumerate(env.agents)
        }
        env.step(chosen)
        if not env.agents:
            env.reset()

    return "MAgent2 adversarial_pursuit_v4, 25 against 50", 1, step


def pogema() -> tuple[str, int, Step]:
    """POGEMA: as many agents, the same size of map and windows; its episodes have no end."""
    from pogema import GridConfig
    from pogema.envs import PogemaLifeLong  # its makers need an older Gymnasium

    agents = CHASERS + EVADERS
    env: Any = PogemaLifeLong(
        GridConfig(num_agents=agents, size=SIDE, obs_radius=4, density=0.3, on_target="restart")
    )
    env.reset(seed=0)
    drawn, turns = np.random.default_rng(0).integers(5, size=(64, agents)).tolist(), count()
    name = f"POGEMA, {agents} agents, windows of radius 4"
    return name, 1, lambda: env.step(drawn[next(turns) % 64])


def jumanji() -> tuple[str, int, Step]:
    """Jumanji's Maze, 4096 games, 64 steps in one compiled call."""
    import jax
    from jumanji.environments import Maze
    from jumanji.environments.routing.maze.generator import RandomGenerator
    from jumanji.wrappers import VmapAutoResetWrapper

    env = VmapAutoResetWrapper(Maze(generator=RandomGenerator(num_rows=7, num_cols=7)))
    games, length = 4096, 64
    state, _ = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), games))
    actions = jax.random.randint(jax.random.PRNGKey(1), (length, games), 0, 4)

    def one(state: Any, chosen: Any) -> Any:
        state, timestep = env.step(state, chosen)
        return state, timestep.observation.walls.sum()

    run = jax.jit(partial(jax.lax.scan, one))
    return (
        "jumanji Maze 7x7, ×4096",
        games * length,
        lambda: jax.block_until_ready(run(state, actions)),
    )


def main() -> None:
    """Print all cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=0.3, help="time of each measurement")
    parser.add_argument("--turns", type=int, default=5, help="measurements of each case")
    given = parser.parse_args()
    cases = list(ours())
    for peer in (magent2, pogema, jumanji):
        try:
            cases.append(peer())
        except ImportError as error:
            print(f"without {peer.__name__}, which is not installed ({error})")
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
