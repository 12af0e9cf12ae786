"""Learning from games on a GPU, in Numba's simulator of one.

`python tests/device_learning.py FILE ALGORITHM`
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import torch

from train.algorithms.learner import Build
from train.algorithms.registry import entry
from train.environments.device_env import DeviceEnv
from train.environments.simulator_env import SimulatorEnv
from train.networks.policy import Seat
from train.runs.worlds import GridWorld
from train.settings.algorithms import DQNSettings, PPOSettings
from train.settings.task import TaskSettings

SETTINGS: dict[str, Any] = {
    "ppo": PPOSettings(num_games=6, rollout_steps=8, minibatch_size=16, epochs=2, width=16),
    "dqn": DQNSettings(
        num_games=6, rollout_steps=8, batch_size=16, gradient_steps=4, width=16, buffer_size=100,
        learning_starts=40, target_update_interval=3, prioritized=True,
    ),
}  # fmt: skip


def learn(device: str, algorithm: str, iterations: int = 3) -> dict[str, np.ndarray]:
    """The weights after some iterations, and how the episodes went."""
    torch.manual_seed(3)
    settings = SETTINGS[algorithm]
    world = GridWorld(TaskSettings(task="chase", role="chaser", maze="3x3", max_steps=6))
    seat = Seat(world.task, world.agent, "index")
    env: Any = world.games(seat, settings.num_games, 5, None, device)[0]
    assert isinstance(env, SimulatorEnv if device == "cpu" else DeviceEnv)
    learner: Any = entry(algorithm).build(settings, env, Build())
    for number in range(iterations):
        learner.iterate(number / iterations)
    returns, lengths = env.finished_returns, env.finished_lengths
    weights = {name: weight.numpy() for name, weight in learner.network.state_dict().items()}
    ends = np.array([np.concatenate(returns).mean(), np.concatenate(lengths).mean()])
    learner.close()
    return {**weights, "ends": ends, "positions": env.simulator.get_state().positions}


if __name__ == "__main__":
    with np.errstate(over="ignore"):
        np.savez(sys.argv[1], **learn("cuda", sys.argv[2]))
