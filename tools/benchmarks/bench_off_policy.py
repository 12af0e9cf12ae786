"""Speed of TD3 and SAC against Stable-Baselines3's: frames per second of the whole training.

Both use the same arm, number of games, two hidden layers of the same width, batches, and gradient
steps per frame. Measurements alternate, as the speed of the machine changes.

python tools/benchmarks/bench_off_policy.py [--games 64] [--gradient-steps 8] [--threads 1 2]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import Any

import stable_baselines3
import torch

from pursuit.environments.stable_baselines import StableBaselinesVecEnv
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.single_agent import ReacherVectorEnv
from pursuit.reacher.task import ReacherTask
from train.algorithms.learner import Build
from train.algorithms.registry import entry
from train.environments.simulator_env import SimulatorEnv
from train.machine import processor
from train.networks.arm_policy import ArmSeat

TASK = ReacherTask(joints=2)
WIDTH, BATCH, BUFFER, WARM_UP = 256, 256, 100_000, 2048


def ours(name: str, games: int, gradient_steps: int) -> Callable[[int], None]:
    """A function that trains our learner for a number of rounds; warmed up."""
    settings: Any = entry(name).settings(
        num_games=games,
        gradient_steps=gradient_steps,
        batch_size=BATCH,
        buffer_size=BUFFER,
        width=WIDTH,
        learning_starts=WARM_UP,
        noise="none",
    )
    simulator = ReacherSimulator(TASK, games, auto_restart=False)
    learner = entry(name).build(settings, SimulatorEnv(simulator, ArmSeat(TASK)), Build())
    while learner.frames < WARM_UP + 4 * games:
        learner.iterate(0.0)

    def rounds(count: int) -> None:
        for _ in range(count):
            learner.iterate(0.0)

    return rounds


def theirs(name: str, games: int, gradient_steps: int) -> Callable[[int], None]:
    """A function that trains the learner of Stable-Baselines3 for a number of rounds; warmed up."""
    model = getattr(stable_baselines3, name.upper())(
        "MlpPolicy",
        StableBaselinesVecEnv(ReacherVectorEnv(TASK, games, autoreset_mode="SAME_STEP")),
        train_freq=1,
        gradient_steps=gradient_steps,
        batch_size=BATCH,
        buffer_size=BUFFER,
        learning_starts=WARM_UP,
        policy_kwargs={"net_arch": [WIDTH, WIDTH]},
        device="cpu",
        seed=0,
    )
    model.learn(WARM_UP + 4 * games)

    def rounds(count: int) -> None:
        model.learn(count * games, reset_num_timesteps=False)

    return rounds


def speeds(learners: list[Callable[[int], None]], games: int, seconds: float) -> list[float]:
    """The median frames per second of each, with alternating measurements."""
    counts, found = [1] * len(learners), [[0.0] for _ in learners]
    for turn in range(7):
        for number, learner in enumerate(learners):
            began = perf_counter()
            learner(counts[number])
            taken = perf_counter() - began
            if turn:
                found[number].append(counts[number] * games / taken)
            else:
                counts[number] = max(1, round(counts[number] * seconds / 6 / taken))
    return [median(each[1:]) for each in found]


def main() -> None:
    """Print frames per second of both, and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--games", type=int, default=64, help="parallel games")
    parser.add_argument("--gradient-steps", type=int, default=8, help="per step of all games")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="threads of torch")
    parser.add_argument("--seconds", type=float, default=20.0, help="per measurement")
    given = parser.parse_args()
    print(f"{processor()}; 2 joints, {WIDTH}x{WIDTH}, batches of {BATCH}, {given.games} games,")
    print(f"{given.gradient_steps} gradient steps per step of all games; frames/s")
    print(f"{'threads':<9}{'':<6}{'ours':>10}{'SB3':>10}{'ratio':>8}")
    for threads in given.threads:
        torch.set_num_threads(threads)
        for name in ("td3", "sac"):
            sizes = name, given.games, given.gradient_steps
            mine, other = speeds([ours(*sizes), theirs(*sizes)], given.games, given.seconds)
            print(f"{threads:<9}{name:<6}{mine:>10.0f}{other:>10.0f}{mine / other:>8.2f}")


if __name__ == "__main__":
    main()
