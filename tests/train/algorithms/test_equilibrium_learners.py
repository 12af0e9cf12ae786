"""Learners of self-play on matrix games with known equilibria, and the parts of their updates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from matrix_games import MatrixEnv, exploitability, play

from train.algorithms.learner import NetworkLearner
from train.algorithms.nfsp import NFSP, Reservoir
from train.algorithms.registry import Build, entry
from train.algorithms.regularized import MAGNET
from train.networks.distributions import DISTRIBUTION
from train.networks.fused_actor_critic import LossCoefficients
from train.runs.parts import settings_of

# Rock, paper, scissors: the payoff of the row, and the equilibrium strategy of both players.
PLAIN = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
BIASED = np.array([[0.0, -1.0, 2.0], [1.0, 0.0, -3.0], [-2.0, 3.0, 0.0]])
DOMINATED = np.pad(BIASED, (0, 1), constant_values=-3.0) * 1.0
DOMINATED[:, 3], DOMINATED[3, 3] = 3.0, 0.0
GAMES = {
    "plain": (PLAIN, [1 / 3, 1 / 3, 1 / 3]),
    "biased": (BIASED, [3 / 6, 2 / 6, 1 / 6]),
    "dominated": (DOMINATED, [3 / 6, 2 / 6, 1 / 6, 0.0]),
}
ROLLOUT = {"games": 1024, "minibatch_size": 512}
LEARNERS: dict[str, dict[str, Any]] = {
    "mmd": {"magnet_coef": 1.0, "step_coef": 0.1, "reference_rate": 0.05, **ROLLOUT},
    "mmd with a uniform magnet": {"magnet": "uniform", "magnet_coef": 2.0, **ROLLOUT},
    "rnad": {"reward_coef": 2.0, "reference_interval": 20, **ROLLOUT},
}


@pytest.mark.parametrize("game", GAMES)
def test_the_games_have_these_equilibria(game: str) -> None:
    payoff, mixture = GAMES[game]
    assert exploitability(payoff, np.array([mixture, mixture])) == pytest.approx(0.0)
    assert (payoff == -payoff.T).all()
