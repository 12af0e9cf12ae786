"""IPPO, MAPPO and VDN: networks of a team, the central critic, and the loss of summed values."""

from __future__ import annotations

import math
from itertools import cycle, product
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import train
from pursuit import Simulator, chase_v0
from pursuit.observations.observations import Encoder
from pursuit.tasks.task import make_task
from scripted_agents import evaluate_joint
from train.algorithms.ppo import ppo_loss
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.matchups import play_pair
from train.kinds import resume, start
from train.networks.joint_policy import JointPolicy, member_actions
from train.networks.policy import CRITIC, MazeSeat
from train.networks.separate import SeparateNetworks
from train.runs.folder import load_checkpoint
from train.runs.parts import Parts
from train.runs.parts import parts_of as parts_of_run
from train.self_play.parts import self_play_settings_of

TEAM: dict[str, Any] = {"num_chasers": 3, "num_evaders": 2, "maze": "3x3", "max_steps": 12}
pytestmark = pytest.mark.filterwarnings("ignore:frames=")
SMALL = {"num_games": 24, "width": 16, "frames": 600}
SIZES: dict[str, dict[str, Any]] = {
    "ippo": {"minibatch_size": 64, "rollout_steps": 8},
    "mappo": {"minibatch_size": 64, "rollout_steps": 8},
    "vdn": {"batch_size": 16, "learning_starts": 32, "rollout_steps": 4},
}
SHARING = ("shared", "separate", "joint")
SIZES["iql"] = SIZES["vdn"]
SIZES["qmix"] = SIZES["vdn"] | {"mixing_width": 8}


def parts(name: str, **given: Any) -> Parts:
    return parts_of_run(train.settings_of(**settings(name, **given)))


def settings(name: str, **given: Any) -> dict[str, Any]:
    return {"algorithm": name, **TEAM, **SMALL, **SIZES[name], "threads": 1, **given}


def learner_of(made: Parts) -> tuple[Any, SimulatorEnv]:
    torch.manual_seed(0)
    env: Any = made.games()[0]
    return made.algorithm.build(made.hyper, env, made.build), env


# -- what a team observes --------------------------------------------------------------------------


@pytest.mark.parametrize("role", ["chaser", "evader"])
@pytest.mark.parametrize("encoding", ["index", "one_hot", "positions", "planes", "window:1"])
def test_an_observation_ends_with_the_number_of_the_agent(encoding: str, role: str) -> None:
    task = make_task("chase", **TEAM)
    games = Simulator(task, 5).games
    plain, whole = Encoder(task, encoding), Encoder(task, f"{encoding}+id")
    seen, before = whole.encode(games), plain.encode(games)
    assert whole.space.contains(seen[0, 0]) and seen.dtype == before.dtype
    np.testing.assert_array_equal(seen[:, :, : before.shape[2]], before)
    numbers = [0, 1, 2, 0, 1]  # three chasers, two evaders
    ids = seen[:, :, before.shape[2] :]
    if encoding == "index":
        np.testing.assert_array_equal(ids[:, :, 0] - plain.space.high[0] - 1, [numbers] * 5)
    else:
        flat = ids.reshape(5, 5, 3, -1)
        np.testing.assert_array_equal(flat, np.eye(3)[[numbers] * 5][..., None] + 0 * flat)


def test_an_observation_without_place_for_the_number_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'cells\+id' has no place for the number .* \+id out"):
        train.settings_of(**settings("ippo", observation="cells"))
    assert train.settings_of(**settings("ippo", observation="cells", agent_id=False))


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_the_critic_observes_the_state_that_policies_do_not_see(role: str) -> None:
    """Its rows are those of the cells of `state()` of the PettingZoo environment."""
    own = {**TEAM, "view_radius": 1}
    seat = MazeSeat(make_task("chase", **own), role, "index+id", team=True, critic="state")
    env: Any = chase_v0.parallel_env(**own)
    env.reset(seed=3)
    features, cells = seat.critic_features, seat.task.max_cells
    assert features is not None
    order = [0, 1, 2, 3, 4] if role == "chaser" else [3, 4, 0, 1, 2]
    captured = False
    for step in range(40):
        if not env.agents:
            env.reset(seed=step)
        places = env.state()[:5].astype(int)[order]
        captured |= bool((places == 0).any())
        for member, seen in enumerate(seat.critic_observations(env.unwrapped.simulator)[0]):
            rows = features.rows[seen]
            shown = {e * cells + place - 1 for e, place in enumerate(places) if place > 0}
            ids = features.num_rows - 3 + member  # k is the number of the three chasers
            assert {int(row) for row in rows if row < features.num_rows} == shown | {ids}
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert captured


