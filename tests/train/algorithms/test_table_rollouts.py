"""Rollouts by tables against the simulator, stepped one by one, and against the network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pursuit.observations.masks import ACTION_MASK
from scripted_agents.games import GameSimulator, GameTask, load_game
from scripted_agents.games.simulator import OpponentTables
from train.algorithms.collector import Collector
from train.algorithms.table_rollouts import TableCollector
from train.kinds import start
from train.runs.folder import SELF_PLAY
from train.self_play.parts import self_play_settings_of

GAMES = ("soccer(rows=2,columns=4)", "goofspiel(cards=3)", "border_control(rows=2,columns=3)")
STEPS, COUNT = 13, 40


def random_sums(rng: np.random.Generator, legal: np.ndarray[Any, Any], members: int) -> Any:
    """[members, states, actions] sums of random probabilities of the legal actions."""
    chances = rng.random((members, *legal.shape)) ** 3 * legal
    return (chances / chances.sum(axis=2, keepdims=True)).cumsum(axis=2)


@pytest.mark.parametrize("name", GAMES)
@pytest.mark.parametrize("seat", [0, 1])
def test_games_that_are_played_by_tables_are_those_of_the_simulator(name: str, seat: int) -> None:
    task = GameTask(load_game(name), name, 9)
    rng, other = np.random.default_rng(0), 1 - seat
    own = random_sums(rng, task.legal(seat), 1)[0]
    theirs = random_sums(rng, task.legal(other), 3)
    shares, draws = np.array([0.2, 0.5, 0.3]), rng.random((2, STEPS, COUNT))
    members = rng.integers(3, size=COUNT)
    tables = OpponentTables(theirs, members.copy(), shares)
    played = GameSimulator(task, COUNT, 5, auto_restart=False).play(
        (seat, other), draws, own, tables
    )
    again = GameSimulator(task, COUNT, 5, auto_restart=False)
    games, last = np.arange(COUNT), own.shape[1] - 1
    for step in range(STEPS):
        state = again.state.copy()
        assert (played.state[step] == state).all()
        drawn = draws[0, step][:, None] * own[state][:, -1:]
        action = np.minimum((drawn >= own[state]).sum(axis=1), last)
        assert (played.action[step] == action).all()
        sums = theirs[members, state]
        number = again.view(other).uniform()[:, None] * sums[:, -1:]
        reply = np.minimum((number >= sums).sum(axis=1), sums.shape[1] - 1)
        actions = np.empty((COUNT, 2), dtype=np.int32)
        actions[games, seat], actions[games, other] = action, reply
        again.step(actions)
        assert (played.reward[step] == again.rewards[:, seat]).all()
        assert (played.terminated[step] == again.terminated).all()
        assert (played.truncated[step] == again.truncated).all()
        assert (played.final[step] == again.state).all()
        ended = again.ended
        assert (played.returns[step][ended] == again.returns[ended]).all()
        assert (played.lengths[step][ended] == again.steps[ended]).all()
        assert (played.members[step][ended] == members[ended]).all()
        again.reset(games=ended)
        new = (draws[1, step][:, None] * shares.sum() >= shares.cumsum()).sum(axis=1)
        members = np.where(ended, np.minimum(new, 2), members)
    assert played.terminated.any() and (played.truncated.any() or name.startswith("goofspiel"))
    assert (tables.members == members).all()


def side_of(folder: Path, **settings: Any) -> Any:
    """A side of a run of self-play that has learned for some iterations."""
    chosen = {"num_games": 64, "minibatch_size": 256, "frames": 8000, "width": 8, **settings}
    run = start(SELF_PLAY, self_play_settings_of(**chosen), folder)
    run.train(lambda run, row: None)
    return next(iter(run.trainee.sides.values()))


@pytest.mark.parametrize("name", GAMES)
@pytest.mark.parametrize("algorithm", ["ppo", "mmd"])
def test_columns_are_those_of_the_network(tmp_path: Path, name: str, algorithm: str) -> None:
    side = side_of(tmp_path / "run", game=name, algorithm=algorithm, episode_steps=3, gamma=0.9)
    learner, env = side.learner, side.env
    collector = learner.engine.collector if algorithm == "mmd" else None
    if collector is None:  # that of the fused engine is another one
        from train.algorithms.rollouts import TorchEngine

        engine = TorchEngine(env, learner.network, 16, "cpu", learner.loss)
        engine.collector._now = {}
        collector = engine.collector
    assert isinstance(collector, TableCollector)
    before, ended = collector.episode_start.clone(), len(env.finished_lengths)
    columns = collector.rollout()
    seen, masks = columns["observation"].flatten(0, 1), columns.get(ACTION_MASK)
    output, value = learner.network(seen)
    allowed = None if masks is None else masks.flatten(0, 1)
    distribution = learner.network.distribution(output, allowed)
    logs = distribution.log_prob(columns["action"].flatten())
    assert torch.allclose(columns["action_log_prob"].flatten(), logs, atol=1e-5)
    assert torch.allclose(columns["value"].flatten(), value.squeeze(-1), atol=1e-5)
    assert (columns["episode_start"][:, 0] == before).all()
    assert (columns["episode_start"][:, 1:] == columns["done"][:, :-1]).all()
    assert (columns["done"] == (columns["terminated"] | columns["truncated"])).all()
    over = int(columns["done"].sum())
    assert sum(map(len, env.finished_lengths[ended:])) == over > 0
    # A value is needed after truncations, and after the last step unless the game has ended.
    needed = columns["truncated"].clone()
    needed[:, -1] = ~columns["terminated"][:, -1]
    assert (columns["value_after"][~needed] == 0.0).all()
    last = needed[:, -1] & ~columns["truncated"][:, -1]
    following = learner.network(env._observe()["observation"])[1].squeeze(-1)
    assert torch.allclose(columns["value_after"][:, -1][last], following[last], atol=1e-5)
    if algorithm == "mmd":
        kept = columns["distribution"].flatten(0, 1)
        assert torch.allclose(kept, distribution.parameters, atol=1e-5)


def test_opponents_without_a_table_play_step_by_step(tmp_path: Path) -> None:
    name = GAMES[0]
    side = side_of(
        tmp_path / "run", game=name, algorithm="mmd", sampling="uniform", members=("uniform",)
    )
    assert side.env.hook.opponent_tables() is None
    collector = side.learner.engine.collector
    columns = collector.rollout()
    assert columns.keys() >= {"observation", "action", "value_after", "distribution"}
    assert isinstance(collector, Collector)


def test_every_opponent_of_a_pool_is_met_and_noted(tmp_path: Path) -> None:
    side = side_of(
        tmp_path / "run", game=GAMES[0], algorithm="mmd", sampling="uniform", snapshots=3,
        episode_steps=4,
    )  # fmt: skip
    (policy,) = side.env.hook.policies.values()
    members = policy.pool.members
    assert len(members) == 4
    before = [member.games for member in members]
    columns = side.learner.engine.collector.rollout()
    met = [member.games - games for member, games in zip(members, before, strict=True)]
    assert sum(met) == int(columns["done"].sum()) and min(met) > 0
