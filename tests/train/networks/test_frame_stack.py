"""The last observations as one: in training games and in policies, against a plain list of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from pursuit import Simulator, make_task
from pursuit.simulator.policy import MemoryPolicy, TabularPolicy
from scripted_agents import AStarEvader
from train.environments.simulator_env import SimulatorEnv
from train.networks.actor_critic import ActorCritic
from train.networks.layers import Hidden, IndexLayer
from train.networks.policy import MazeSeat
from train.runs.parts import settings_of

TASK = make_task("chase", maze="3x3", max_steps=7)
ENCODINGS = ["index", "one_hot", "positions", "planes"]
COUNT = 3


def make_env(games: int, encoding: str, count: int = COUNT) -> SimulatorEnv:
    simulator = Simulator(TASK, games, 5, auto_restart=False)
    seat = MazeSeat(TASK, "chaser", encoding, frame_stack=count)
    return SimulatorEnv(simulator, seat, [None, AStarEvader(epsilon=0.5)])


def given(one: list[Any], encoding: str, features: Any) -> Any:
    """What the network is given of a game that has seen these observations, the newest last."""
    empty = len(features.rows) - 1 if encoding == "index" else 0
    lately = one[::-1][:COUNT]
    lately += [np.full_like(one[0], empty)] * (COUNT - len(lately))
    if encoding == "index":
        lately = [seen + number * len(features.rows) for number, seen in enumerate(lately)]
    return np.concatenate(lately)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_training_games_show_the_last_observations_of_the_episode(encoding: str) -> None:
    env, plain = make_env(10, encoding), make_env(10, encoding, 1)
    now, one = env.reset(), plain.reset()
    seen = [[each] for each in one["observation"].numpy()]
    ended = 0
    for _ in range(30):
        for game in range(10):
            expected = given(seen[game], encoding, plain.player.features)
            np.testing.assert_array_equal(now["observation"][game].numpy(), expected)
        assert env.observation_spec["observation"].is_in(now["observation"])
        action = torch.randint(4, (10,))
        stepped, now = env.step_and_maybe_reset(now.set("action", action))
        other, one = plain.step_and_maybe_reset(one.set("action", action))
        for game in range(10):
            seen[game].append(other["next", "observation"][game].numpy())
            expected = given(seen[game], encoding, plain.player.features)
            found = stepped["next", "observation"][game].numpy()
            np.testing.assert_array_equal(found, expected)
            if other["next", "done"][game]:
                seen[game], ended = [one["observation"][game].numpy()], ended + 1
    assert ended > 20


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_policy_is_given_what_its_network_learned_from(encoding: str) -> None:
    env = make_env(10, encoding)
    torch.manual_seed(0)
    network = ActorCritic(env.player.features, 4, Hidden(16))
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    policy = env.player.policy(network)
    assert isinstance(policy, MemoryPolicy) and not isinstance(policy, TabularPolicy)
    games = Simulator(TASK, 10, 5, auto_restart=False)
    now, actions = env.reset(), np.zeros((10, 2), dtype=np.int32)
    for _ in range(30):
        games.act([policy, env.policies[1]], actions)
        expected = network.logits(now["observation"]).argmax(-1)
        assert actions[:, 0].tolist() == expected.tolist()
        _, now = env.step_and_maybe_reset(now.set("action", expected))
        games.step(actions)
        games.reset(games=games.ended)


def test_no_two_observations_share_a_row_and_empty_ones_have_none() -> None:
    seat = MazeSeat(TASK, "chaser", frame_stack=COUNT)
    one, features = seat.seen, seat.features
    assert features.num_rows == COUNT * one.num_rows
    layer = IndexLayer(features, 4, "dense")
    empty = np.concatenate([np.full(one.shape, len(one.rows) * (n + 1) - 1) for n in range(COUNT)])
    assert not layer.prepare(torch.from_numpy(empty)).any()
    numbers = np.arange(len(features.rows))
    named = features.rows[numbers % len(one.rows) != len(one.rows) - 1]
    assert sorted(set(named[named < features.num_rows])) == list(range(features.num_rows))


def test_unsupported_frame_stacks_are_refused() -> None:
    flat: dict[str, Any] = {"frames": 1000, "maze": "3x3"}
    with pytest.raises(ValueError, match="q_learning has a table over states"):
        settings_of(algorithm="q_learning", frame_stack=2, **flat)
    with pytest.raises(ValueError, match="frame_stack=0; give 1"):
        settings_of(frame_stack=0, **flat)
    with pytest.raises(ValueError, match="frame_stack=2 is not supported for an arm"):
        settings_of(task="reacher", frame_stack=2, frames=1000)
