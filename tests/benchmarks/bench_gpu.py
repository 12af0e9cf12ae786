"""Games and training on a GPU: `python tests/benchmarks/bench_gpu.py [GAMES ...]`.

Needs an NVIDIA GPU, a CUDA build of torch and `pip install pursuit[gpu]`; it prints the card's
name, steps a second of the simulator on the GPU and on one core of the CPU, and frames a second of
PPO and gradient steps a second of DQN, with CUDA graphs and without. Nobody has run it yet: no
figure of a GPU is known.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import torch
from numba import cuda

from pursuit.simulator import Simulator
from pursuit.single_agent import fill_seats
from pursuit.task import make_task
from scripted_agents import AStarChaser, AStarEvader
from train.algorithms import dqn, ppo
from train.algorithms.graphs import CudaGraphs
from train.algorithms.learner import Build
from train.environments.device_env import DeviceEnv
from train.networks.policy import Seat
from train.settings.algorithms import PPOSettings
from train.settings.off_policy import DQNSettings

GAMES = (4096, 65536, 1048576)
ROUNDS = 5


def best_rate(run: Callable[[], None], count: int, wait: Callable[[], None]) -> float:
    """The most of `count` things a second, of ROUNDS of `run`; the first time is not counted."""
    run()
    wait()
    least = float("inf")
    for _ in range(ROUNDS):
        began = time.perf_counter()
        run()
        wait()
        least = min(least, time.perf_counter() - began)
    return count / least


def simulator_rate(games: int, device: str, encoding: str | None, steps: int = 100) -> float:
    """Game steps a second of a duel in which both seats are scripted."""
    simulator: Any = Simulator(make_task("chase", maze="7x7"), games, device=device)
    policies = [AStarChaser(0.1), AStarEvader(0.1)]
    on_cpu = device == "cpu"
    actions = None if not on_cpu else torch.zeros(games, 2, dtype=torch.int32).numpy()

    def run() -> None:
        for _ in range(steps):
            simulator.act(policies, actions)
            simulator.step(actions)
            if encoding is not None:
                simulator.observe(encoding, 0)

    return best_rate(run, games * steps, (lambda: None) if on_cpu else cuda.synchronize)


def duel_of(games: int) -> Any:
    """Training games of a chaser."""
    task = make_task("chase", maze="7x7")
    seat = Seat(task, "chaser_0", "index")
    opponents: Any = {"chaser": AStarChaser(), "evader": AStarEvader(0.2)}
    _, policies = fill_seats(task, "chaser_0", opponents)
    simulator: Any = Simulator(task, games, auto_restart=False, device="cuda")
    return DeviceEnv(simulator, seat, policies)


def build_of(graphs: bool) -> Build:
    """On the GPU, in bfloat16, with graphs or without."""
    return Build("cuda", bfloat16=True, graphs=CudaGraphs("cuda") if graphs else None)


def training_rate(games: int, width: int, graphs: bool) -> tuple[float, str]:
    """Frames a second of PPO in a duel, collecting and learning; and what was not captured."""
    settings = PPOSettings(num_games=games, width=width, minibatch_size=4 * games)
    learner = ppo.build(settings, duel_of(games), build_of(graphs))
    for _ in range(2):  # the second captures
        learner.iterate(0.0)
    rate = best_rate(
        lambda: void(learner.iterate(0.0)), games * settings.rollout_steps, torch.cuda.synchronize
    )
    works = [learner.repeated, getattr(learner.collector, "repeated", None)]
    return rate, "; ".join(str(work.refused) for work in works if work and work.refused)


def off_policy_rate(games: int, graphs: bool) -> float:
    """Gradient steps a second of DQN in a duel, with the rollouts that belong to them."""
    sizes: Any = {"num_games": games, "learning_starts": games, "batch_size": 1024}
    settings = DQNSettings(**sizes, gradient_steps=64, prioritized=True, buffer_size=64 * games)
    learner = dqn.build(settings, duel_of(games), build_of(graphs))
    for _ in range(4):
        learner.iterate(0.0)
    return best_rate(
        lambda: void(learner.iterate(0.0)), settings.gradient_steps, torch.cuda.synchronize
    )


def void(_: Any) -> None:
    """Take anything, and give nothing."""


def main(batches: tuple[int, ...]) -> None:
    if not torch.cuda.is_available() or not cuda.is_available():
        sys.exit("no GPU here, for torch and numba: there is nothing to measure")
    print(f"{torch.cuda.get_device_name()}; torch {torch.__version__}")
    print("\nsteps a second of a chase on 7x7, both scripted")
    for games in batches:
        for encoding in (None, "index", "one_hot"):
            rate = simulator_rate(games, "cuda", encoding)
            print(f"{games:9,} games, observed: {encoding or 'nothing':8} {rate / 1e6:10.2f} M")
    own = simulator_rate(4096, "cpu", "index")
    print(f"one core of the CPU, 4,096 games, index: {own / 1e6:.2f} M")
    print("\nframes a second of PPO, bfloat16")
    for games in batches[:2]:
        for width in (128, 256):
            for graphs in (False, True):
                rate, refused = training_rate(games, width, graphs)
                how = f"CUDA graphs {refused}" if graphs else "no graphs"
                print(f"{games:9,} games, {width}x{width}, {rate / 1e6:10.3f} M, {how}")
    print("\ngradient steps a second of DQN, bfloat16, batches of 1,024, with its rollouts")
    for graphs in (False, True):
        rate = off_policy_rate(batches[0], graphs)
        print(f"{batches[0]:9,} games, {rate:10.0f}, {'CUDA graphs' if graphs else 'no graphs'}")


if __name__ == "__main__":
    main(tuple(int(games) for games in sys.argv[1:]) or GAMES)
