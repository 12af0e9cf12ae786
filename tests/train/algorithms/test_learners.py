"""Whole runs of every learner: learning, resumption, and refused settings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from test_algorithms import make_env, make_network

from scripted_agents import RandomAgent
from train.algorithms.a2c import Reinforce
from train.algorithms.ppo import ppo_loss
from train.algorithms.registry import ALGORITHMS, Algorithm, Build, entry, register
from train.commands.train import _defaults
from train.kinds import start
from train.networks.fused_actor_critic import LossCoefficients
from train.runs.folder import RUN
from train.runs.loop import Run
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.settings.algorithms import (
    HYPERPARAMETERS,
    A2CSettings,
    DQNSettings,
    PPOSettings,
    ReinforceSettings,
)
from train.settings.presets import THESIS, preset_algorithm


def test_a_new_learner_is_one_entry() -> None:
    @dataclass(frozen=True)
    class Mine(PPOSettings):
        width: int = 16

    other = entry("ppo")
    register(Algorithm("mine", Mine, other.build, other.load))
    try:
        flat = {**EASY, **SMALL["ppo"], "algorithm": "mine", "clip": 0.3, "frames": 100}
        chosen = settings_of(**flat)
        assert type(chosen.hyper) is entry("mine").settings and chosen.hyper.width == 16
        learner = entry("mine").build(chosen.hyper, make_env(64), Build())
        assert learner.iterate(0.0)["clip_fraction"] >= 0.0
        learner.close()
        with pytest.raises(ValueError, match="'mine' exists already"):
            register(Algorithm("mine", Mine, other.build, other.load))
    finally:
        del ALGORITHMS["mine"], HYPERPARAMETERS["mine"]
    with pytest.raises(ValueError, match="unknown algorithm 'mine'; one of ppo, a2c"):
        entry("mine")


def test_fused_reinforce_has_the_gradients_of_its_loss() -> None:
    env = make_env(64)
    learner = Reinforce(ReinforceSettings(64, 0.9), env, make_network(env))
    plain = Reinforce(ReinforceSettings(64, 0.9), env, learner.network, fused=False)
    assert (learner.update_form, plain.update_form) == ("fused", "torch")
    frames = learner.collect()
    coefficients = LossCoefficients(math.inf, 0.5, 0.01)
    learner.engine.set_gradients(frames, coefficients)
    found = {name: weight.grad for name, weight in learner.network.named_parameters()}
    learner.network.zero_grad()
    ppo_loss(learner.network, frames, coefficients)[0].backward()
    for name, weight in learner.network.named_parameters():
        torch.testing.assert_close(found[name], weight.grad, rtol=1e-3, atol=1e-5)


# -- whole runs ------------------------------------------------------------------------------------

ARM = {"task": "reacher", "joints": 1, "max_steps": 40, "threads": 1}
EASY = {"task": "maze", "maze": "3x3", "num_goals": 2, "threads": 1}
SMALL: dict[str, dict[str, Any]] = {
    "ppo": {"num_games": 64, "minibatch_size": 256},
    "a2c": {"num_games": 64},
    "reinforce": {"num_games": 64},
    "dqn": {"num_games": 64, "batch_size": 128, "learning_starts": 1000},
}
VARIANTS: dict[str, dict[str, Any]] = {
    "ppo with a target for the divergence": {"algorithm": "ppo", "kl_target": 0.01},
    "a2c without generalised advantages": {"algorithm": "a2c", "gae": False},
    "a2c without a critic": {
        "algorithm": "a2c",
        "critic": False,
        "rollout_steps": 32,
        "standardize_advantages": True,
        "entropy_coef": 0.01,
        "frames": 250_000,
    },
    "reinforce without a baseline": {"algorithm": "reinforce", "baseline": False},
    "plain dqn": {"algorithm": "dqn", "double": False, "n_steps": 1},
    "dqn with everything": {"algorithm": "dqn", "dueling": True, "prioritized": True},
}


@pytest.fixture(autouse=True)
def few_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is tested here is what is learned: evaluating it 20 times takes half of the time."""
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 5)


def steps_of(run: Run) -> float:
    """Mean steps of the greedy policy."""
    return run.trainee.contest.score("learned", run.trainee.policy).mean_steps


QUICK = "a2c without generalised advantages"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name != QUICK)) for name in VARIANTS]
)
def test_every_variant_of_a_learner_beats_random_by_far(name: str, tmp_path: Path) -> None:
    chosen = VARIANTS[name]
    flat = {"frames": 60_000, **EASY, **SMALL[chosen["algorithm"]], **chosen}
    run = start(RUN, settings_of(**flat), tmp_path)
    run.train()
    random = run.trainee.contest.score("random", RandomAgent()).mean_steps
    assert steps_of(run) < 0.35 * random


