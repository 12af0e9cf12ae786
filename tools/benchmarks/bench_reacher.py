"""Speed of the arm: steps per second on one core, and ratios to environments of Gymnasium.

python tools/benchmarks/bench_reacher.py [--seconds 1]

MuJoCo's Reacher-v5, which simulates masses and contacts, is included if mujoco is installed.
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable
from time import process_time

import gymnasium
import numpy as np

from pursuit import ReacherSimulator, ReacherTask, reacher_v0
from train.machine import processor

ARMS = 4096
BARS = {2: 10e6, 8: 3e6}
"""Steps a second that the simulator is to make on one core."""


def rate(step: Callable[[], object], per_call: int, seconds: float) -> float:
    """`per_call` times the calls per second of processor time, the best of five.

    All measured code runs in one thread; processor time depends less on other programs.
    """
    step()
    best = 0.0
    for _ in range(5):
        calls, began = 0, process_time()
        while process_time() - began < seconds / 5:
            for _ in range(8):
                step()
            calls += 8
        best = max(best, calls * per_call / (process_time() - began))
    return best


def simulator_rate(joints: int, seconds: float, encoding: str | None = None) -> float:
    """Arm steps per second of the simulator with precomputed random actions."""
    simulator = ReacherSimulator(ReacherTask(joints), ARMS)
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (16, ARMS, joints))
    out = simulator.observe(encoding) if encoding else None
    turn = 0

    def step() -> None:
        nonlocal turn
        turn += 1
        simulator.step(drawn[turn % 16])
        if encoding:
            simulator.observe(encoding, out)

    return rate(step, ARMS, seconds)


def single_rate(env: gymnasium.Env, seconds: float) -> float:
    """Steps per second of one Gymnasium environment, including resets."""
    env.reset(seed=0)
    env.action_space.seed(0)
    drawn = [env.action_space.sample() for _ in range(64)]
    turn = 0

    def step() -> None:
        nonlocal turn
        turn += 1
        _, _, terminated, truncated, _ = env.step(drawn[turn % 64])
        if terminated or truncated:
            env.reset()

    return rate(step, 1, seconds)


def vector_rate(envs: gymnasium.vector.VectorEnv, seconds: float) -> float:
    """Steps per second of a Gymnasium vector environment."""
    envs.reset(seed=0)
    envs.action_space.seed(0)
    drawn = [envs.action_space.sample() for _ in range(8)]
    turn = 0

    def step() -> None:
        nonlocal turn
        turn += 1
        envs.step(drawn[turn % 8])

    return rate(step, envs.num_envs, seconds)


def parallel_rate(seconds: float) -> float:
    """Steps per second of the PettingZoo environment with two joints."""
    env = reacher_v0.parallel_env()
    env.reset(seed=0)
    turns = np.random.default_rng(0).uniform(-1.0, 1.0, (64, 2, 1)).astype(np.float32)
    drawn = [dict(zip(env.possible_agents, each, strict=True)) for each in turns]
    turn = 0

    def step() -> None:
        nonlocal turn
        turn += 1
        env.step(drawn[turn % 64])
        if not env.agents:
            env.reset()

    return rate(step, 1, seconds)


def main() -> None:
    """Run all benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="time of each measurement")
    seconds = parser.parse_args().seconds
    print(f"{processor()}, one thread; millions of arm steps per second, {ARMS} arms")
    print(f"{'joints':>8}{'simulator':>12}{'positions':>12}{'with angles':>13}")
    for joints in (1, 2, 4, 8):
        speeds = [
            simulator_rate(joints, seconds, encoding)
            for encoding in (None, "positions", "positions_angles")
        ]
        bar = BARS.get(joints)
        against = (
            f"   bar {bar / 1e6:.0f}: {'met' if speeds[0] >= bar else 'MISSED'}" if bar else ""
        )
        millions = [speed / 1e6 for speed in speeds]
        print(f"{joints:>8}{millions[0]:>12.1f}{millions[1]:>12.1f}{millions[2]:>13.1f}{against}")

    def make(name: str) -> gymnasium.Env:
        return gymnasium.make(name).unwrapped

    def make_vec(name: str, num_envs: int, **settings: str) -> gymnasium.vector.VectorEnv:
        return gymnasium.make_vec(name, num_envs=num_envs, **settings)

    ours: dict[str, float] = {
        "one Gymnasium env": single_rate(make("pursuit/Reacher-v0"), seconds),
        "one PettingZoo env": parallel_rate(seconds),
        "vector env, 64": vector_rate(make_vec("pursuit/Reacher-v0", 64), seconds),
        "vector env, 4096": vector_rate(make_vec("pursuit/Reacher-v0", ARMS), seconds),
    }
    peers: dict[str, Callable[[], float]] = {
        "Pendulum-v1": lambda: single_rate(make("Pendulum-v1"), seconds),
        "Pendulum-v1, vector, 64": lambda: vector_rate(
            make_vec("Pendulum-v1", 64, vectorization_mode="sync"), seconds
        ),
        "CartPole-v1, NumPy, 4096": lambda: vector_rate(
            make_vec("CartPole-v1", ARMS, vectorization_mode="vector_entry_point"), seconds
        ),
    }
    if importlib.util.find_spec("mujoco") is not None:
        peers["MuJoCo Reacher-v5"] = lambda: single_rate(make("Reacher-v5"), seconds)
    measured = {name: measure() for name, measure in peers.items()}
    print("\nsteps per second with two joints, and ratios to other environments")
    print(f"{'':<26}{'steps/s':>12}" + "".join(f"{name:>26}" for name in measured))
    for name, speed in ours.items():
        ratios = "".join(f"{speed / other:>25.3g}x" for other in measured.values())
        print(f"{name:<26}{speed:>12,.0f}{ratios}")
    for name, speed in measured.items():
        print(f"{name:<26}{speed:>12,.0f}")


if __name__ == "__main__":
    main()
