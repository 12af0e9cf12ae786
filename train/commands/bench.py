"""`pursuit bench`: how fast this machine plays and learns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Annotated, Any

import numpy as np

from pursuit import chase_v0
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents.environments import default_policies
from train.commands.parse import parse
from train.runs.folder import RUN
from train.settings.checks import Settings, rule
from train.settings.run import TrainSettings
from train.settings.task import TaskSettings

SECONDS = rule(lambda value: 0 < value < 1000, "above 0")


@dataclass(frozen=True)
class BenchCommand(Settings):
    """Steps per second of the simulator, the environments and PPO on this machine."""

    seconds: Annotated[float, SECONDS] = 1.0
    """Time of each measurement."""


def rate(step: Callable[[], object], per_call: int, seconds: float) -> float:
    """How many of `per_call` things a call there are in a second; best of three tries."""
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


def simulator_rate(
    task: Task,
    num_games: int,
    seconds: float = 1.0,
    scripted: bool = True,
    encoding: str | None = None,
) -> float:
    """Game steps a second: one seat plays random moves, scripted agents fill the others.

    Args:
        task: the task.
        num_games: games in the batch.
        seconds: time of the measurement.
        scripted: False has all seats play random moves drawn beforehand.
        encoding: also encode what the first seat observes in each step.
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

    return rate(step, num_games, seconds)


def arm_rate(joints: int, seconds: float = 1.0) -> float:
    """Steps a second of 4096 arms with random turns drawn beforehand, one core."""
    simulator = ReacherSimulator(ReacherTask(joints=joints), 4096)
    turns = cycle(np.random.default_rng(0).uniform(-1.0, 1.0, (16, 4096, joints)))
    return rate(lambda: simulator.step(next(turns)), 4096, seconds)


def parallel_env_rate(seconds: float = 1.0) -> float:
    """Steps a second through the PettingZoo environment: chase 5x5, default observation."""
    env = chase_v0.parallel_env(maze="5x5")
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    turns = cycle(
        dict(zip(env.possible_agents, pair, strict=True))
        for pair in generator.integers(4, size=(256, 2)).tolist()
    )

    def step() -> None:
        env.step(next(turns))
        if not env.agents:
            env.reset()

    return rate(step, 1, seconds)


def bench(arguments: Sequence[str]) -> None:
    """`pursuit bench`."""
    given = parse(BenchCommand, arguments, "bench")
    seconds, chase = given.seconds, make_task("chase", maze="7x7")
    maze = make_task("maze", maze="7x7")
    simulated = partial(simulator_rate, seconds=seconds)
    measures: dict[str, Callable[[], float]] = {
        "chase 7x7, 4096 games, no scripted agent": partial(simulated, chase, 4096, scripted=False),
        "  with a scripted evader": partial(simulated, chase, 4096),
        "  and the 'index' observation": partial(simulated, chase, 4096, encoding="index"),
        "  and the 'one_hot' observation": partial(simulated, chase, 4096, encoding="one_hot"),
        "chase 7x7, one game, with a scripted evader": partial(simulated, chase, 1),
        "maze 7x7, 3 goals, 4096 games": partial(simulated, maze, 4096),
        "reacher, 2 joints, 4096 arms": partial(arm_rate, 2, seconds),
        "reacher, 8 joints, 4096 arms": partial(arm_rate, 8, seconds),
        "PettingZoo chase 5x5, one game": partial(parallel_env_rate, seconds),
        "PPO, maze 5x5 with 3 goals (frames)": partial(ppo_rate, max(seconds, 3.0)),
    }
    for name, measure in measures.items():
        print(f"{name:<48}{measure():>16,.0f} steps/s", flush=True)


def ppo_rate(seconds: float) -> float:
    """Frames a second of PPO with its preset, learning included."""
    from train.experiments.kinds import start  # torch is slow to import

    with TemporaryDirectory() as folder:
        settings: TrainSettings[Any] = TrainSettings(TaskSettings(task="maze"), seconds=seconds)
        run = start(RUN, settings, Path(folder) / "run")
        run.train()
        return run.trainee.frames / run.seconds