@pytest.mark.parametrize(
    ("algorithm", "role"),
    [
        ("a2c", "chaser"),
        pytest.param("dqn", "evader", marks=pytest.mark.slow),
    ],
)
def test_chasers_and_evaders_learn_by_other_learners_than_ppo(
    algorithm: str, role: str, tmp_path: Path
) -> None:
    maze = {"chaser": "3x3", "evader": "4x4"}[role]
    flat = {**SMALL[algorithm], "algorithm": algorithm, "threads": 1, "frames": 80_000}
    run = start(RUN, settings_of(maze=maze, role=role, **flat), tmp_path)
    run.train()
    random = run.trainee.contest.score("random", RandomAgent()).mean_steps
    assert steps_of(run) < 0.5 * random if role == "chaser" else steps_of(run) > 1.5 * random


SLOW_PRESETS = (
    "thesis-ppo",
    "thesis-reacher-ppo",
    "thesis-ddpg",
    "thesis-td3",
    "thesis-dqn",
    "thesis-a2c",
)
"""An iteration takes seconds; `make test-all` runs them."""


@pytest.mark.parametrize(
    "preset",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in SLOW_PRESETS else name
        for name in THESIS
    ],
)
def test_the_presets_of_the_thesis_run(preset: str, tmp_path: Path) -> None:
    owner = preset_algorithm(preset)
    assert owner is not None
    task = EASY if "discrete" in entry(owner).actions else ARM
    flat = {"learning_starts": 1270, "batch_size": 64} if task is ARM else {}
    run = start(RUN, settings_of(preset=preset, **task, **flat, frames=1300), tmp_path)
    run.train()
    assert run.trainee.learner.frames >= 1300
    content = run.results(10)
    assert content["algorithm"] == owner


def test_the_thesis_tables_are_what_the_presets_hold() -> None:
    ppo, a2c, dqn = (THESIS[f"thesis-{name}"] for name in ("ppo", "a2c", "dqn"))
    assert isinstance(ppo, PPOSettings) and isinstance(a2c, A2CSettings)
    assert isinstance(dqn, DQNSettings)
    assert (ppo.kl_target, ppo.clip, ppo.width) == (0.01, 0.5, 256)
    assert (dqn.exploration_frames, dqn.epsilon_end) == (10_000, 0.02)  # whatever the budget is
    arm = THESIS["thesis-reacher-ppo"]
    assert isinstance(arm, PPOSettings) and preset_algorithm("thesis-reacher-ppo") == "ppo"
    assert (arm.critic, arm.kl_target, arm.clip, arm.width) == (False, 0.005, 0.3, 512)
    assert (a2c.critic, a2c.gae, a2c.width) == (False, False, 256)
    assert not a2c.standardize_advantages and A2CSettings().standardize_advantages
    assert dqn.importance_exponent == dqn.importance_exponent_end == 0.4  # RLlib kept it
    assert (dqn.dueling, dqn.prioritized, dqn.buffer_size, dqn.width) == (True, True, 50_000, 256)


def test_a_policy_without_a_distribution_says_so(tmp_path: Path) -> None:
    flat = {**EASY, **SMALL["dqn"], "algorithm": "dqn", "frames": 2000}
    start(RUN, settings_of(**flat), tmp_path).train()
    load_policy(tmp_path)
    with pytest.raises(ValueError, match="no distribution"):
        load_policy(tmp_path, greedy=False)
    with pytest.raises(ValueError, match="greedy='no'; it is True or False"):
        load_policy(tmp_path, greedy="no")  # type: ignore[arg-type]


def test_unsupported_settings_of_a_learner_are_refused() -> None:
    for flat, message in (
        ({"algorithm": "q_learning", "observation": "cells"}, "table over states"),
        ({"algorithm": "q_learning", "device": "cuda"}, "instead of a network, on the cpu"),
        ({"algorithm": "dqn", "batch_size": 10, "buffer_size": 5}, "buffer_size"),
        ({"algorithm": "dqn", "n_steps": 9}, "n_steps=9 is more than rollout_steps=8"),
        ({"algorithm": "dqn", "lerning_rate": 0.1}, "did you mean 'learning_rate'"),
        ({"algorithm": "sarsa"}, "unknown algorithm"),
        ({"preset": "thesis-sac"}, "unknown preset"),
        ({"preset": "thesis-dqn", "algorithm": "ppo"}, "is for algorithm 'dqn'"),
        ({"algorithm": "dqn", "clip": 0.2}, "unknown setting 'clip'"),
        ({"width": 1.5}, "give a whole number"),
    ):
        with pytest.raises(ValueError, match=message):
            settings_of(**{"seconds": 1, **flat})


