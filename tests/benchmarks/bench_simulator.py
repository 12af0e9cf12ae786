"""Speed of the world: steps per second, ratios against peers in the same run, and how it scales.

python tests/benchmarks/bench_simulator.py [--seconds 1]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

import gymnasium
import numpy as np

from pursuit.maze_generation import generate_maze
from pursuit.task import Task, make_task
from train.commands.bench import parallel_env_rate, rate, simulator_rate


def peers() -> dict[str, Callable[[float], float]]:
    """Steps per second of other environments, one process, random actions; those installed."""
    found: dict[str, Callable[[float], float]] = {}

    def parallel(env: object, seconds: float) -> float:
        env.reset(seed=0)
        spaces = {agent: env.action_space(agent) for agent in env.possible_agents}
        generator = np.random.default_rng(0)
        drawn = [
            {agent: int(generator.integers(space.n)) for agent, space in spaces.items()}
            for _ in range(64)
        ]
        turn = 0

        def step() -> None:
            nonlocal turn
            turn += 1
            env.step({agent: drawn[turn % 64][agent] for agent in env.agents})
            if not env.agents:
                env.reset()

        return rate(step, 1, seconds)

    def single(env: gymnasium.Env, seconds: float) -> float:
        env.reset(seed=0)
        actions = np.random.default_rng(0).integers(env.action_space.n, size=64).tolist()
        turn = 0

        def step() -> None:
            nonlocal turn
            turn += 1
            _, _, terminated, truncated, _ = env.step(actions[turn % 64])
            if terminated or truncated:
                env.reset()

        return rate(step, 1, seconds)

    try:
        from pettingzoo.sisl import pursuit_v5

        make = partial(pursuit_v5.parallel_env, x_size=7, y_size=7, n_pursuers=1, n_evaders=1)
        found["PettingZoo sisl pursuit_v5, 1v1, 7x7"] = lambda s: parallel(make(n_catch=1), s)
    except ImportError:
        pass
    try:
        from mpe2 import simple_tag_v3

        found["mpe2 simple_tag, 1v1"] = lambda s: parallel(
            simple_tag_v3.parallel_env(num_good=1, num_adversaries=1, num_obstacles=2), s
        )
    except ImportError:
        pass
    try:
        import minigrid  # noqa: F401  (registers its ids)

        found["MiniGrid Empty-8x8"] = lambda s: single(gymnasium.make("MiniGrid-Empty-8x8-v0"), s)
    except ImportError:
        pass
    return found


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="time of each measurement")
    seconds = parser.parse_args().seconds
    chase = make_task("chase", maze="7x7")
    ours = {
        "Simulator 7x7 1v1, 4096 games, scripted evader": simulator_rate(chase, 4096, seconds),
        "  the same with the 'index' observation": simulator_rate(
            chase, 4096, seconds, encoding="index"
        ),
        "  the same with the 'one_hot' observation": simulator_rate(
            chase, 4096, seconds, encoding="one_hot"
        ),
        "  no scripted agent, no observation": simulator_rate(chase, 4096, seconds, scripted=False),
        "PettingZoo env chase_v0 5x5, one game, one_hot": parallel_env_rate(seconds),
    }
    others = {name: measure(seconds) for name, measure in peers().items()}
    print("steps per second, and how many times each peer's")
    print(f"{'':<52}{'steps/s':>14}" + "".join(f"{name.split(',')[0]:>26}" for name in others))
    for name, speed in ours.items():
        ratios = "".join(f"{speed / other:>25,.0f}x" for other in others.values())
        print(f"{name:<52}{speed:>14,.0f}{ratios}")
    for name, speed in others.items():
        print(f"{name:<52}{speed:>14,.0f}")

    print("\nby maze, 1v1, scripted evader, 4096 games (above 4096 cells: searches, no tables)")
    for size in (5, 9, 15, 31, 64, 100):
        maze = generate_maze("prim", size, loops=0.1, seed=0)
        speed = simulator_rate(make_task("chase", maze=maze), 4096, seconds)
        print(f"{f'{size}x{size}':>10}{speed:>16,.0f}")
    print("\nby agents, 7x7, all but the first chaser scripted, 4096 games")
    for team in (1, 2, 4, 8):
        task = Task("7x7", num_chasers=team, num_evaders=team)
        print(f"{f'{team}v{team}':>10}{simulator_rate(task, 4096, seconds):>16,.0f}")
    print("\nby games, 7x7, 1v1, scripted evader")
    for games in (1, 16, 256, 4096, 65536):
        print(f"{games:>10}{simulator_rate(chase, games, seconds):>16,.0f}")


if __name__ == "__main__":
    main()
