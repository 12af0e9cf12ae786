"""Policies that others trained: saved Stable-Baselines3 models in any seat.

A model file of Stable-Baselines3 is a zip whose settings are partly pickled, and loading those runs
code. So the recipes write a description beside the model, and what is loaded here is the weights
alone (`torch.load(weights_only=True)`), into a policy made from that description.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import torch
from gymnasium.spaces import Discrete

from pursuit.parts import check_trusted
from pursuit.simulator import Simulator
from train.files import read_json, write_json
from train.networks.policy import LearnedPolicy, Seat
from train.runs.tasks import agent_of, task_of
from train.settings.checks import check
from train.settings.task import TaskSettings

ALGORITHMS = ("ppo", "a2c", "dqn")


class StableBaselinesNetwork(torch.nn.Module):
    """A Stable-Baselines3 policy as the network of a `LearnedPolicy`."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy = policy

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions]: of the distribution, or the action values of DQN."""
        shape = observation.shape[: -len(self.policy.observation_space.shape)]
        flat = observation.reshape(-1, *self.policy.observation_space.shape)
        if hasattr(self.policy, "q_net"):
            logits = self.policy.q_net(flat)
        else:
            logits = self.policy.get_distribution(flat).distribution.logits
        return logits.reshape(*shape, -1)


def description_of(path: Path) -> Path:
    """Where the description of the model in `path` lies."""
    return path.with_suffix(".json")


def save_stable_baselines(
    model: Any, path: Path, algorithm: str, task: TaskSettings, encoding: str
) -> None:
    """Save a model, and beside it what is needed to load its weights as a policy.

    Args:
        model: PPO, A2C or DQN of Stable-Baselines3, with an "MlpPolicy".
        path: a .zip file.
        algorithm: "ppo", "a2c" or "dqn".
        task: that it was trained in.
        encoding: that it observes.
    """
    model.save(path)
    write_json(
        description_of(path),
        {
            "algorithm": algorithm,
            "net_arch": model.policy_kwargs.get("net_arch"),
            "task": {**vars(task), "maze": task_of(task).mazes[0].to_text()},
            "observation": encoding,
        },
    )


def load_stable_baselines(path: Path, greedy: bool = True) -> LearnedPolicy:
    """A saved model as a policy; no code that the file may hold is run.

    Args:
        path: the .zip that `save_stable_baselines` wrote, its description beside it.
        greedy: take the most probable action; False draws (PPO and A2C only).

    Raises:
        ImportError: Stable-Baselines3 is not installed.
        ValueError: no model, no description, a damaged one, or weights of another network.
    """
    try:
        from stable_baselines3.common.policies import ActorCriticPolicy
        from stable_baselines3.dqn.policies import DQNPolicy
    except ImportError:
        raise ImportError(
            "stable_baselines3 is not installed; pip install 'pursuit[sb3]'"
        ) from None
    check(path.is_file(), f"{path}: no such file; give a saved model (.zip)")
    check(
        description_of(path).is_file(),
        f"{path}: its description {description_of(path).name} is not beside it; save models with "
        "train.runs.third_party.save_stable_baselines",
    )
    described = read_json(description_of(path))
    check_trusted(description_of(path), described)
    try:
        task, encoding = TaskSettings(**described["task"]), described["observation"]
        algorithm, net_arch = described["algorithm"], described["net_arch"]
    except (KeyError, TypeError) as error:
        raise ValueError(f"{description_of(path)}: damaged, no description: {error}") from None
    check(algorithm in ALGORITHMS, f"{path}: algorithm {algorithm!r}; ppo, a2c or dqn")
    check(
        greedy or algorithm != "dqn",
        f"{path}: dqn learns no distribution over actions; take the greedy policy",
    )
    built = task_of(task)
    form = DQNPolicy if algorithm == "dqn" else ActorCriticPolicy
    policy = form(
        Simulator(built).encoder(encoding).space,
        Discrete(built.num_actions),
        lambda _: 0.0,
        net_arch=net_arch,
    )
    try:
        with zipfile.ZipFile(path) as file:
            weights = torch.load(
                io.BytesIO(file.read("policy.pth")), map_location="cpu", weights_only=True
            )
        policy.load_state_dict(weights)
    except Exception as error:  # whatever a damaged zip or pickle raises
        raise ValueError(
            f"{path}: damaged, or weights of another network ({type(error).__name__})"
        ) from None
    policy.set_training_mode(False)
    seat = Seat(built, agent_of(task, built), encoding)
    return seat.policy(StableBaselinesNetwork(policy), greedy)
