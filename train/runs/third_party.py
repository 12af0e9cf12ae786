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

import numpy as np
import torch
from gymnasium.spaces import Discrete

from pursuit.declared import truth
from pursuit.parts import check_trusted
from pursuit.simulator import Simulator
from train.files import read_json, write_json
from train.networks.policy import NetworkPolicy, Seat
from train.runs.forms import RESTORE, Description
from train.runs.tasks import agent_of, task_of
from train.schemas import read_as
from train.settings.checks import check
from train.settings.task import TaskSettings
from train.tensors import Misfit, check_like, loaded


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


def load_stable_baselines(path: Path, greedy: bool | None = True) -> NetworkPolicy:
    """A saved model as a policy; no code that the file may hold is run.

    Args:
        path: the .zip that `save_stable_baselines` wrote, its description beside it.
        greedy: take the most probable action; False draws (PPO and A2C only); None draws where
            there is a distribution.

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
    where = description_of(path)
    content = read_json(where)
    check_trusted(where, content)
    described = read_as(Description, content, where, RESTORE)
    task = read_as(TaskSettings, described.task, f"{where}: task", RESTORE)
    algorithm, encoding = described.algorithm, described.observation
    greedy = algorithm == "dqn" if greedy is None else truth("greedy", greedy)
    check(
        greedy or algorithm != "dqn",
        f"{path}: dqn learns no distribution over actions; take the greedy policy",
    )
    built = task_of(task)
    space = Simulator(built).encoder(encoding).space
    weights = _weights_in(path)
    check(
        _least_weights(described, int(np.prod(space.shape))) <= weights_in_all(weights),
        f"{path}: its weights are not of the network that {where.name} describes; {RESTORE}",
    )
    form = DQNPolicy if algorithm == "dqn" else ActorCriticPolicy
    try:
        policy = form(
            space, Discrete(built.num_actions), lambda _: 0.0, net_arch=described.net_arch
        )
        check_like(weights, policy.state_dict(), "policy.pth")
    except (Misfit, TypeError) as error:
        raise ValueError(f"{path}: does not fit {where.name} ({error}); {RESTORE}") from None
    policy.load_state_dict(weights)
    policy.set_training_mode(False)
    seat = Seat(built, agent_of(task, built), encoding, task.mask_bumps)
    return seat.policy(StableBaselinesNetwork(policy), greedy)


def _weights_in(path: Path) -> dict[str, Any]:
    """The weights in the zip of a model.

    Raises:
        ValueError: it is damaged, or there are none.
    """
    try:
        with zipfile.ZipFile(path) as file:
            part = file.getinfo("policy.pth")
            check(part.file_size <= path.stat().st_size, "compressed")
            content = io.BytesIO(file.read(part))  # which compares its checksum
    except Exception:  # zipfile raises whatever the bytes lead it to
        raise ValueError(f"{path}: damaged, or no saved model; {RESTORE}") from None
    weights = loaded(content, path)
    fits = isinstance(weights, dict) and all(isinstance(w, torch.Tensor) for w in weights.values())
    check(fits, f"{path}: damaged, its weights are no tensors by name; {RESTORE}")
    return dict(weights)


def weights_in_all(weights: dict[str, torch.Tensor]) -> int:
    """How many numbers there are."""
    return sum(tensor.numel() for tensor in weights.values())


def _least_weights(described: Description, inputs: int) -> int:
    """How many weights the layers of a description have at least, found without making them.

    Raises:
        ValueError: a layer without units.
    """
    given = described.net_arch
    layers = list(given.values()) if isinstance(given, dict) else [given or []]
    for sizes in layers:
        check(all(size >= 1 for size in sizes), f"net_arch={given}; layers of at least 1 unit")
    return sum(
        before * after
        for sizes in layers
        for before, after in zip([inputs, *sizes], sizes, strict=False)
    )