# -- networks --------------------------------------------------------------------------------------


@pytest.mark.parametrize("recurrent", [None, "gru"])
@pytest.mark.parametrize("algorithm", ["ippo", "mappo"])
def test_separate_networks_learn_from_the_frames_of_their_own_agent(
    algorithm: str, recurrent: str | None
) -> None:
    """Outputs and gradients are those of each network alone on the frames of its agent."""
    made = parts(algorithm, sharing="separate", recurrent=recurrent, observation="window:1")
    learner, env = learner_of(made)
    network: SeparateNetworks = learner.network
    frames = learner.collect()
    owner = network.owner(frames["prepared"])
    assert owner.unique().tolist() == [0, 1, 2]
    coefficients = learner.coefficients(0.0)._replace(standardize=False)
    learner.engine.set_gradients(frames, coefficients)
    together = [weight.grad.clone() for weight in network.parameters()]
    total = torch.zeros(())
    for number, own in enumerate(network.networks):
        rows = (owner.reshape(len(owner), -1)[:, 0] == number).nonzero().squeeze(-1)
        part = {name: column[rows] for name, column in frames.items()}
        part["prepared"] = own.policy_trunk.prepare(part["prepared"])
        if env.player.critic:
            part["critic_prepared"] = own.value_trunk.prepare(part["critic_prepared"])
        learner.engine.network = own
        loss, _ = ppo_loss(own, part, coefficients)
        total = total + loss * len(rows) / len(owner)
    learner.optimizer.zero_grad()
    total.backward()
    alone = [weight.grad for weight in network.parameters()]
    for one, two in zip(together, alone, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("observation", ["index", "planes"])
def test_separate_networks_take_frames_that_lack_an_agent(observation: str) -> None:
    """As the final observations of a few games do."""
    learner, env = learner_of(parts("ippo", sharing="separate", observation=observation))
    network: SeparateNetworks = learner.network
    seen: Any = env.reset()
    part = seen["observation"][network.owner(seen["observation"]) != 1]
    with torch.no_grad():
        logits, values = network(part)
        for number in (0, 2):
            rows = network.owner(part) == number
            expected, value = network.networks[number](part[rows])
            torch.testing.assert_close(logits[rows], expected)
            torch.testing.assert_close(values[rows], value)


def test_a_value_is_of_the_state_and_a_policy_of_the_own_observation() -> None:
    learner, env = learner_of(parts("mappo", view_radius=1))
    seen: Any = env.reset()
    seen = {name: seen[name] for name in ("observation", CRITIC)}
    other = {**seen, CRITIC: seen[CRITIC].roll(3, 0)}
    with torch.no_grad():
        logits, values = learner.network(seen["observation"], seen[CRITIC])
        same, changed = learner.network(other["observation"], other[CRITIC])
    assert torch.equal(logits, same) and not torch.allclose(values, changed)
    torch.testing.assert_close(values.roll(3, 0)[3:], changed[3:])  # of the state alone


@pytest.mark.parametrize(("algorithm", "sharing"), [("ippo", "shared"), ("mappo", "separate")])
def test_agents_that_have_left_change_no_gradient(algorithm: str, sharing: str) -> None:
    """With a GRU, sequences contain the frames of captured evaders."""
    given = {"role": "evader", "num_evaders": 3, "recurrent": "gru", "sharing": sharing}
    learner, _ = learner_of(parts(algorithm, **given))
    frames = learner.collect()
    idle = ~frames["loss_mask"]
    assert idle.any() and not idle.all()
    coefficients = learner.coefficients(0.0)
    learner.engine.set_gradients(frames, coefficients)
    before = [weight.grad.clone() for weight in learner.network.parameters()]
    for name in ("advantage", "value_target", "action_log_prob"):
        frames[name] = frames[name].masked_fill(idle, math.nan)
    figures = learner.engine.set_gradients(frames, coefficients)
    assert all(value.isfinite() for value in figures.values())
    for old, weight in zip(before, learner.network.parameters(), strict=True):
        assert torch.equal(old, weight.grad)
    for _ in range(6):
        assert all(map(math.isfinite, learner.iterate(0.5).values()))


# -- the team as one player ------------------------------------------------------------------------


def test_joint_actions_are_the_actions_of_all_agents() -> None:
    task = make_task("chase", **TEAM)
    every = list(product(range(task.num_actions), repeat=3))
    np.testing.assert_array_equal(member_actions(np.arange(len(every)), task, "chaser"), every)
    made = parts("ippo", sharing="joint")
    env: Any = made.games()[0]
    twin = Simulator(task, env.num_games, made.build.seed, auto_restart=False)
    assert env.num_games == 24 and env.player.num_actions == 4**3
    env.reset()
    actions, others = torch.randint(64, (24,)), [None] * 3 + [made.world.opponents["evader"]] * 2
    whole = np.zeros((24, 5), dtype=np.int32)
    twin.act(others, whole)
    whole[:, :3] = member_actions(actions.numpy(), task, "chaser")
    twin.step(whole)
    after = env.step_tensors(actions)[0]
    mean = twin.rewards[:, :3].mean(axis=1)
    np.testing.assert_allclose(after["reward"][:, 0].numpy(), mean, rtol=1e-6)


def test_the_joint_policy_is_evaluated_as_it_plays() -> None:
    """The exact expectation of correlated actions is the mean of simulated episodes; that of the
    agents' own distributions, drawn independently, is another."""
    made = parts("ippo", sharing="joint", num_chasers=2, num_evaders=1, stay_action=True)
    learner, _ = learner_of(made)
    with torch.no_grad():  # one agent goes up and the other one down, or the other way round
        learner.network.policy_head.weight.zero_()
        learner.network.policy_head.bias.fill_(-50.0)
        learner.network.policy_head.bias[[1, 5]] = 0.0
    policy: Any = learner.policy(greedy=False)
    assert isinstance(policy, JointPolicy)
    task, evader = made.world.task, made.world.opponents["evader"]
    exact = evaluate_joint(task, {"chaser": policy, "evader": evader}, task.max_steps)
    lengths, _ = play_pair(task, policy, evader, 20_000)
    half = 4.0 * lengths.std() / math.sqrt(len(lengths))
    assert abs(lengths.mean() - exact.length) < half

    class Independent:
        distribution = staticmethod(policy.distribution)
        act = staticmethod(policy.act)

    alone = evaluate_joint(task, {"chaser": Independent(), "evader": evader}, task.max_steps)
    assert abs(alone.length - exact.length) > half


def test_two_joint_policies_draw_independently_of_each_other() -> None:
    """The actions of teammates are opposite; those of opponents are equal in half of the games."""
    policies: dict[str, Any] = {}
    for role in ("chaser", "evader"):
        given = {"num_chasers": 2, "num_evaders": 2, "stay_action": True, "role": role}
        made = parts("ippo", sharing="joint", **given)
        learner, _ = learner_of(made)
        with torch.no_grad():  # one agent goes up and the other one down, or the other way round
            learner.network.policy_head.weight.zero_()
            learner.network.policy_head.bias.fill_(-50.0)
            learner.network.policy_head.bias[[1, 5]] = 0.0
        policies[role] = learner.policy(greedy=False)
    simulator = Simulator(made.world.task, 4096)
    actions = np.zeros((4096, 4), dtype=np.int32)
    simulator.act([policies[role] for role in made.world.task.seat_roles], actions)
    np.testing.assert_array_equal(actions[:, 0] + actions[:, 1], 1)
    np.testing.assert_array_equal(actions[:, 2] + actions[:, 3], 1)
    assert abs((actions[:, 0] == actions[:, 2]).mean() - 0.5) < 4.0 * 0.5 / 64.0


# -- values of a team ------------------------------------------------------------------------------


def test_the_loss_of_vdn_is_that_of_the_sum_of_the_values() -> None:
    """Computed one row and agent at a time, with agents that have left."""
    learner, _ = learner_of(parts("vdn", role="evader", num_evaders=3, n_steps=2, double=True))
    for _ in range(12):
        learner.store(learner.collector.rollout())
    batch = {name: rows[::7] for name, rows in learner.replay.columns().items()}
    idle, left = batch["idle"], batch["next_idle"] & ~batch["terminated"][:, None]
    assert idle.any() and left.any() and (batch["steps"] == 2).any()
    with torch.no_grad():
        for weight in learner.target.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    gamma = learner.settings.gamma
    loss, _ = learner.loss(batch)
    errors = []
    with torch.no_grad():
        for row in range(len(idle)):
            value = following = 0.0
            for agent in range(3):
                seen, after = (batch[n][row, agent] for n in ("observation", "next_observation"))
                if not idle[row, agent]:
                    value += float(learner.network(seen[None])[0, batch["action"][row, agent]])
                if not batch["next_idle"][row, agent]:
                    best = learner.network(after[None])[0].argmax()
                    following += float(learner.target(after[None])[0, best])
            if batch["terminated"][row]:
                following = 0.0
            goal = float(batch["reward"][row]) + gamma ** int(batch["steps"][row]) * following
            errors.append((value - goal) ** 2)
    np.testing.assert_allclose(float(loss.detach()), np.mean(errors), rtol=1e-3)


def test_qmix_mixes_values_monotonically_by_the_state() -> None:
    """The value of a joint action grows with that of each agent, with slopes that depend on the
    state; agents that have left count 0."""
    learner, env = learner_of(parts("qmix"))
    mixer = learner.network.mixer
    state = env.reset()[CRITIC].unflatten(0, (-1, 3))[:, 0]
    values = torch.randn(len(state), 3, requires_grad=True)
    (slopes,) = torch.autograd.grad(mixer(values, state).sum(), values)
    assert (slopes >= 0.0).all() and slopes.std(dim=0).min() > 1e-4
    for _ in range(8):
        assert all(map(math.isfinite, learner.iterate(0.5).values()))
    assert not torch.equal(mixer.offset.weight, torch.zeros_like(mixer.offset.weight))
    batch = {name: rows[:40] for name, rows in learner.replay.columns().items()}
    left = {**batch, "idle": torch.ones_like(batch["idle"])}
    left["next_idle"] = torch.ones_like(batch["idle"])
    learner.target.load_state_dict(learner.network.state_dict())
    gamma = learner.settings.gamma
    loss, _ = learner.loss(left)
    none = torch.zeros(40, 3)
    following = mixer(none, batch["next_critic_observation"]) * ~batch["terminated"]
    goal = batch["reward"] + gamma ** batch["steps"] * following
    torch.testing.assert_close(loss, (mixer(none, batch[CRITIC]) - goal).square().mean())


def test_rows_of_vdn_are_steps_of_whole_games() -> None:
    learner, env = learner_of(parts("vdn", role="evader", num_evaders=3, n_steps=1))
    for _ in range(6):
        rollout = learner.collector.rollout()
        learner.store(rollout)
    rows = learner.replay.columns()
    steps = learner.settings.rollout_steps
    last = {name: rows[name][-env.num_games * steps :] for name in rows}
    reward = rollout["reward"].view(env.num_games, 3, steps)
    ended = rollout["done"].view(env.num_games, 3, steps)
    for game, step in product(range(env.num_games), range(steps)):
        row = game * steps + step
        for agent in range(3):
            frame = rollout["observation"][game * 3 + agent, step]
            assert torch.equal(last["observation"][row, agent], frame)
            assert last["action"][row, agent] == rollout["action"][game * 3 + agent, step]
        torch.testing.assert_close(last["reward"][row], reward[game, :, step].mean())
        if last["terminated"][row]:
            assert ended[game, :, step].all()
    assert learner.frames == 6 * rollout["reward"].numel()


def test_rows_of_iql_are_steps_of_single_agents_in_their_games() -> None:
    """Written one agent and step at a time: the returns are of its own rewards, and end when it
    leaves; its frames after that are in no row."""
    learner, env = learner_of(parts("iql", role="evader", num_evaders=3, n_steps=2))
    gamma, rewards, skipped = learner.settings.gamma, set(), 0
    for _ in range(12):
        rollout = learner.collector.rollout()
        before = learner.replay.cursor
        learner.store(rollout)
        rows = learner.replay.columns()
        row, (agents, steps) = before, rollout["reward"].shape
        for agent, step in product(range(agents), range(steps)):
            if rollout["idle"][agent, step]:
                skipped += 1
                continue
            reward, last = rollout["reward"][agent, step], step
            if step + 1 < steps and not rollout["done"][agent, step]:
                last, reward = step + 1, reward + gamma * rollout["reward"][agent, step + 1]
            torch.testing.assert_close(rows["reward"][row], reward)
            assert torch.equal(rows["observation"][row], rollout["observation"][agent, step])
            assert rows["action"][row] == rollout["action"][agent, step]
            assert rows["terminated"][row] == rollout["terminated"][agent, last]
            after = rollout["next_observation"][agent, last]
            assert torch.equal(rows["next_observation"][row], after)
            rewards.add(float(reward))
            row += 1
        assert row == learner.replay.cursor
    assert skipped and len(rewards) > 2 and learner.frames == 12 * env.rows * steps


@pytest.mark.parametrize("algorithm", ["iql", "vdn"])
def test_iql_and_vdn_of_one_agent_are_dqn(algorithm: str) -> None:
    alone = {"num_chasers": 1, "num_evaders": 1}
    weights = []
    for name in (algorithm, "dqn"):
        given = settings("vdn", **alone) | {"algorithm": name}
        learner, _ = learner_of(parts_of_run(train.settings_of(**given)))
        for _ in range(6):
            learner.iterate(0.2)
        weights.append(list(learner.network.parameters()))
    assert all(torch.equal(one, two) for one, two in zip(*weights, strict=True))


# -- runs ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("algorithm", "sharing"), zip(SIZES, cycle(SHARING)))
def test_a_resumed_run_of_a_team_ends_equal_to_an_uninterrupted_one(
    algorithm: str, sharing: str, tmp_path: Path
) -> None:
    given = settings(algorithm, sharing=sharing, num_chasers=2, num_evaders=1, maze="2x2")
    whole = start("single", train.settings_of(**given), tmp_path / "whole")
    whole.train()
    half = start("single", train.settings_of(**given), tmp_path / "half")

    def stop(run: Any, row: dict[str, float]) -> None:
        run.stopped = run.stopped or run.progress > 0.4

    half.train(stop)
    resume(tmp_path / "half", "single").train()
    one, two = (load_checkpoint(tmp_path / name)["trainee"] for name in ("whole", "half"))
    for name, weight in one["learner"]["network"].items():
        assert torch.equal(weight, two["learner"]["network"][name]), name
    policy: Any = train.load_policy(tmp_path / "half")
    games = Simulator(policy.task, 8).games
    mean = whole.trainee.learner.policy().distribution(policy.task, games, 1)
    np.testing.assert_array_equal(policy.distribution(policy.task, games, 1), mean)


@pytest.mark.parametrize(("algorithm", "sharing"), zip(SIZES, cycle(SHARING[::-1])))
def test_teams_learn_in_self_play(algorithm: str, sharing: str, tmp_path: Path) -> None:
    given = settings(algorithm) | {
        "sharing": sharing,
        "num_evaders": 1,
        "num_chasers": 2,
        "evader": "astar",
    }
    run = start("self-play", self_play_settings_of(**given, snapshots=2), tmp_path / "run")
    run.train()
    loaded: Any = train.load_policy(tmp_path / "run" / "chaser")
    assert loaded.seat.team and loaded.seat.joint == (sharing == "joint")
    row = run.trainee.evaluate()
    assert math.isfinite(row["nash_conv"]) and row["steps"] > 1.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"role": "chaser_1"},
            "role='chaser_1', but ippo trains all agents of a role; give chaser",
        ),
        (
            {"sharing": "separate", "frame_stack": 2},
            "does not support frame_stack=2",
        ),
        (
            {"sharing": "joint", "view_radius": 2},
            "does not support views that are limited",
        ),
        ({"sharing": "joint", "recurrent": "gru"}, "sharing='joint' does not support memory"),
        (
            {"sharing": "joint", "mask_bumps": True},
            "does not support masked actions",
        ),
        ({"sharing": "joint", "num_chasers": 7}, "16,384 joint actions; at most 4,096"),
        ({"sharing": "all"}, "unknown sharing 'all'; one of shared, separate, joint"),
        (
            {"algorithm": "qplex"},
            "unknown algorithm 'qplex'; .*iql, vdn, qmix",
        ),
        (
            {"algorithm": "maddpg"},
            "unknown algorithm 'maddpg' .*; one of ppo, .*, vdn, qmix",
        ),
        (
            {"algorithm": "mappo", "critic_observation": "sky"},
            "critic_observation: unknown observation 'sky'; .*; or state",
        ),
        ({"algorithm": "mappo", "critic": False}, "critic=False with a central critic; use"),
    ],
)
def test_what_cannot_learn_as_a_team_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        train.settings_of(**settings("ippo", **given))


class OwnCell:
    """Shows the number of the agent's own cell, and nothing else."""

    def space(self, task: Any) -> gymnasium.spaces.Box:
        return gymnasium.spaces.Box(0, task.max_cells, (1,), np.int32)

    def encode(self, task: Any, games: Any, seats: Any) -> Any:
        return games.positions[:, seats, None]


def test_a_critic_may_observe_what_a_user_observation_hides() -> None:
    learner, env = learner_of(parts("mappo", observation=f"{__name__}:OwnCell"))
    shapes = {name: tuple(seen.shape) for name, seen in env.reset().items()}
    assert shapes["observation"] == (24, 1 + 3) and shapes[CRITIC] == (24, 5 + 1 + 1)
    assert all(map(math.isfinite, learner.iterate(0.0).values()))