def test_discounts_of_runners_by_learner() -> None:
    """At 0.95 the best tour by discounted goals is 0.49 % longer than the shortest on 5x5."""
    small = {"ppo": 0.99, "a2c": 0.95, "reinforce": 0.95, "dqn": 0.99, "q_learning": 1.0}
    for algorithm, gamma in small.items():
        assert settings_of(algorithm=algorithm, task="maze", frames=1).hyper.gamma == gamma
    for algorithm, gamma in {"ppo": 0.99, "a2c": 0.97, "dqn": 0.99}.items():
        large = settings_of(algorithm=algorithm, task="maze", maze="9x9", frames=1)
        assert large.hyper.gamma == gamma
    for algorithm in ("ppo", "a2c", "reinforce", "dqn"):
        assert settings_of(algorithm=algorithm, frames=1).hyper.gamma == 0.95
    for algorithm in ("reinforce", "a2c"):
        whole: Any = settings_of(algorithm=algorithm, task="maze", frames=1).hyper
        assert (whole.gamma_at(0.0), whole.last_gamma) == pytest.approx((0.95, 0.99))
    ends = [
        settings_of(task="maze", num_goals=goals, frames=1).hyper.last_gamma
        for goals in (3, 4, 5, 6, 7, 8, 12)
    ]
    race: Any = settings_of(task="race", num_goals=8, frames=1).hyper
    assert race.gamma == race.last_gamma == 0.99
    assert ends == sorted(ends) and (ends[0], *ends[-2:]) == pytest.approx((0.99, 0.997, 0.997))


def test_a_given_discount_is_constant() -> None:
    given: dict[str, Any] = {"algorithm": "a2c", "task": "maze", "frames": 1}
    assert settings_of(**given, gamma=0.97).hyper.last_gamma == 0.97
    own: Any = settings_of(**given, gamma=0.97, gamma_end=0.98).hyper
    assert (own.gamma, own.gamma_end) == (0.97, 0.98)
    assert settings_of(**given, gamma_end=0.98).hyper.gamma == 0.95
    command = ["--task", "maze", "--algorithm", "a2c", "--gamma", "1", "--frames", "1"]
    hyper: Any = _defaults(command).settings.hyper
    assert hyper.gamma_end is None


def test_entropy_bonuses_of_runners_and_chasers() -> None:
    """Beside standardised advantages a small bonus is too weak there."""
    near: list[dict[str, Any]] = [{"task": "maze", "maze": maze} for maze in ("3x3", "5x5", "9x9")]
    near += [{"task": "chase", "maze": "5x5"}]
    for flat in near:
        for algorithm in ("a2c", "reinforce") if flat["task"] == "maze" else ("a2c",):
            runner: Any = settings_of(algorithm=algorithm, frames=1, **flat).hyper
            assert (runner.standardize_advantages, runner.entropy_coef) == (False, 0.04)
        ppo: Any = settings_of(algorithm="ppo", frames=1, **flat).hyper
        assert (ppo.entropy_coef, ppo.value_coef) == (0.1, 2.0)
    weights = [
        settings_of(task="maze", num_goals=goals, frames=1).hyper.value_coef  # type: ignore[attr-defined]
        for goals in (3, 4, 5, 6, 7, 8, 12)
    ]
    assert weights == sorted(weights, reverse=True) and weights[-2:] == [0.5, 0.5]
    far: Any = settings_of(algorithm="ppo", task="chase", maze="9x9", frames=1).hyper
    assert (far.entropy_coef, far.value_coef) == (0.06, 0.5)
    for flat in ({"task": "chase", "role": "evader"}, {"task": "reacher"}):
        other: Any = settings_of(algorithm="a2c", frames=1, **flat).hyper
        assert other.standardize_advantages and other.entropy_coef <= 0.01


def test_the_learners_are_made_of_their_settings() -> None:
    for algorithm in SMALL:
        chosen = settings_of(**{**EASY, **SMALL[algorithm]}, algorithm=algorithm, frames=100)
        learner = entry(algorithm).build(chosen.hyper, make_env(chosen.hyper.num_games), Build())
        learner.iterate(0.0)
        assert learner.frames > 0
        learner.close()
