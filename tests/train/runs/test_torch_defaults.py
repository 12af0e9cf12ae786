"""Runs and policies do not depend on PyTorch's default dtype and device."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import pytest
import torch

import pursuit
from train.kinds import start
from train.runs.folder import RUN, SELF_PLAY, load_results
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.self_play.parts import self_play_settings_of

MAZE: dict[str, Any] = {"maze": "3x3", "frames": 512, "max_steps": 20, "threads": 1}
PPO = {**MAZE, "num_games": 32, "minibatch_size": 64}
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "ppo": (RUN, PPO),
    "gru": (RUN, {**PPO, "recurrent": "gru"}),
    "planes": (RUN, {**PPO, "observation": "planes"}),
    "two processes": (RUN, {**PPO, "processes": 2}),
    "dqn": (RUN, {**MAZE, "algorithm": "dqn"}),
    "cross-entropy": (RUN, {**MAZE, "algorithm": "cross_entropy"}),
    "q-learning": (RUN, {**MAZE, "algorithm": "q_learning"}),
    "arm": (RUN, {"task": "reacher", "algorithm": "td3", "frames": 512, "threads": 1}),
    "team": (RUN, {**MAZE, "algorithm": "qmix", "num_chasers": 2}),
    "game": (RUN, {**PPO, "maze": None, "game": "soccer"}),
    "self-play": (SELF_PLAY, PPO),
    "nfsp": (SELF_PLAY, {**MAZE, "algorithm": "nfsp"}),
}
DEFAULTS = ("float64", "bfloat16", "meta")


@contextmanager
def defaults(name: str) -> Iterator[None]:
    try:
        if name == "meta":  # a device without values: what is made there by mistake fails
            torch.set_default_device(name)
        else:
            torch.set_default_dtype(getattr(torch, name))
        yield
    finally:
        torch.set_default_device("cpu")
        torch.set_default_dtype(torch.float32)


def trained(name: str, folder: Path) -> dict[str, Any]:
    kind, given = RUNS[name]
    make: Callable[..., Any] = settings_of if kind == RUN else self_play_settings_of
    run = start(kind, make(**{k: v for k, v in given.items() if v is not None}), folder)
    run.train()
    run.results(20)
    kept: dict[str, Any] = load_results(folder)["evaluation"]
    return kept


CASES = [
    pytest.param(
        name,
        DEFAULTS[number % 3],
        marks=[pytest.mark.slow] * ("processes" in given),
        id=f"{name}-{DEFAULTS[number % 3]}",
    )
    for number, (name, (_, given)) in enumerate(RUNS.items())
]


@pytest.mark.filterwarnings("ignore:frames=")
@pytest.mark.parametrize(("name", "default"), CASES)
def test_a_run_is_the_same_with_other_defaults(name: str, default: str, tmp_path: Path) -> None:
    expected = trained(name, tmp_path / "before")
    with defaults(default):
        assert trained(name, tmp_path / "after") == expected
        now = torch.zeros(1)
        assert now.device.type == default or now.dtype == getattr(torch, default)  # untouched


@pytest.mark.filterwarnings("ignore:frames=")
@pytest.mark.parametrize("default", DEFAULTS)
def test_policies_load_and_play_in_float32(default: str, tmp_path: Path) -> None:
    trained("ppo", tmp_path / "run")
    maze = pursuit.load_maze("3x3")
    expected = load_policy(tmp_path / "run").action_probabilities(maze)
    with defaults(default):
        policy = load_policy(tmp_path / "run")
        kinds = {(each.dtype, each.device.type) for each in policy.network.parameters()}
        assert kinds == {(torch.float32, "cpu")}
        assert (policy.action_probabilities(maze) == expected).all()
        env = gymnasium.make("pursuit/Evader-v0", maze="3x3", opponent=str(tmp_path / "run"))
        env.reset(seed=0)
        for _ in range(3):
            env.step(env.action_space.sample())
