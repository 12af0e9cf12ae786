"""Every learner: its loss against TorchRL's or a plain loop, its resumption, and that it learns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss, KLPENPPOLoss
from torchrl_heads import actor_of, critic_of, ours

from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from train.algorithms.a2c import A2C, Reinforce
from train.algorithms.dqn import DQN, dqn_loss
from train.algorithms.ppo import PPO, ppo_loss
from train.algorithms.registry import Build, entry
from train.environments.hooks import EpisodeHook
from train.environments.simulator_env import SimulatorEnv
from train.networks.actor_critic import ActorCritic
from train.networks.features import Features
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.layers import Hidden
from train.networks.policy import MazeSeat
from train.networks.q_network import QNetwork
from train.settings.algorithms import (
    A2CSettings,
    DQNSettings,
    PPOSettings,
    ReinforceSettings,
)

TASK = make_task("maze", maze="3x3", num_goals=2, max_steps=12)


def make_env(games: int, seed: int = 0) -> SimulatorEnv:
    simulator = Simulator(TASK, games, seed, auto_restart=False)
    return SimulatorEnv(simulator, MazeSeat(TASK, "runner"), [None])


NOT_FUSED = Hidden(16, activation="tanh")
"""Layers whose draws and gradients are not written out; for those see
tests/train/networks/test_fused_actor_critic.py."""


def make_network(env: SimulatorEnv, form: Any = ActorCritic, hidden: Hidden | None = None) -> Any:
    torch.manual_seed(0)
    return form(env.player.features, 4, hidden or Hidden(16))


# -- losses ----------------------------------------------------------------------------------------


def test_the_penalty_on_the_divergence_equals_torchrls() -> None:
    env = make_env(256)
    network = make_network(env)
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    prepared = network.policy_trunk.prepare(env.reset()["observation"])
    before = torch.randn(256, 4).log_softmax(-1)
    action = torch.randint(4, (256,))
    minibatch = TensorDict(
        {
            "prepared": prepared,
            "action": action,
            "distribution": before,
            "action_log_prob": before.gather(1, action[:, None]).squeeze(1),
            "advantage": torch.randn(256, 1),
            "value_target": torch.randn(256, 1),
        },
        batch_size=[256],
    )
    # No clipping, so that the objective is that of the penalised form alone.
    found = ppo_loss(network, ours(minibatch), LossCoefficients(1e9, 1.0, 0.0, kl_coef=0.7))[0]
    loss = KLPENPPOLoss(
        actor_of(network),
        critic_of(network),
        beta=0.7,
        entropy_bonus=False,
        loss_critic_type="l2",
        normalize_advantage=True,
    )
    minibatch["policy_hidden"], minibatch["value_hidden"] = network.hidden(prepared)
    minibatch["logits"] = before
    losses = loss(minibatch)
    penalty = ppo_loss(network, ours(minibatch), LossCoefficients(0.2, 0.5, 0.0, kl_coef=0.7))[1][
        "kl"
    ]
    distributions = [
        torch.distributions.Categorical(logits=logits)
        for logits in (before, network.policy_head(minibatch["policy_hidden"]))
    ]
    torch.testing.assert_close(penalty, torch.distributions.kl_divergence(*distributions).mean())
    theirs = losses["loss_objective"] + losses["loss_critic"]
    torch.testing.assert_close(found, theirs, rtol=1e-4, atol=1e-5)


def test_the_weight_of_the_divergence_follows_its_target() -> None:
    env = make_env(16)
    learner = PPO(PPOSettings(16, minibatch_size=64, kl_target=0.01), env, make_network(env), "cpu")
    learner._adapt_kl_coef(torch.tensor(0.021))
    assert learner.kl_coef == pytest.approx(0.3)
    learner._adapt_kl_coef(torch.tensor(0.004))
    assert learner.kl_coef == pytest.approx(0.15)
    learner._adapt_kl_coef(torch.tensor(0.01))
    assert learner.kl_coef == pytest.approx(0.15)
    assert {"kl", "loss_objective"} <= set(learner.iterate(0.0))
    learner.close()


@dataclass(frozen=True)
class OwnA2CSettings(A2CSettings):
    bonus: float = 0.5


@dataclass(frozen=True)
class OwnReinforceSettings(ReinforceSettings):
    bonus: float = 0.5


@pytest.mark.parametrize(
    "form, settings", [(A2C, OwnA2CSettings(16)), (Reinforce, OwnReinforceSettings(16))]
)
def test_own_fields_of_settings_reach_the_learner(form: Any, settings: Any) -> None:
    env = make_env(16)
    learner = form(settings, env, make_network(env))
    assert learner.settings is settings and learner.settings.bonus == 0.5
    assert "loss_objective" in learner.iterate(0.0)
    learner.close()


@pytest.mark.parametrize("gae", [True, False])
@pytest.mark.parametrize("critic", [True, False])
def test_advantages_with_and_without_gae_and_critic_equal_a_plain_loop(
    gae: bool, critic: bool
) -> None:
    env = make_env(16)
    network = make_network(env, hidden=NOT_FUSED)
    chosen = A2CSettings(16, 0.9, rollout_steps=20, gae=gae, critic=critic, gae_lambda=0.8)
    learner = A2C(chosen, env, network, "cpu")
    collector = learner.engine.collector
    collector.keep_next = True
    rollout = collector.rollout()
    collector.rollout = lambda: rollout
    frames = learner.collect()
    learner.close()
    with torch.no_grad():
        values = network(rollout["observation"])[1].squeeze(-1).numpy() * critic
        after = network(rollout["next_observation"])[1].squeeze(-1).numpy() * critic
    rewards, done, terminated = (rollout[key].numpy() for key in ("reward", "done", "terminated"))
    expected = np.zeros_like(values)
    for game in range(16):
        if gae:
            running = 0.0
            for step in reversed(range(20)):
                value = 0.0 if terminated[game, step] else after[game, step]
                delta = rewards[game, step] + 0.9 * value - values[game, step]
                fade = 0.72 if critic else 0.9  # without values lambda would discount once more
                running = delta + (0.0 if done[game, step] else fade * running)
                expected[game, step] = running
        else:
            for step in range(20):
                total, discount = 0.0, 1.0
                for later in range(step, 20):
                    total += discount * rewards[game, later]
                    discount *= 0.9
                    if done[game, later] or later == 19:
                        total += 0.0 if terminated[game, later] else discount * after[game, later]
                        break
                expected[game, step] = total - values[game, step]
    np.testing.assert_allclose(frames["advantage"].reshape(16, 20), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("standardize", [True, False])
def test_a2c_standardizes_advantages_by_default(standardize: bool) -> None:
    env = make_env(16)
    chosen = A2CSettings(16, standardize_advantages=standardize)
    learner = A2C(chosen, env, make_network(env, hidden=NOT_FUSED), "cpu")
    frames = learner.collect()
    raw = frames["advantage"]
    expected = (raw - raw.mean()) / raw.std() if standardize else raw
    with torch.no_grad():
        logits = learner.network.policy_head(learner.network.hidden(frames["prepared"])[0])
        log_prob = logits.log_softmax(-1).gather(1, frames["action"][:, None]).squeeze(1)
    learner.collect = lambda: frames  # type: ignore[method-assign]
    found = learner.iterate(0.0)["loss_objective"]
    learner.close()
    assert found == pytest.approx(-float((log_prob * expected).mean()), rel=1e-4, abs=1e-6)


def test_the_weights_of_prioritised_replay_are_annealed_over_the_run() -> None:
    env = make_env(16)
    small = {"prioritized": True, "learning_starts": 64, "batch_size": 8, "buffer_size": 400}
    learner = DQN(DQNSettings(16, **small), env, Build())  # type: ignore[arg-type]
    found = []
    for progress in (0.0, 0.5, 1.0):
        learner.iterate(progress)
        found.append(learner.beta)
    learner.close()
    assert found == pytest.approx([0.4, 0.7, 1.0])  # Schaul et al. (2016)


def test_reinforces_discount_is_annealed_by_its_horizon() -> None:
    settings = ReinforceSettings(16, 0.9, gamma_end=0.999)
    assert [settings.gamma_at(time) for time in (0.0, 0.5, 1.0)] == pytest.approx(
        [0.9, 0.99, 0.999]
    )
    assert (
        ReinforceSettings(16, 0.95).gamma_at(0.3) == ReinforceSettings(16, 0.95).last_gamma == 0.95
    )
    env = make_env(16)
    learner = Reinforce(settings, env, make_network(env), "cpu")
    discounts = []
    for time in (0.0, 0.5, 1.0):
        learner.iterate(time)
        discounts.append(learner.gamma)
    assert discounts == pytest.approx([0.9, 0.99, 0.999])
    with pytest.raises(ValueError, match=r"gamma=1\.0, gamma_end=0\.99; both must be in"):
        ReinforceSettings(gamma=1.0, gamma_end=0.99)


@pytest.mark.parametrize("recurrent", [None, "gru"])  # by kernels, and by torch
def test_advantages_are_those_of_the_annealed_discount(recurrent: str | None) -> None:
    """As with that discount throughout; the games and the draws are the same."""
    found = []
    for settings in (
        A2CSettings(16, 0.9, recurrent, gamma_end=0.999),
        A2CSettings(16, 0.99, recurrent),
    ):
        torch.manual_seed(0)
        env = make_env(16)
        learner = A2C(settings, env, make_network(env, hidden=Hidden(16, recurrent=recurrent)))
        assert learner.update_form == ("fused" if recurrent is None else "torch")
        learner.set_schedules(0.5)
        frames = learner.collect()
        assert frames["value_target"].abs().max() > 0.1  # rewards are not all 0
        found.append(frames["advantage"])
        learner.close()
    torch.testing.assert_close(*found)


def test_reinforce_learns_from_whole_episodes_and_their_returns() -> None:
    env = make_env(64)
    learner = Reinforce(ReinforceSettings(64, 0.9), env, make_network(env), "cpu")
    frames = learner.collect()
    lengths = np.concatenate(env.finished_lengths)
    assert len(lengths) == 64 and len(frames["value"]) == lengths.sum()
    assert (lengths == 12).any() and (lengths < 12).any()
    # The first frames' targets are the discounted returns of the games' episodes.
    again = make_env(64)
    again.reset()
    order = [np.arange(64)]
    taken = 64
    while taken < len(frames["value"]):  # which games were still running at each step
        alive = [game for game in order[-1] if _length(env, game) > len(order)]
        order.append(np.array(alive))
        taken += len(alive)
    observed = env.simulator.returns
    for game in range(64):
        rewards = []
        assert not again.simulator.ended[game]
        row = 0
        for step, games in enumerate(order):
            if game in games:
                where = row + int(np.flatnonzero(games == game)[0])
                target = float(frames["value_target"][where])
                following = None
                if step + 1 < len(order) and game in order[step + 1]:
                    later = row + len(games) + int(np.flatnonzero(order[step + 1] == game)[0])
                    following = float(frames["value_target"][later])
                if following is not None:
                    rewards.append(target - 0.9 * following)
            row += len(games)
        assert all(min(abs(r + 0.1), abs(r - 1.0)) < 1e-4 for r in rewards), rewards
    assert observed.shape == (64, 1)


def _length(env: SimulatorEnv, game: int) -> int:
    return int(env.simulator.steps[game])


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("weighted", [True, False])
def test_the_loss_of_dqn_and_its_gradients_equal_torchrls(double: bool, weighted: bool) -> None:
    env = make_env(256)
    network, target = make_network(env, QNetwork), make_network(env, QNetwork)
    with torch.no_grad():
        for weight in target.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    env.reset()
    steps = torch.randint(1, 4, (256,))
    batch = TensorDict(
        {
            "observation": env.reset()["observation"],
            "action": torch.randint(4, (256,)),
            "reward": torch.randn(256),
            "next_observation": env.reset()["observation"],
            "terminated": torch.rand(256) < 0.3,
            "steps": steps,
        },
        batch_size=[256],
    )
    if weighted:
        batch["priority_weight"] = torch.rand(256) + 0.1
    ours, error = dqn_loss(network, target, batch, 0.9, double)
    gradients = torch.autograd.grad(ours, list(network.parameters()))
    actor = QValueActor(
        module=TensorDictModule(network, ["observation"], ["action_value"]),
        in_keys=["observation"],
        action_space="categorical",
    )
    loss = DQNLoss(actor, action_space="categorical", double_dqn=double, delay_value=True)
    loss.make_value_estimator(gamma=0.9)
    parameters = dict(target.named_parameters())
    for name, weights in loss.target_value_network_params.flatten_keys(".").items():
        if name.replace("module.0.module.", "") in parameters:
            weights.data.copy_(parameters[name.replace("module.0.module.", "")])
    ended = batch["terminated"][:, None]
    theirs_batch = TensorDict(
        {
            "observation": batch["observation"],
            "action": batch["action"],
            "steps_to_next_obs": steps[:, None],
            "next": {
                "observation": batch["next_observation"],
                "reward": batch["reward"][:, None],
                "terminated": ended,
                "done": ended,
            },
        },
        batch_size=[256],
    )
    if weighted:
        theirs_batch["priority_weight"] = batch["priority_weight"]
    theirs = loss(theirs_batch)["loss"]
    torch.testing.assert_close(ours, theirs)
    torch.testing.assert_close(error.square(), theirs_batch["td_error"].squeeze(-1))
    for a, b in zip(
        gradients, torch.autograd.grad(theirs, list(network.parameters())), strict=True
    ):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("n_steps", [1, 3])
def test_the_replay_buffer_of_dqn_equals_a_plain_loop(n_steps: int) -> None:
    env = make_env(16)
    chosen = DQNSettings(16, 0.9, rollout_steps=20, n_steps=n_steps, buffer_size=1000, batch_size=8)
    learner = DQN(chosen, env, Build())
    rollout = learner.collector.rollout()
    learner.store(rollout)
    learner.close()
    remembered = {
        name: column.unflatten(0, (16, 20)) for name, column in learner.replay.columns().items()
    }
    done, terminated = rollout["done"], rollout["terminated"]
    assert terminated.any() and (done & ~terminated).any()
    for game in range(16):
        for step in range(20):
            total, last = 0.0, step
            for count in range(n_steps):
                last = step + count
                total += 0.9**count * float(rollout["reward"][game, last])
                if done[game, last] or last == 19:
                    break
            row = {name: column[game, step] for name, column in remembered.items()}
            assert float(row["reward"]) == pytest.approx(total, abs=1e-5)
            assert int(row["steps"]) == last - step + 1
            assert bool(row["terminated"]) == bool(terminated[game, last])
            assert torch.equal(row["next_observation"], rollout["next_observation"][game, last])
            assert torch.equal(row["observation"], rollout["observation"][game, step])
            assert torch.equal(row["action"], rollout["action"][game, step])


# -- learners know specs ---------------------------------------------------------------------------


class Line(EnvBase):
    """No grid, no simulator: steps of ±0.1 on a line in [-1, 1]; one ends at either end."""

    def __init__(self, num_games: int) -> None:
        super().__init__(device="cpu", batch_size=[num_games])
        self.player, self.hook, self.resume = Point(), EpisodeHook(), False
        self.num_games = self.rows = num_games
        each = (num_games, 1)
        self.observation_spec = Composite(
            observation=Bounded(-1.0, 1.0, shape=each), shape=(num_games,)
        )
        self.action_spec = Categorical(2, shape=(num_games,), dtype=torch.int64)
        self.reward_spec = Unbounded(each)
        flag = Binary(n=1, shape=each, dtype=torch.bool)
        names = ("done", "terminated", "truncated")
        self.full_done_spec = Composite({name: flag.clone() for name in names}, shape=(num_games,))
        self.place = torch.zeros(each)

    def _reset(self, tensordict: Any = None, **_: Any) -> TensorDict:
        begun = tensordict is not None and "_reset" in tensordict.keys()  # noqa: SIM118
        again = tensordict["_reset"] if begun else torch.ones(self.num_games, 1, dtype=torch.bool)
        self.place = torch.where(again, 0.0, self.place)
        return TensorDict({"observation": self.place}, batch_size=self.batch_size)

    def _step(self, tensordict: Any) -> TensorDict:
        self.place = (self.place + 0.2 * tensordict["action"][:, None] - 0.1).clamp(-1, 1)
        ended = self.place.abs() > 0.95
        content = {"observation": self.place, "reward": (self.place > 0.95).float()}
        flags = {"terminated": ended, "done": ended, "truncated": torch.zeros_like(ended)}
        return TensorDict({**content, **flags}, batch_size=self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        pass


class Point:
    """The player on the line."""

    features = Features("flat", (1,), np.ones(1))
    num_actions, members, continuous, has_masks = 2, 1, False, False
    observed = critic_features = None

    def policy(self, network: Any, greedy: bool = True) -> Any:
        return lambda place: network.logits(torch.tensor([[place]])).argmax(-1).item()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppo", "a2c", "dqn"])
def test_learners_learn_where_there_is_no_maze(name: str) -> None:
    torch.manual_seed(0)
    small = {"num_games": 32, "width": 16, "learning_rate": 1e-2}
    small |= {"minibatch_size": 128} if name == "ppo" else {}
    small |= {"batch_size": 64, "learning_starts": 100} if name == "dqn" else {}
    algorithm = entry(name)
    settings: Any = algorithm.settings(**small)  # type: ignore[arg-type]
    env = Line(32)
    learner = algorithm.build(settings, env, Build(seed=1))
    for step in range(60):
        learner.iterate(step / 60)
    policies = learner.policy(), algorithm.load(settings, env.player, learner.state_dict(), True)
    learner.close()
    for policy in policies:
        assert [policy(place / 10) for place in range(-5, 10)] == [1] * 15  # type: ignore[operator]
