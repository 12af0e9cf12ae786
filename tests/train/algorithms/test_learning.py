"""Learning: the TorchRL environment, the networks, advantages, PPO itself."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torchrl.envs.utils import check_env_specs
from torchrl.objectives import ClipPPOLoss
from torchrl_heads import ours

from pursuit.mazes.maze import Maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarChaser, AStarEvader, RandomAgent, TourRunner
from scripted_agents.environments import default_policies
from train.algorithms.advantages import advantages
from train.algorithms.ppo import PPO, ppo_loss
from train.algorithms.rollouts import TorchEngine
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.contest import GameContest
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.layers import Hidden, IndexLayer
from train.networks.policy import LearnedPolicy, MazeSeat
from train.runs.threads import ThreadChoice
from train.settings.algorithms import PPOSettings

TASKS = {
    "chaser": make_task("chase", maze="3x3", max_steps=12),
    "runner": make_task("maze", maze="3x3", num_goals=2, max_steps=12),
    "evader": make_task("chase", maze="4x4", num_chasers=2, num_evaders=2, max_steps=12),
}


def make_env(role: str, games: int = 32, encoding: str = "index", seed: int = 0) -> SimulatorEnv:
    task = TASKS[role]
    simulator = Simulator(task, games, seed, auto_restart=False)
    policies = default_policies(task, 0.5)
    seats = [policies[r] for r in task.seat_roles]
    seat = task.seat(role)
    filled = [None if s == seat else p for s, p in enumerate(seats)]
    return SimulatorEnv(simulator, MazeSeat(task, role, encoding), filled)


@pytest.mark.parametrize("role", TASKS)
@pytest.mark.parametrize("encoding", ["index", "one_hot", "planes", "positions"])
def test_the_environment_keeps_to_its_torchrl_specs(role: str, encoding: str) -> None:
    with torch.random.fork_rng():
        check_env_specs(make_env(role, 5, encoding), break_when_any_done="both")


@pytest.mark.parametrize("role", TASKS)
def test_the_fast_step_and_reset_equals_torchrls_own(role: str) -> None:
    fast, general = make_env(role), make_env(role)
    fast_now, general_now = fast.reset(), general.reset()
    generator = torch.Generator().manual_seed(0)
    ended = 0
    for _ in range(60):
        action = torch.randint(4, (32,), generator=generator)
        fast_step, fast_now = fast.step_and_maybe_reset(fast_now.set("action", action))
        general_step, general_now = super(SimulatorEnv, general).step_and_maybe_reset(
            general_now.set("action", action.clone())
        )
        for key in ("observation", "reward", "done", "terminated", "truncated"):
            assert torch.equal(fast_step["next", key], general_step["next", key]), key
        for key in ("observation", "done", "terminated", "truncated"):
            assert torch.equal(fast_now[key], general_now[key]), key
        ended += int(fast_step["next", "done"].sum())
    assert ended > 30
    assert len(np.concatenate(fast.finished_lengths)) == ended


def test_the_two_forms_of_the_first_layer_are_one_function_and_blind_to_the_order_of_goals() -> (
    None
):
    task = make_task("maze", maze="4x4", num_goals=3)
    simulator = Simulator(task, 64)
    features = MazeSeat(task, "runner").features
    torch.manual_seed(0)
    bag = IndexLayer(features, 16, "bag")
    dense = IndexLayer(features, 16, "dense")
    with torch.no_grad():  # what the last row holds is not looked at
        bag.weight[-1] = 1.0
    dense.load_state_dict(bag.state_dict())
    observed = torch.from_numpy(simulator.observe("index", 0))
    outputs, gradients = [], []
    for layer in (bag, dense):
        output = layer(layer.prepare(observed))
        output.square().sum().backward()
        outputs.append(output)
        with torch.no_grad():  # an absent goal names the last row, which is 0
            for seen in (observed, torch.from_numpy(features.high).expand_as(observed)):
                glanced = layer(layer.prepare(seen, learning=False))
                torch.testing.assert_close(glanced, layer(layer.prepare(seen)))
        assert layer.weight.grad is not None
        gradients.append(layer.weight.grad[: layer.num_rows])
    torch.testing.assert_close(outputs[0], outputs[1])
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-4, atol=1e-4)
    # Against the one-hot encoding and a matrix whose goal rows are tied.
    cells = task.max_cells
    tied = torch.cat(
        [bag.weight[:cells], *[bag.weight[cells : 2 * cells]] * 3, bag.weight[2 * cells : -1]]
    )
    one_hot = torch.from_numpy(simulator.observe("one_hot", 0))
    torch.testing.assert_close(outputs[0], one_hot @ tied + bag.bias)


def test_advantages_equal_a_plain_loop_and_never_cross_an_episode() -> None:
    env = make_env("runner", games=16)
    network = ActorCritic(env.player.features, 4, Hidden(16, activation="tanh"))
    settings = PPOSettings(
        num_games=16, rollout_steps=30, minibatch_size=64, gamma=0.9, gae_lambda=0.8
    )
    learner = PPO(settings, env, network, "cpu")
    assert isinstance(learner.engine, TorchEngine)
    collector = learner.engine.collector
    collector.keep_next = True
    rollout = collector.rollout()
    advantage, _ = advantages(rollout, 0.9, 0.8)
    assert rollout["terminated"].any() and rollout["truncated"].any()
    with torch.no_grad():
        values = network(rollout["observation"])[1].squeeze(-1).numpy()
        next_values = network(rollout["next_observation"])[1].squeeze(-1).numpy()
    rewards, ended, terminated = (rollout[key].numpy() for key in ("reward", "done", "terminated"))
    expected = np.zeros_like(values)
    for game in range(16):
        running = 0.0
        for step in reversed(range(30)):
            bootstrap = 0.0 if terminated[game, step] else next_values[game, step]
            delta = rewards[game, step] + 0.9 * bootstrap - values[game, step]
            running = delta + (0.0 if ended[game, step] else 0.9 * 0.8 * running)
            expected[game, step] = running
    np.testing.assert_allclose(advantage, expected, rtol=1e-4, atol=1e-5)
    learner.close()


@pytest.mark.parametrize("shared", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_the_loss_and_its_gradients_equal_torchrls(shared: bool) -> None:
    simulator = Simulator(TASKS["runner"], 256)
    torch.manual_seed(0)
    network = ActorCritic(MazeSeat(TASKS["runner"], "runner").features, 4, Hidden(16), shared)
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    prepared = network.policy_trunk.prepare(torch.from_numpy(simulator.observe("index", 0)))
    minibatch = TensorDict(
        {
            "prepared": prepared,
            "action": torch.randint(4, (256,)),
            "action_log_prob": torch.randn(256) * 0.3 - 1.4,
            "advantage": torch.randn(256, 1),
            "value_target": torch.randn(256, 1),
        },
        batch_size=[256],
    )
    found, parts = ppo_loss(network, ours(minibatch), LossCoefficients(0.2, 0.7, 0.03))
    gradients = torch.autograd.grad(found, list(network.parameters()))
    distribution = {"distribution_class": torch.distributions.Categorical}
    loss = ClipPPOLoss(
        ProbabilisticTensorDictSequential(
            TensorDictModule(network.policy_head, ["policy_hidden"], ["logits"]),
            ProbabilisticTensorDictModule(
                in_keys=["logits"], out_keys=["action"], return_log_prob=True, **distribution
            ),
        ),
        TensorDictModule(network.value_head, ["value_hidden"], ["state_value"]),
        clip_epsilon=0.2,
        entropy_coeff=0.03,
        critic_coeff=0.7,
        loss_critic_type="l2",
        normalize_advantage=True,
    )
    minibatch["policy_hidden"], minibatch["value_hidden"] = network.hidden(prepared)
    losses = loss(minibatch)
    theirs = losses["loss_objective"] + losses["loss_entropy"] + losses["loss_critic"]
    torch.testing.assert_close(found, theirs)
    assert 0.1 < parts["clip_fraction"] == losses["clip_fraction"]
    for a, b in zip(
        gradients, torch.autograd.grad(theirs, list(network.parameters())), strict=True
    ):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6)


def test_actions_are_drawn_from_the_softmax_of_its_logits() -> None:
    env = make_env("chaser", games=20_000)
    torch.manual_seed(1)
    network = ActorCritic(env.player.features, 4, Hidden(16))
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    env.simulator.place([0, 8])
    settings = PPOSettings(20_000, minibatch_size=64, rollout_steps=1)
    learner = PPO(settings, env, network, fused=False)
    assert isinstance(learner.engine, TorchEngine)
    env.reset()
    seen = torch.from_numpy(env.simulator.observe("index", 0))[:1].expand(20_000, -1)
    with torch.no_grad():
        drawn = learner.engine.act({"observation": seen})
        logits, value = network(seen)
    share = torch.bincount(drawn["action"], minlength=4) / 20_000
    torch.testing.assert_close(share, logits[0].softmax(-1), atol=0.015, rtol=0)
    log_probability = logits.log_softmax(-1).gather(1, drawn["action"][:, None]).squeeze(1)
    torch.testing.assert_close(drawn["action_log_prob"], log_probability)
    torch.testing.assert_close(drawn["value"], value.squeeze(-1))


def learn(
    task: Task, agent: str, frames: int, encoding: str = "index", **settings: float
) -> LearnedPolicy:
    """A short seeded run of PPO against scripted opponents."""
    torch.manual_seed(0)
    ppo = PPOSettings(num_games=128, rollout_steps=16, minibatch_size=512, **settings)  # type: ignore[arg-type]
    simulator = Simulator(task, ppo.num_games, 0, auto_restart=False)
    policies = default_policies(task, 0.2)
    seat = task.seat(agent)
    seats = [None if s == seat else policies[r] for s, r in enumerate(task.seat_roles)]
    player = MazeSeat(task, agent, encoding)
    network = ActorCritic(player.features, player.num_actions, Hidden(64), bool(ppo.shared))
    learner = PPO(ppo, SimulatorEnv(simulator, player, seats), network)
    while learner.frames < frames:
        learner.iterate(learner.frames / frames)
    learner.close()
    return player.policy(network)


@pytest.mark.parametrize("shared", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_chaser_learns_to_be_nearly_optimal_on_3x3(shared: bool) -> None:
    task = make_task("chase", maze="3x3")
    contest = GameContest(task, "chaser", default_policies(task, 0.2), 100)
    policy = learn(task, "chaser", 150_000, shared=shared)
    learned, random = contest.score("learned", policy), contest.score("random", RandomAgent())
    optimum = contest.optimal()
    assert optimum is not None and learned.exact
    assert optimum.mean_steps <= learned.mean_steps < 1.1 * optimum.mean_steps
    assert learned.mean_steps < 0.4 * random.mean_steps


def test_an_evader_learns_to_survive_longer_than_a_random_one() -> None:
    task = make_task("chase", maze="4x4")
    contest = GameContest(task, "evader", default_policies(task, 0.2), 100)
    policy = learn(task, "evader", 200_000)
    learned, random = contest.score("learned", policy), contest.score("random", RandomAgent())
    assert learned.mean_steps > 3 * random.mean_steps


@pytest.mark.parametrize("encoding", ["one_hot", pytest.param("planes", marks=pytest.mark.slow)])
def test_a_runner_learns_from_other_encodings(encoding: str) -> None:
    task = make_task("maze", maze="3x3", num_goals=2)
    contest = GameContest(task, "runner", {}, 500)
    policy = learn(task, "runner", 150_000, encoding)
    learned, random = contest.score("learned", policy), contest.score("random", RandomAgent())
    assert learned.mean_steps < 0.5 * random.mean_steps
    assert learned.success_rate > 0.9


def test_exact_evaluation_agrees_with_playing_many_games() -> None:
    task = make_task("chase", maze="4x4", max_steps=60)
    contest = GameContest(task, "chaser", {"evader": AStarEvader(0.3)}, 40_000)
    exact = contest.score("A*", AStarChaser(0.1))
    lengths, won = contest.play(AStarChaser(0.1))
    assert exact.exact and exact.ci95 == 0.0
    assert abs(lengths.mean() - exact.mean_steps) < 4 * lengths.std() / len(lengths) ** 0.5
    assert won.mean() == (lengths < 60).mean() + ((lengths == 60) & won).mean()
    assert 0.99 < exact.success_rate < 1.0
    share = exact.success_rate
    assert abs(won.mean() - share) < 4 * (share * (1.0 - share) / len(won)) ** 0.5


def test_the_optimum_of_truncated_episodes_has_the_interval_of_truncated_episodes() -> None:
    task = make_task("maze", maze="9x9", num_goals=5, max_steps=25)
    contest = GameContest(task, "runner", {})
    optimum, played = contest.optimal(), contest.score("shortest tours", TourRunner())
    assert optimum is not None and 0.0 < optimum.success_rate < 1.0
    assert optimum.mean_steps == played.mean_steps
    assert optimum.ci95 == pytest.approx(played.ci95)


def test_a_learned_policy_is_its_table_in_play() -> None:
    task = make_task("chase", maze="3x3")
    torch.manual_seed(3)
    player = MazeSeat(task, "evader")
    network = ActorCritic(player.features, 4, Hidden(16))
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    policy = LearnedPolicy(network, player, greedy=False)
    table = policy.action_probabilities(task.mazes[0])
    simulator = Simulator(task, 20_000)
    simulator.place([7, 2])
    drawn = policy.act(simulator.view("evader"))
    share = np.bincount(drawn, minlength=4) / len(drawn)
    np.testing.assert_allclose(share, table[2, 7], atol=0.015)
    greedy = LearnedPolicy(network, player)
    assert (greedy.act(simulator.view("evader")) == table[2, 7].argmax()).all()


def test_a_learned_policy_refuses_games_that_look_different() -> None:
    task = make_task("chase", maze="3x3")
    player = MazeSeat(task, "chaser")
    policy = LearnedPolicy(ActorCritic(player.features, 4, Hidden(16)), player)
    other = Simulator(make_task("chase", maze="3x3", num_evaders=2))
    with pytest.raises(ValueError, match="observations of shape"):
        policy.act(other.view("chaser"))
    with pytest.raises(ValueError, match="no table"):
        policy.action_probabilities(Maze.from_text("+-+-+\n|   |\n+-+-+"))


def test_the_choice_of_threads_follows_the_faster_one_as_the_machine_changes() -> None:
    before = torch.get_num_threads()
    choice = ThreadChoice(2)
    used: list[int] = []
    for rollout in range(200):
        choice.choose()
        used.append(torch.get_num_threads())
        fast = 2 if rollout < 100 else 1
        choice.learn(1.0 if choice.current == fast else 3.0)
    torch.set_num_threads(before)
    assert used[30:96].count(2) > 55 and used[140:].count(1) > 50
