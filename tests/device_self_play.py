"""Self-play with games on a GPU, in Numba's simulator of one, and on the CPU, to compare.

`python tests/device_self_play.py FILE CASE ...` writes all that is learned and who played whom;
`learn(CASE, "cpu")` is the same on the CPU. PAUSED as in `device_learning`.
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
from device_learning import arrays_in, main, through_a_file

from train.environments.device_env import DeviceEnv
from train.runs.threads import set_random_states
from train.self_play.parts import self_play_parts
from train.self_play.trainee import SelfPlay
from train.settings.self_play import SelfPlaySettings, self_play_ppo
from train.settings.task import TaskSettings

# Rollouts of as many frames as there are pairs of cells: the latest opponent is a table too.
HYPER = replace(
    self_play_ppo(), num_games=12, rollout_steps=8, minibatch_size=32, epochs=1, width=16
)
SNAPSHOTS = 4


@dataclass(frozen=True)
class Case:
    """Changes of the settings of self-play, and of its task."""

    changes: Mapping[str, Any] = field(default_factory=dict)
    task: Mapping[str, Any] = field(default_factory=dict)
    hyper: Mapping[str, Any] = field(default_factory=dict)
    iterations: int = 6


CASES = {
    "uniform": Case(),
    "pfsp with members": Case({"sampling": "pfsp", "members": ("astar", "random")}),
    "window, small pool": Case({"sampling": "window", "window": 1, "pool_size": 2}),
    "latest, bfloat16": Case({"sampling": "latest", "precision": "bfloat16"}),
    "one network": Case({"share_networks": True}, {"stay_action": True}),
    "a frozen side": Case({"evader": "astar"}),
    "a network alone": Case({"sampling": "latest"}, {}, {"num_games": 8}),
    "a network among tables": Case({"members": ("random",)}, {}, {"num_games": 8}),
}


def trainee_of(
    name: str, device: str, folder: Path, state: Any = None, graphs: Any = None
) -> SelfPlay:
    """Both sides of a case; `graphs` captures."""
    case = CASES[name]
    task = TaskSettings(maze="3x3", rewards="zero_sum", max_steps=10, **case.task)
    settings = SelfPlaySettings(
        task=task,
        hyper=replace(HYPER, **case.hyper),
        frames=10**6,
        snapshots=SNAPSHOTS,
        seed=5,
        device=device,
        **case.changes,
    )
    parts = self_play_parts(settings)
    for role, side in parts.sides.items():
        parts.sides[role] = replace(side, build=replace(side.build, graphs=graphs))
    torch.manual_seed(3)
    trainee = SelfPlay(settings, parts, folder, state)
    for side in trainee.sides.values():
        assert isinstance(side.env, DeviceEnv) == (device != "cpu")
    return trainee


def go_on(trainee: SelfPlay, iterations: range, of: int) -> None:
    """Learn for some iterations."""
    for number in iterations:
        clock: Any = SimpleNamespace(progress=number / of, seconds=float(number))
        trainee.iterate(clock)


def learn(
    name: str, device: str, paused: bool = False, graphs: Any = None
) -> dict[str, np.ndarray]:
    """What is seen after all iterations of a case."""
    with TemporaryDirectory() as here:
        folder, iterations = Path(here), CASES[name].iterations
        trainee = trainee_of(name, device, folder, None, graphs)
        half = iterations // 2
        go_on(trainee, range(half), iterations)
        if paused:
            saved = through_a_file(trainee, folder)
            trainee = trainee_of(name, device, folder, saved["trainee"], graphs)
            set_random_states(saved)
        go_on(trainee, range(half, iterations), iterations)
        seen = arrays_in(trainee.state_dict(), name)
        trainee.close()
    return seen


if __name__ == "__main__":
    main(learn, *sys.argv[1:])
