"""Saved Stable-Baselines3 models as policies.

The settings in a model file of Stable-Baselines3 are partly pickled, and unpickling can run code.
So only the weights are loaded (`torch.load(weights_only=True)`), and layers are derived from their
shapes. Task and observation are read from a description file next to the model, which
`save_stable_baselines` writes. For a model of `model.save()` they are arguments.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

import torch
from gymnasium.spaces import Discrete

from pursuit.plugins import reading
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from pursuit.validation import check, check_bool
from train.algorithms.stable_baselines import StableBaselinesNetwork
from train.files import read_json, write_bytes, write_json
from train.networks.policy import MazeSeat, NetworkPolicy
from train.runs.forms import RESTORE, Description
from train.schemas import read_as
from train.settings.mazes import titled
from train.settings.task import TaskSettings
from train.tensors import first_not_finite, loaded_tensors, own_defaults


def description_of(path: Path | str) -> Path:
    """The path of the description file of a model."""
    return Path(path).with_suffix(".json")


def save_stable_baselines(
    model: Any, path: Path | str, algorithm: str, task: TaskSettings, encoding: str
) -> None:
    """Save a model and its description file, from which `load_stable_baselines` makes a policy.

    Args:
        model: PPO, A2C or DQN of Stable-Baselines3, with an "MlpPolicy".
        path: a .zip file; the suffix may be left out.
        algorithm: "ppo", "a2c" or "dqn".
        task: of the training.
        encoding: name of the observation.
    """
    path, content = Path(path), io.BytesIO()
    model.save(content)
    path = path if path.suffix else path.with_suffix(".zip")
    write_bytes(path, content.getvalue())
    maze = task.build().mazes[0]
    played = {**vars(task), "maze": titled(maze.name, maze.to_text())}
    described = {"algorithm": algorithm, "task": played, "observation": encoding}
    write_json(description_of(path), described)


@own_defaults()
def load_stable_baselines(
    path: Path | str,
    greedy: bool | None = True,
    task: Task | None = None,
    agent: str | None = None,
    observation: str | None = None,
    mask_bumps: bool = False,
) -> NetworkPolicy:
    """A saved model as a policy; no code from the file is run.

    Args:
        path: a .zip file of `save_stable_baselines` with its description file; or one of
            `model.save()`, with `task`, `agent` and `observation`.
        greedy: take the most probable action; False samples (PPO and A2C only); None samples if the
            model has a distribution.
        task, agent, observation, mask_bumps: the game of the training, the agent or role, its
            observation, and whether moves into walls are masked. Values of a description file are
            used instead.

    Raises:
        ImportError: Stable-Baselines3 is not installed.
        ValueError: no model, neither description nor arguments, a damaged file, or weights of
            another network.
    """
    path = Path(path)
    check(path.is_file(), f"{path}: no such file; give a saved model (.zip)")
    where = description_of(path)
    if where.is_file():
        with reading(where):
            content = read_json(where)
            described = read_as(Description, content, where, RESTORE)
            settings = read_as(TaskSettings, described.task, f"{where}: task", RESTORE)
            task, observation = settings.build(), described.observation
            agent, mask_bumps = settings.agent_in(task), settings.mask_bumps
            return _load(path, MazeSeat(task, agent, observation, mask_bumps), greedy)
    if task is None or agent is None or observation is None:
        raise ValueError(
            f"{path}: its description file {where.name} is missing; give the task and observation "
            "of its training (--observation of pursuit evaluate, --opponent-observation of an "
            "opponent), or save it with train.runs.stable_baselines.save_stable_baselines"
        )
    return _load(path, MazeSeat(task, agent, observation, mask_bumps), greedy)


def _load(path: Path, seat: MazeSeat, greedy: bool | None) -> NetworkPolicy:
    """The model of a seat; see `load_stable_baselines`."""
    policy = _policy_in(path, seat)
    draws = not hasattr(policy, "q_net")
    greedy = not draws if greedy is None else check_bool("greedy", greedy)
    check(
        greedy or draws, f"{path}: dqn learns no distribution over actions; use the greedy policy"
    )
    return seat.policy(StableBaselinesNetwork(policy), greedy)


def _policy_in(path: Path, seat: MazeSeat) -> Any:
    """The policy in the zip of a model, with layers derived from the shapes of the weights.

    Raises:
        ImportError: Stable-Baselines3 is not installed.
        ValueError: a damaged file, or weights for another agent or observation.
    """
    try:
        from stable_baselines3.common.policies import ActorCriticPolicy
        from stable_baselines3.dqn.policies import DQNPolicy
    except ImportError:
        raise ImportError(
            "stable_baselines3 is not installed; pip install 'pursuit[sb3]'"
        ) from None
    weights, task = _weights_in(path), seat.task
    layers = _layers_of(path, weights)
    of_values = isinstance(layers, list)
    form = DQNPolicy if of_values else ActorCriticPolicy
    activation = _activation_in(path) or (torch.nn.ReLU if of_values else torch.nn.Tanh)
    sizes = {"net_arch": layers, "activation_fn": activation}
    space = Simulator(task).encoder(seat.encoding).space
    try:
        policy = form(space, Discrete(task.num_actions), lambda _: 0.0, **sizes)
        policy.load_state_dict(weights)
    except (RuntimeError, TypeError):  # torch lists every weight
        raise ValueError(
            f"{path}: its weights do not match observation={seat.encoding!r} of {seat.agent} in "
            f"task {task.name!r} on maze {task.mazes[0].name}; give those of its training"
        ) from None
    policy.set_training_mode(False)
    return policy


def _weights_in(path: Path) -> dict[str, torch.Tensor]:
    """The weights in the zip of a model.

    Raises:
        ValueError: it is damaged, or there are none.
    """
    try:
        content = io.BytesIO(_part_in(path, "policy.pth"))
    except Exception:  # zipfile can raise anything for damaged bytes
        raise ValueError(f"{path}: damaged, or not a saved model; {RESTORE}") from None
    weights = loaded_tensors(content, path)
    fits = isinstance(weights, dict) and all(isinstance(w, torch.Tensor) for w in weights.values())
    check(fits, f"{path}: damaged, its weights are not tensors by name; {RESTORE}")
    where = first_not_finite(weights)
    check(
        where is None, f"{path}: {where} is not finite, its training diverged; give another model"
    )
    return dict(weights)


def _part_in(path: Path, name: str) -> bytes:
    """A part of the zip of a model, of at most the size of the file: nothing in it is compressed.

    Raises:
        Exception: of any kind for damaged bytes; ValueError for a larger part.
    """
    with zipfile.ZipFile(path) as archive:
        part = archive.getinfo(name)
        check(part.file_size <= path.stat().st_size, "compressed")
        with archive.open(part) as file:
            # Without a number a part that is larger than it claims would be decompressed first.
            return file.read(part.file_size)  # which verifies its checksum


def _layers_of(path: Path, weights: dict[str, torch.Tensor]) -> list[int] | dict[str, list[int]]:
    """The widths of the hidden layers: of DQN's values, or separately of policy and value.

    Raises:
        ValueError: another kind of network.
    """
    parts = {"mlp_extractor.policy_net": "pi", "mlp_extractor.value_net": "vf", "q_net.q_net": "q"}
    layers: dict[str, list[int]] = {part: [] for part in parts.values()}
    for name, tensor in weights.items():
        part, _, rest = name.partition(".weight")[0].rpartition(".")
        if name.endswith(".weight") and part in parts and rest.isdigit() and tensor.ndim == 2:
            layers[parts[part]].append(len(tensor))
    if values := layers.pop("q"):
        return values[:-1]
    check(
        "action_net.weight" in weights,
        f"{path}: not a network of PPO, A2C or DQN with an MlpPolicy; use other models as "
        "user-defined policies",
    )
    return layers


def _activation_in(path: Path) -> type[torch.nn.Module] | None:
    """The activation function in the zip of a model; None if none is recorded.

    Raises:
        ValueError: one that is not in torch.nn, or a custom feature extractor.
    """
    try:
        given = json.loads(_part_in(path, "data")).get("policy_kwargs", {})
        text = str(given.get("activation_fn", ""))
        extractor = str(given.get("features_extractor_class", "FlattenExtractor"))
    except Exception:  # zipfile and json can raise anything for damaged bytes
        raise ValueError(f"{path}: damaged, its settings cannot be read; {RESTORE}") from None
    check(
        "FlattenExtractor" in extractor,
        f"{path}: features_extractor_class={extractor}; only an MlpPolicy without one is supported",
    )
    if not text:
        return None
    name = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", text)
    if name is None or not hasattr(torch.nn, name[1]):
        raise ValueError(
            f"{path}: activation_fn={text}; only those of torch.nn, such as ReLU, are supported"
        )
    return getattr(torch.nn, name[1])
