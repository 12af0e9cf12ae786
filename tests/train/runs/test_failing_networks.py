"""A user-defined network that raises in the middle of training: one line, and the run is kept."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from command_errors import error_of
from torch import nn

from pursuit import plugins
from train.networks.features import Features
from train.runs.folder import load_checkpoint

FAILING = __name__


class Failing(nn.Module):
    """Fails in one of several ways in the updates from number `first` on."""

    how, first = "", 6

    def __init__(self, features: Features, width: int) -> None:
        super().__init__()
        self.table = nn.Embedding(len(features.rows), width)
        self.calls = 0

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """[batch, width]."""
        hidden = self.table(observation).sum(-2)
        self.calls += torch.is_grad_enabled()
        if self.calls < self.first:
            return hidden
        if self.how == "raises":
            raise KeyError("lost\nwords")
        if self.how == "shape":
            return hidden[:-1]
        if self.how == "nothing":
            return None  # type: ignore[return-value]
        squared = hidden.exp()
        squared += 1.0  # its gradient needs the value before
        return squared


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(plugins, "_allowed", set())
    monkeypatch.setattr(plugins, "_named", set())
    monkeypatch.setitem(sys.modules, "failing", sys.modules[FAILING])
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 20)
    monkeypatch.setattr("train.runs.single.EPISODES", 10)
    return "failing:Failing"


@pytest.mark.parametrize(
    ("command", "how", "told"),
    [
        ("train", "raises", "network 'failing:Failing' raised KeyError: 'lost"),
        ("self-play", "shape", "network 'failing:Failing' raised RuntimeError: shape"),
        ("train", "nothing", "network 'failing:Failing' raised AttributeError"),
        ("self-play", "in place", "the gradients of the network raised RuntimeError: one of the"),
    ],
)
def test_it_is_one_line_and_the_last_checkpoint_is_kept(
    command: str,
    how: str,
    told: str,
    failing: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(Failing, "how", how)
    flat: dict[str, Any] = {
        "maze": "2x2", "network": failing, "num_games": 16, "rollout_steps": 8,
        "minibatch_size": 128, "epochs": 1, "width": 8, "max_steps": 8, "frames": 20_000,
        "out": tmp_path / "run",
    }  # fmt: skip
    monkeypatch.setattr(Failing, "first", 20)
    options = [f"--{name.replace('_', '-')}={value}" for name, value in flat.items()]
    assert told in error_of(capsys, command, *options, longest=600)  # torch says much
    state = load_checkpoint(tmp_path / "run")["trainee"]
    state = state if command == "train" else state["sides"]["chaser"]
    assert state["learner"]["frames"] > 0
