"""Learning from games on a GPU, in Numba's simulator of one, and on the CPU, to compare.

`python tests/device_learning.py FILE CASE ...` writes all that is learned, and what the curriculum
was told; `learn(CASE, "cpu")` is the same on the CPU. With PAUSED before the cases each is saved
half-way, and goes on from the file.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from train.algorithms.learner import Build
from train.algorithms.ppo import network_of
from train.environments.device_env import DeviceEnv
from train.environments.simulator_env import SimulatorEnv
from train.runs.by_name import settings_of
from train.runs.folder import load_checkpoint, save_checkpoint
from train.runs.parts import parts_of
from train.runs.single import SingleAgent
from train.runs.threads import random_states, set_random_states

PAUSED = "--paused"
CHASE = {"task": "chase", "role": "chaser", "maze": "3x3", "max_steps": 6}
RUN = {"task": "maze", "maze": "3x3", "max_steps": 8, "num_goals": 2}
LEARNER = {"num_games": 6, "rollout_steps": 8, "minibatch_size": 16, "epochs": 2, "width": 16}
DQN = {"algorithm": "dqn", "batch_size": 16, "gradient_steps": 4, "buffer_size": 100}
DQN |= {"learning_starts": 40, "target_update_interval": 3, "prioritized": True}


@dataclass(frozen=True)
class Case:
    """One learner's settings by name, but for those of LEARNER, and how long it learns.

    With an opponent a network of random weights plays the evaders, "sampled" or "greedy".
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    iterations: int = 3
    opponent: str | None = None


CASES = {
    "ppo": Case(CHASE),
    "a network": Case(CHASE, opponent="sampled"),
    "networks of a team, greedy": Case(
        {**CHASE, "num_evaders": 2, "observation": "planes"}, opponent="greedy"
    ),
    "bfloat16": Case({**CHASE, "precision": "bfloat16"}),
    "a penalty": Case({**CHASE, "kl_target": 0.01}),
    "no critic": Case({**CHASE, "critic": False}),
    "a2c": Case({**CHASE, "algorithm": "a2c"}),
    "dqn": Case({**CHASE, **DQN}),
    # An "index" has first layers that are a kernel of their own on the CPU.
    "dqn on positions": Case(
        {**CHASE, **DQN, "observation": "positions", "curriculum": "opponent-epsilon"}
    ),
    "dqn, opponent-epsilon": Case({**CHASE, **DQN, "curriculum": "opponent-epsilon"}),
    "opponent-epsilon": Case({**CHASE, "curriculum": "opponent-epsilon"}),
    "goal-spread": Case({**RUN, "curriculum": "goal-spread-start", "easiest": 1}, 4),
    "num-goals": Case({**RUN, "curriculum": "learning-progress", "axis": "num-goals"}, 4),
    "uniform": Case({**CHASE, "curriculum": "uniform", "axis": "start-distance"}, 4),
    "gated": Case(
        {**RUN, "curriculum": "success-gated", "axis": "num-goals", "window": 4, "promote_at": 0.1},
        5,
    ),
    "mazes": Case({**RUN, "curriculum": "uniform", "axis": "maze-size", "observation": "walls"}, 4),
    "levels": Case({**RUN, "curriculum": "level-replay", "level_buffer": 8}, 5),
    "value loss": Case(
        {**CHASE, "curriculum": "level-replay", "level_buffer": 8, "level_score": "value_loss"}, 5
    ),
}


def trainee_of(name: str, device: str, state: Any = None, graphs: Any = None) -> SingleAgent:
    """The learner of a case with its games, and whoever teaches; `graphs` captures."""
    flat = {**LEARNER, **CASES[name].settings}
    if flat.get("algorithm") in ("a2c", "dqn"):
        flat = {key: flat[key] for key in flat if key not in ("minibatch_size", "epochs")}
    settings = settings_of(**flat, frames=10**6, seed=5, device=device)
    parts: Any = parts_of(settings)
    parts = replace(parts, build=replace(parts.build, graphs=graphs))
    if CASES[name].opponent is not None:
        parts.world.opponents["evader"] = evader(parts, CASES[name].opponent == "greedy")
    torch.manual_seed(3)
    trainee = SingleAgent(parts, "greedy", state)
    assert isinstance(trainee.env, SimulatorEnv if device == "cpu" else DeviceEnv)
    return trainee


def evader(parts: Any, greedy: bool) -> Any:
    """A network that plays the evaders as if it had learned to."""
    torch.manual_seed(8)
    seat = replace(parts.seat, agent="evader")
    network = network_of(replace(parts.hyper, first_std=2.0), seat, Build())
    with torch.no_grad():
        network.policy_head.weight.mul_(100.0)  # not all actions alike
    return seat.policy(network, greedy)


def go_on(trainee: SingleAgent, iterations: range, of: int) -> None:
    """Learn for some iterations."""
    for number in iterations:
        trainee.iterate(SimpleNamespace(progress=number / of, seconds=float(number)))


def seen_of(trainee: SingleAgent) -> dict[str, np.ndarray]:
    """The weights, the games, how episodes went, and all that the curriculum knows."""
    returns, lengths = trainee.env.finished_returns, trainee.env.finished_lengths
    seen = {"ends": np.array([np.concatenate(returns).mean(), np.concatenate(lengths).mean()])}
    if trainee.teacher is not None:
        trainee.teacher.update(1.0, trainee.frames, 100.0)
        seen["figures"] = np.array([*trainee.teacher.figures().values()])
    return seen | arrays_in(trainee.state_dict(), "state")


def arrays_in(state: Any, where: str) -> dict[str, np.ndarray]:
    """All of a nested state as arrays, by where they stand in it."""
    if isinstance(state, dict | list | tuple):
        items = state.items() if isinstance(state, dict) else enumerate(state)
        found: dict[str, np.ndarray] = {}
        for name, value in items:
            found |= arrays_in(value, f"{where}.{name}")
        return found
    if isinstance(state, torch.Tensor):
        return {where: state.numpy()}
    wide = isinstance(state, int) and abs(state) >= 2**63  # of a generator
    return {where: np.array(str(state) if state is None or wide else state)}


def through_a_file(trainee: Any, folder: Path) -> dict[str, Any]:
    """The checkpoint of a trainee, as it is read again."""
    save_checkpoint(folder, {"trainee": trainee.state_dict(), **random_states()})
    trainee.close()
    return load_checkpoint(folder)


def learn(
    name: str, device: str, paused: bool = False, graphs: Any = None
) -> dict[str, np.ndarray]:
    """What is seen after all iterations of a case."""
    trainee, iterations = trainee_of(name, device, None, graphs), CASES[name].iterations
    half = iterations // 2
    go_on(trainee, range(half), iterations)
    if paused:
        with TemporaryDirectory() as folder:
            saved = through_a_file(trainee, Path(folder))
        trainee = trainee_of(name, device, saved["trainee"], graphs)
        set_random_states(saved)
    go_on(trainee, range(half, iterations), iterations)
    seen = {f"{name}: {key}": value for key, value in seen_of(trainee).items()}
    trainee.close()
    return seen


def main(learn: Any, path: str, *names: str) -> None:
    """Learn the cases on the device, and write all that is seen."""
    paused = names[0] == PAUSED
    with np.errstate(over="ignore"):
        found = {}
        for name in names[paused:]:
            found |= learn(name, "cuda", paused)
        np.savez(path, **found)


if __name__ == "__main__":
    main(learn, *sys.argv[1:])
