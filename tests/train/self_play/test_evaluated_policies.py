"""The policies that self-play evaluates and saves do not play improbable actions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from self_play_runs import make_run

from train.runs.opponents import load_policy
from train.settings.self_play import ROLES, self_play_ppo


def test_improbable_actions_are_not_played(tmp_path: Path) -> None:
    hyper = replace(self_play_ppo(), entropy_coef=0.0)
    settings: Any = {"min_probability": 0.2, "precision": "float32", "hyper": hyper}
    run = make_run(tmp_path, frames=120_000, **settings)
    run.train()
    maze = run.trainee.task.mazes[0]
    for role in ROLES:
        raw = run.trainee.sides[role].policy().action_probabilities(maze)
        table = run.trainee.policy(role).action_probabilities(maze)
        assert (raw < 0.2).any()
        expected = np.where(raw >= 0.2, raw, 0.0)
        np.testing.assert_allclose(table, expected / expected.sum(-1, keepdims=True), atol=1e-6)
        loaded: Any = load_policy(tmp_path / role, greedy=False)
        np.testing.assert_array_equal(loaded.action_probabilities(maze), table)


def test_probabilities_that_leave_no_action_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"min_probability=0.3.*0 to 0.2"):
        make_run(tmp_path, min_probability=0.3)
