"""Learners of self-play: matrix games with known equilibria, and the parts of their updates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from matrix_games import MatrixEnv, exploitability, play

from train.algorithms.nfsp import NFSP, Reservoir
from train.algorithms.registry import Build, entry
from train.algorithms.regularized import MAGNET
from train.kinds import start
from train.networks.distributions import DISTRIBUTION
from train.networks.fused_actor_critic import LossCoefficients
from train.runs.folder import SELF_PLAY
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.self_play.parts import self_play_settings_of

# Rock, paper, scissors by three rules: the payoffs of the first player, and the equilibrium
# strategy of both. The last game has a fourth action that is worse than all others.
PLAIN = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
BIASED = np.array([[0.0, -1.0, 2.0], [1.0, 0.0, -3.0], [-2.0, 3.0, 0.0]])
DOMINATED = np.pad(BIASED, (0, 1))
DOMINATED[:3, 3], DOMINATED[3, :3] = 3.0, -3.0
GAMES = {
    "plain": (PLAIN, [1 / 3, 1 / 3, 1 / 3]),
    "biased": (BIASED, [3 / 6, 2 / 6, 1 / 6]),
    "dominated": (DOMINATED, [3 / 6, 2 / 6, 1 / 6, 0.0]),
}
ROLLOUT = {"games": 1024, "minibatch_size": 512, "epochs": 1, "learning_rate": 6e-3}
LEARNERS: dict[str, tuple[int, dict[str, Any]]] = {
    "mmd": (250, {"magnet_coef": 1.0}),
    "rnad": (400, {"reward_coef": 2.0}),
}
"""Iterations, and settings."""
MOST = {("mmd", "plain"): 0.05, ("mmd", "biased"): 0.1, ("rnad", "dominated"): 0.3}
"""Mean exploitability of the last 25 policies; three or four seeds were all below. Uniform
policies have 0, 0.33 and 1, those of PPO at least 0.5, 1.0 and 2.4."""


@pytest.mark.parametrize("game", GAMES)
def test_exploitability_is_0_at_the_equilibrium_only(game: str) -> None:
    payoff, mixture = GAMES[game]
    assert exploitability(payoff, np.array([mixture, mixture])) == pytest.approx(0.0)
    for pure in np.eye(len(payoff)):
        assert exploitability(payoff, np.array([mixture, pure])) >= 0.5
    uniform = np.full((2, len(payoff)), 1 / len(payoff))
    expected = {"plain": 0.0, "biased": 1 / 3, "dominated": 1.0}[game]
    assert exploitability(payoff, uniform) == pytest.approx(expected)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "game"), MOST)
def test_the_last_policies_are_an_equilibrium(name: str, game: str) -> None:
    payoff, mixture = GAMES[game]
    iterations, settings = LEARNERS[name]
    policies = play(name, payoff, iterations, **ROLLOUT, **settings)[-25:]
    assert np.mean([exploitability(payoff, pair) for pair in policies]) < MOST[name, game]
    np.testing.assert_allclose(policies.mean(axis=0), [mixture, mixture], atol=0.17)


def test_the_last_policies_of_plain_ppo_are_none() -> None:
    policies = play("ppo", BIASED, 250, entropy_coef=0.0, **ROLLOUT)[-25:]
    assert min(exploitability(BIASED, pair) for pair in policies) > 1.0


@pytest.mark.slow
def test_the_average_policies_of_fictitious_play_are_an_equilibrium() -> None:
    payoff, mixture = GAMES["dominated"]
    settings = {
        "learning_rate": 0.02, "average_learning_rate": 0.01, "anneal": False, "batch_size": 128,
        "buffer_size": 512, "learning_starts": 0, "max_grad_norm": 100.0, "gradient_steps": 4,
        "epsilon_start": 0.1,
    }  # fmt: skip
    policies = play("nfsp", payoff, 400, 256, **settings)
    assert exploitability(payoff, policies[0]) > 0.8
    assert np.mean([exploitability(payoff, pair) for pair in policies[-25:]]) < 0.45
    np.testing.assert_allclose(policies[-25:].mean(axis=0), [mixture, mixture], atol=0.2)


# -- the parts of the updates ----------------------------------------------------------------------


def learner_of(name: str, games: int = 64, **settings: Any) -> Any:
    torch.manual_seed(0)
    env: Any = MatrixEnv(BIASED, games)
    env.opponent = np.array([0.2, 0.3, 0.5])
    hyper = entry(name).settings(num_games=games, width=16, **settings)
    return entry(name).build(hyper, env, Build())


def test_the_loss_of_mmd_is_least_at_the_closed_form_of_the_paper() -> None:
    """Sokota et al. (2023), section 3: the next policy is proportional to
    [policy * magnet ** (alpha eta) * exp(eta q)] ** (1 / (1 + alpha eta))."""
    alpha, eta = 0.7, 2.5
    given = {"magnet_coef": alpha, "step_coef": 1 / eta, "minibatch_size": 64}
    learner = learner_of("mmd", adam_beta1=0.9, **given)
    count = torch.tensor([6, 3, 1])  # the collecting policy plays these actions of 10 frames
    now, magnet = (count / 10).log(), torch.tensor([0.2, 0.2, 0.6]).log()
    q = torch.tensor([0.5, -1.0, 0.8])
    expected = ((now + alpha * eta * magnet + eta * q) / (1 + alpha * eta)).softmax(0)
    action = torch.arange(3).repeat_interleave(count)
    ones = torch.ones(10, 1)
    minibatch = {
        "prepared": learner.network.policy_trunk.prepare(ones),
        "action": action,
        "action_log_prob": now[action],
        "advantage": q[action],
        DISTRIBUTION: ones * now,
        MAGNET: ones * magnet,
    }
    exact = LossCoefficients(1e9, None, 0.0, standardize=False)
    for _ in range(400):
        learner.descend(learner.loss(minibatch, exact)[0])
    found = learner.network.logits(ones)[0].softmax(0)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3)


def test_iterating_the_closed_form_ends_in_the_quantal_response_equilibrium() -> None:
    """The fixed point for a constant magnet: each policy is the softmax of (q / alpha)."""
    alpha, eta, policies = 0.5, 0.1, [torch.tensor([0.8, 0.1, 0.1]).log() for _ in range(2)]
    payoff = torch.tensor(BIASED, dtype=torch.float32)
    for _ in range(2000):
        values = payoff @ policies[1].exp(), -payoff.T @ policies[0].exp()
        policies = [
            ((policy + eta * q) / (1 + alpha * eta)).log_softmax(0)
            for policy, q in zip(policies, values, strict=True)
        ]
    torch.testing.assert_close(policies[0].exp(), (values[0] / alpha).softmax(0))


def test_magnets_and_references_follow_at_their_rate_and_interval() -> None:
    magnet = learner_of("mmd", minibatch_size=64, reference_rate=0.25)
    before = [weights.clone() for weights in magnet.reference.parameters()]
    magnet.iterate(0.0)
    for old, new, goal in zip(
        before, magnet.reference.parameters(), magnet.network.parameters(), strict=True
    ):
        torch.testing.assert_close(new, 0.75 * old + 0.25 * goal)
    learner = learner_of("rnad", minibatch_size=64, reference_interval=2)
    first = learner.reference.policy_head.weight.clone()
    learner.iterate(0.0)
    assert torch.equal(learner.reference.policy_head.weight, first)
    learner.iterate(0.0)
    assert not torch.equal(learner.reference.policy_head.weight, first)
    assert torch.equal(learner.reference.policy_head.weight, learner.network.policy_head.weight)


def test_the_rewards_of_rnad_have_the_log_ratio_of_both_policies() -> None:
    learner = learner_of("rnad", minibatch_size=64, reward_coef=0.5)
    with torch.no_grad():
        learner.reference.policy_head.bias += torch.tensor([0.0, 1.0, -1.0])
    rollout = learner.engine.edit(learner.engine.collector.rollout())
    policies = [
        learner.env.player.policy(network, greedy=False)
        for network in (learner.network, learner.reference)
    ]
    change = 0.5 * np.log(policies[0] / policies[1])
    own = rollout["action"].numpy()
    paid = rollout["reward"].numpy() + change[own]
    assert all(
        min(abs(reward - BIASED[action])) < 1e-5
        for reward, action in zip(paid.ravel(), own.ravel(), strict=True)
    )


def test_a_reservoir_is_a_uniform_sample_of_all_rows() -> None:
    generator, left, trials = torch.Generator().manual_seed(0), np.zeros(40), 3000
    for _ in range(trials):
        kept = Reservoir(4, generator)
        for rows in torch.arange(40).split([3, 7, 1, 29]):
            kept.extend({"action": rows})
        found = kept.columns()["action"].numpy()
        assert len(set(found)) == len(kept) == 4
        left[found] += 1
    # Standard error 0.0055.
    np.testing.assert_allclose(left / trials, 0.1, atol=0.022)


def test_whole_episodes_are_responses_and_only_these_are_in_the_reservoir() -> None:
    learner: NFSP = learner_of("nfsp", 2000, anticipatory=0.2, epsilon_start=0.0)
    with torch.no_grad():
        learner.network.policy_head.bias += torch.tensor([0.0, 0.0, 99.0])
    start = torch.ones(2000, dtype=torch.bool)
    seen = {"observation": torch.ones(2000, 1), "episode_start": start}
    learner.explore(0.0)
    chosen, state = learner.act(seen, torch.zeros(2000, 0))
    responding = chosen["responding"]
    assert float(responding.float().mean()) == pytest.approx(0.2, abs=0.04)
    assert bool((chosen["action"][responding] == 2).all())
    assert 0.1 < float((chosen["action"][~responding] == 2).float().mean()) < 0.6
    later = learner.act({**seen, "episode_start": ~start}, state)[0]["responding"]
    assert torch.equal(later, responding)
    learner.store(learner.collector.rollout())
    assert len(learner.replay) == 2000 * learner.settings.rollout_steps
    assert len(learner.reservoir) == pytest.approx(0.2 * len(learner.replay), rel=0.1)
    assert bool((learner.reservoir.columns()["action"] == 2).all())


# -- runs ------------------------------------------------------------------------------------------

NAMES = ("mmd", "rnad", "nfsp")


@pytest.mark.parametrize("name", NAMES)
def test_runs_of_a_single_agent_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"'{name}' is for self-play; use `pursuit self-play"):
        settings_of(algorithm=name, frames=1000)
    with pytest.raises(ValueError, match=f"'{name}' is for self-play"):
        settings_of(algorithm=name, task="reacher", frames=1000)


def test_the_memory_of_a_network_and_teams_of_fictitious_play_are_refused() -> None:
    for name in NAMES:
        with pytest.raises(ValueError, match=f"'gru' is not supported by {name}"):
            self_play_settings_of(frames=1000, chaser={"algorithm": name}, recurrent="gru")
    with pytest.raises(ValueError, match="'nfsp' with 2 chasers; for several agents"):
        self_play_settings_of(frames=1000, chaser={"algorithm": "nfsp"}, num_chasers=2)


@pytest.mark.slow
def test_what_a_run_of_fictitious_play_saves_and_evaluates_is_the_average(tmp_path: Path) -> None:
    small = {"num_games": 24, "batch_size": 32, "learning_starts": 0, "width": 8}
    given: Any = {"algorithm": "nfsp", **small}
    settings = self_play_settings_of(maze="3x3", frames=4000, snapshots=2, **given)
    run = start(SELF_PLAY, settings, tmp_path)
    run.train()
    for role, side in run.trainee.sides.items():
        learner: Any = side.learner
        average, name = side.average, "policy_head.weight"
        torch.testing.assert_close(
            average[name], learner.average_network.policy_head.weight.detach(), rtol=0.1, atol=0.05
        )
        assert not torch.equal(average[name], learner.network.policy_head.weight)
        saved: Any = load_policy(tmp_path / role, greedy=False)
        snapshot: Any = side.load(side.snapshot())
        for policy in (run.trainee.policy(role), saved, snapshot):
            assert not policy.greedy
            found = policy.network.state_dict()
            assert all(torch.equal(found[name], average[name]) for name in average)
    assert run.results(20)["evaluation"]["nash_conv"] > 0.0
