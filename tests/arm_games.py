"""Arms for tests of learners: games, and how long a policy's episodes take."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from train.environments.simulator_env import SimulatorEnv
from train.networks.arm_policy import ArmSeat


def arm_games(num_games: int, seed: int = 0, **task: Any) -> SimulatorEnv:
    """Arms of a task, as a learner's games."""
    described = ReacherTask(**task)
    simulator = ReacherSimulator(described, num_games, seed, auto_restart=False)
    return SimulatorEnv(simulator, ArmSeat(described))


def steps_of(policy: Any, num_games: int = 500, seed: int = 2**62, **task: Any) -> float:
    """Mean steps of an episode, one for each of `num_games` arms."""
    simulator = ReacherSimulator(ReacherTask(**task), num_games, seed, auto_restart=False)
    steps, running = np.zeros(num_games), np.ones(num_games, dtype=bool)
    while running.any():
        simulator.step(policy.act(simulator.view()))
        steps[running] += 1
        running &= ~simulator.ended
    return float(steps.mean())
