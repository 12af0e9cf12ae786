"""PPO over games on a GPU, in Numba's simulator of one: `python tests/device_learning.py FILE`."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import torch

import pursuit
from pursuit.single_agent import fill_seats
from scripted_agents import AStarChaser, AStarEvader
from train.algorithms import ppo
from train.algorithms.learner import Build
from train.environments.device_env import DeviceEnv
from train.environments.simulator_env import SimulatorEnv
from train.networks.policy import Seat
from train.settings.algorithms import PPOSettings

SETTINGS = PPOSettings(
    num_games=6, rollout_steps=8, minibatch_size=16, epochs=2, width=16
)


def learn(device: str, iterations: int = 3) -> dict[str, np.ndarray]:
    """The weights after some iterations, and how the episodes went."""
    torch.manual_seed(3)
    task = pursuit.make_task("chase", maze="3x3", max_steps=6)
    seat = Seat(task, "chaser_0", "index")
    opponents: Any = {"chaser": AStarChaser(), "evader": AStarEvader(0.2)}
    _, policies = fill_seats(task, "chaser_0", opponents)
    games: Any = pursuit.Simulator(task, 6, 5, auto_restart=False, device=device)
    env: Any = (SimulatorEnv if device == "cpu" else DeviceEnv)(games, seat, policies)
    learner = ppo.build(SETTINGS, env, Build())
    for number in range(iterations):
        learner.iterate(number / iterations)
    returns, lengths = env.finished_returns, env.finished_lengths
    weights = {name: weight.numpy() for name, weight in learner.network.state_dict().items()}
    ends = np.array([np.concatenate(returns).mean(), np.concatenate(lengths).mean()])
    learner.close()
    return {**weights, "ends": ends, "positions": games.get_state().positions}


if __name__ == "__main__":
    with np.errstate(over="ignore"):
        np.savez(sys.argv[1], **learn("cuda"))
