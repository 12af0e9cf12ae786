"""DDPG, TD3 and SAC on arms: exploration, replay and targets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from arm_games import arm_games

from train.algorithms.action_noise import ActionNoise
from train.algorithms.learner import Build
from train.algorithms.registry import ALGORITHMS, entry
from train.settings.off_policy import ContinuousSettings, DDPGSettings, SACSettings, TD3Settings
from train.settings.presets import THESIS, preset_algorithm

LEARNERS = [name for name, each in ALGORITHMS.items()
            if issubclass(each.settings, ContinuousSettings)]  # fmt: skip
SMALL: dict[str, Any] = {
    "num_games": 16, "rollout_steps": 4, "batch_size": 32, "buffer_size": 300, "width": 8,
    "learning_starts": 100, "gradient_steps": 3, "noise": "ornstein-uhlenbeck",
}  # fmt: skip


def make(name: str, seed: int = 0, **changes: Any) -> Any:
    settings: Any = entry(name).settings(**{**SMALL, **changes})
    torch.manual_seed(seed)
    return entry(name).build(settings, arm_games(settings.num_games, seed), Build(seed=seed))


# -- noise -----------------------------------------------------------------------------------------


def test_the_noise_that_drifts_is_its_equation_and_has_its_stationary_variance() -> None:
    noise = ActionNoise("ornstein-uhlenbeck", 0.15, 2000, 3, seed=1)
    twin = torch.Generator()
    twin.set_state(noise.generator.get_state())
    noise.std, expected, taken = 0.2, torch.zeros(2000, 3), []
    for step in range(200):
        expected = expected + 0.15 * (0.0 - expected) + 0.2 * torch.randn(2000, 3, generator=twin)
        found = noise.step()
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)
        if step > 60:
            taken.append(found.clone())
    stationary = 0.2**2 / (0.15 * (2.0 - 0.15))
    assert float(torch.stack(taken).var()) == pytest.approx(stationary, rel=0.02)
    lagged = (taken[0] * taken[5]).mean() / stationary
    assert float(lagged) == pytest.approx(0.85**5, abs=0.05)


def test_gaussian_noise_forgets_and_games_have_their_own() -> None:
    noise = ActionNoise("gaussian", 0.15, 5000, 2, seed=1)
    noise.std = 0.3
    one, other = noise.step().clone(), noise.step()
    assert float(one.std()) == pytest.approx(0.3, rel=0.05)
    together = torch.corrcoef(torch.stack([one.flatten(), other.flatten()]))
    assert abs(float(together[0, 1])) < 0.05
    assert len(one.unique()) > 9000


def test_noise_is_reset_with_the_episode_of_its_game() -> None:
    learner = make("td3", noise_start=0.3, rollout_steps=1)
    learner.random_actions, learner.noise.std, ended = False, 0.3, 0
    for _ in range(410):
        over = learner.collector.rollout()["done"][:, 0]
        ended += int(over.sum())
        assert bool((learner.noise.state[over] == 0.0).all())
        assert bool((learner.noise.state[~over] != 0.0).all())
    assert ended >= 16


def test_noise_is_annealed_over_its_share_of_the_budget() -> None:
    learner = make("ddpg", noise_start=1.0, noise_end=0.2, noise_share=0.5, learning_starts=0)
    found = []
    for progress in (0.0, 0.25, 0.5, 1.0):
        assert learner.iterate(progress)["noise"] == learner.noise.std
        found.append(learner.noise.std)
    assert found == pytest.approx([1.0, 0.6, 0.2, 0.2])


def test_actions_are_uniform_until_learning_starts_and_the_actors_then() -> None:
    learner = make("td3", noise="none", learning_starts=64)
    learner.iterate(0.0)
    first = learner.replay.columns()["action"].clone()
    assert float(first.abs().max()) > 0.9 and float(first.std()) == pytest.approx(0.577, abs=0.1)
    before = {name: rows.clone() for name, rows in learner.network.state_dict().items()}
    learner.settings = replace(learner.settings, gradient_steps=1)
    learner.iterate(0.0)
    played = learner.replay.columns()
    learner.network.load_state_dict(before)
    expected = learner.network.act(played["observation"][64:]).detach()
    torch.testing.assert_close(played["action"][64:], expected)


# -- memory ----------------------------------------------------------------------------------------


def test_the_last_observation_of_an_episode_is_remembered_and_not_the_next_ones_first() -> None:
    learner = make("ddpg", rollout_steps=1, buffer_size=20_000, max_grad_norm=1.0)
    for _ in range(410):
        learner.store(learner.collector.rollout())
    rows = {
        name: column.unflatten(0, (410, 16)) for name, column in learner.replay.columns().items()
    }
    moved = (rows["next_observation"][:-1] != rows["observation"][1:]).any(-1)
    assert moved.any()
    ended = rows["terminated"][:-1] | moved
    # In reach or not is the first number: an episode that ended in reach says so at its end.
    assert (rows["next_observation"][:-1][rows["terminated"][:-1]][:, 0] == 1.0).all()
    assert (rows["next_observation"][:-1][~ended] == rows["observation"][1:][~ended]).all()


# -- updates ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("tau", [0.0, 1.0])
def test_targets_that_never_follow_and_those_that_copy(tau: float) -> None:
    learner = make("ddpg", tau=tau, learning_starts=0)
    start = [weight.clone() for weight in learner.target_critics.parameters()]
    for _ in range(5):
        learner.iterate(0.0)
    wanted = start if tau == 0.0 else list(learner.critics.parameters())
    for one, other in zip(learner.target_critics.parameters(), wanted, strict=True):
        assert torch.equal(one, other)


def test_the_actor_waits_for_its_critics() -> None:
    learner = make("td3", policy_delay=4, learning_starts=0, gradient_steps=3)
    start = [weight.clone() for weight in learner.network.parameters()]
    learner.iterate(0.0)
    assert all(map(torch.equal, start, learner.network.parameters()))
    learner.iterate(0.0)
    assert not all(map(torch.equal, start, learner.network.parameters()))


def test_the_temperature_of_sac_follows_the_entropy() -> None:
    for target, change in ((-8.0, -1.0), (5.0, 1.0)):
        learner = make("sac", target_entropy=target, learning_starts=0)
        for _ in range(20):
            figures = learner.iterate(0.0)
        assert change * (figures["temperature"] - 0.02) > 0.0
    learner = make("sac", adapt_temperature=False, learning_starts=0)
    assert learner.iterate(0.0)["temperature"] == pytest.approx(0.02)


# -- what is said ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "given", "message"),
    [
        (DDPGSettings, {"noise": "pink"}, "unknown noise 'pink'; one of gaussian, ornstein"),
        (TD3Settings, {"tau": 1.5}, r"tau=1.5; must be in \[0, 1\]"),
        (TD3Settings, {"policy_delay": 0}, "policy_delay=0; must be at least 1"),
        (TD3Settings, {"target_noise": -0.1}, "target_noise=-0.1; must be finite, at least 0"),
        (SACSettings, {"temperature": 0.0}, "temperature=0.0; must be above 0"),
        (SACSettings, {"target_entropy": float("inf")}, "target_entropy=inf; must be finite"),
        (SACSettings, {"critic_learning_rate": 0.0}, "critic_learning_rate=0.0; must be above 0"),
        (SACSettings, {"noise_theta": 2.0}, r"noise_theta=2.0; must be in \[0, 1\]"),
        (DDPGSettings, {"n_steps": 2}, "n_steps=2 is more than rollout_steps=1"),
    ],
)
def test_invalid_settings_are_refused(form: Any, given: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        form(**given)


def test_policies_are_loaded_as_they_were_and_only_that_of_sac_draws() -> None:
    for name in LEARNERS:
        learner = make(name, learning_starts=64)
        for _ in range(3):
            learner.iterate(0.0)
        view, state = learner.env.simulator.view(), learner.state_dict()
        again = entry(name).load(learner.settings, learner.env.player, state, True)
        np.testing.assert_array_equal(again.act(view), learner.policy().act(view))
        assert entry(name).learns_distribution == (name == "sac")
        if name == "sac":
            drawn = learner.policy(greedy=False).act(view)
            assert not np.array_equal(drawn, learner.policy().act(view))
        else:
            with pytest.raises(ValueError, match="no distribution"):
                learner.policy(greedy=False)
        learner.close()


def test_the_thesis_tables_are_what_the_presets_hold() -> None:
    ddpg, td3 = THESIS["thesis-ddpg"], THESIS["thesis-td3"]
    assert isinstance(ddpg, DDPGSettings) and isinstance(td3, TD3Settings)
    assert preset_algorithm("thesis-td3") == "td3"
    assert (ddpg.batch_size, ddpg.buffer_size, ddpg.tau, ddpg.width) == (512, 5000, 0.001, 256)
    assert (td3.batch_size, td3.buffer_size, td3.tau, td3.width) == (512, 10_000, 0.001, 256)
    assert ddpg.prioritized and not td3.prioritized
    assert {ddpg.noise, td3.noise} == {"ornstein-uhlenbeck"}
