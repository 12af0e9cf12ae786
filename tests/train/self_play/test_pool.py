"""Opponent pools: their members, and opponent sampling."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from self_play_runs import Always, empty_pool

from pursuit.mazes.maze import load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents import (
    AStarEvader,
    RandomAgent,
)
from train.networks.actor_critic import ActorCritic
from train.networks.layers import Hidden
from train.networks.policy import LearnedPolicy, MazeSeat
from train.self_play.meta_game import Payoffs
from train.self_play.pool import OpponentPool, PoolPolicy, weights
from train.settings.self_play import OPPOSING_ROLES

# -- the pool --------------------------------------------------------------------------------------


def test_every_game_meets_its_own_opponent(tmp_path: Path) -> None:
    pool = empty_pool(tmp_path)
    for action in (1, 2, 3):
        pool.add(str(action), {"action": action}, np.random.default_rng(0))
    policy = PoolPolicy(pool, 1000)
    policy.opponents[:] = np.random.default_rng(0).integers(4, size=1000)
    simulator = Simulator(make_task("chase"), 1000)
    actions = policy.act(simulator.view("evader"))
    assert (actions == policy.opponents).all()
    counts = np.bincount(policy.opponents)
    assert [member.policy.asked for member in pool.members] == counts.tolist()  # type: ignore[attr-defined]


def test_scripted_opponents_draw_from_their_games_own_streams(tmp_path: Path) -> None:
    """A game against a scripted member goes on as if that member alone were there."""
    pool = OpponentPool(tmp_path, AStarEvader(0.5), 3, lambda state: Always(0))
    pool.add_scripted("random", RandomAgent())
    policy = PoolPolicy(pool, 64)
    policy.opponents[::2] = 1
    simulator = Simulator(make_task("chase"), 64)
    first, second = (policy.act(simulator.view("evader")) for _ in range(2))
    assert (first != second).any()  # the streams have moved on
    moves = np.take_along_axis(
        load_maze("5x5").neighbors[simulator.positions[:, 1]], first[:, None], axis=1
    )[:, 0]
    assert (moves != simulator.positions[:, 1])[::2].all()  # random agents always move


def test_in_a_duel_networks_play_by_tables_that_follow_them(tmp_path: Path) -> None:
    """From the same streams come the actions of the networks themselves, also when one learns."""
    torch.manual_seed(0)
    task = make_task("chase", maze="3x3", stay_action=True)
    seat = MazeSeat(task, "evader")
    networks = [ActorCritic(seat.features, 5, Hidden(16), True) for _ in range(3)]
    for network in networks:
        torch.nn.init.normal_(network.policy_head.weight)  # far from uniform
    members = [LearnedPolicy(network, seat, greedy=False) for network in networks]
    pool = OpponentPool(tmp_path, members[0], 3, lambda state: members[state["number"]])
    pool.add_scripted("astar", AStarEvader(0.3))
    for number in (1, 2):
        pool.add(f"{number}", {"number": number}, np.random.default_rng(0))
    tables, asked = PoolPolicy(pool, 512, steps=16), PoolPolicy(pool, 512, steps=16)
    asked.tables.places = lambda policies, task: np.full(len(policies), -1)  # type: ignore[method-assign]
    tables.opponents[:] = asked.opponents[:] = np.random.default_rng(1).integers(4, size=512)
    simulator = Simulator(task, 512, seed=3)
    optimizer = torch.optim.Adam(networks[0].parameters(), lr=0.3)
    played: list[Any] = []
    for step in range(6):
        if step == 3:
            before = tables.tables.cumulative.copy()
            networks[0].policy_head(torch.randn(4, 16)).square().sum().backward()
            optimizer.step()
        if step == 5:  # a single opponent, not scripted
            tables.opponents[:] = asked.opponents[:] = 0
        copy = deepcopy(simulator)
        found = tables.act(simulator.view("evader"))
        assert (found == asked.act(copy.view("evader"))).all()
        assert np.array_equal(simulator.streams, copy.streams)
        played.append(found)
        actions = np.stack([found * 0, found], axis=1)
        simulator.step(actions)
    changed = (before != tables.tables.cumulative).any(axis=(1, 2))
    assert changed.tolist() == [True, False, False]
    pool.members.pop(2)  # a snapshot is dropped: the others keep their tables
    tables.opponents[:] = asked.opponents[:] = np.arange(512) % 3
    copy = deepcopy(simulator)
    assert (tables.act(simulator.view("evader")) == asked.act(copy.view("evader"))).all()


def test_pools_are_bounded_and_survive_damage(tmp_path: Path) -> None:
    pool, rng = empty_pool(tmp_path), np.random.default_rng(0)
    pool.add_scripted("astar", AStarEvader())
    dropped = [pool.add(f"{n}", {"action": n % 4}, rng) for n in range(10)]
    assert len(pool.snapshots) == 3 and pool.offered == 10
    assert sum(name is not None for name in dropped) == 7
    pool.clean()
    assert sorted(path.stem for path in tmp_path.glob("*.pt")) == sorted(
        member.name for member in pool.snapshots
    )
    pool.note(np.full(3, 2), np.array([1.0, 0.0, 1.0]))
    assert pool.members[2].score == pytest.approx(2 / 3)
    state, hurt = pool.state_dict(), pool.snapshots[1].name
    (tmp_path / f"{hurt}.pt").write_bytes(b"not a snapshot")
    again = empty_pool(tmp_path)
    again.add_scripted("astar", AStarEvader())
    with pytest.warns(UserWarning, match=f"{hurt}.pt: damaged or missing snapshot"):
        again.load_state_dict(state)
    assert again.names == [name for name in pool.names if name != hurt]
    assert again.members[2].score == pytest.approx(2 / 3) and again.offered == 10


def test_snapshots_are_loaded_when_they_play_and_a_bounded_number_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("train.self_play.pool.MOST_LOADED", 2)
    pool, again = empty_pool(tmp_path, 5), empty_pool(tmp_path, 5)
    for n in range(5):
        pool.add(f"{n}", {"action": n % 4}, np.random.default_rng(0))
    again.load_state_dict(pool.state_dict())

    def loaded() -> list[str]:
        return [member.name for member in again.snapshots if member.loaded is not None]

    assert again.names == pool.names and loaded() == []
    policy, simulator = PoolPolicy(again, 8), Simulator(make_task("chase"), 8)
    for playing, kept in (([0], []), ([1, 2], ["0", "1"]), ([5], ["1", "4"]),
                          ([1, 2, 3, 4], ["0", "1", "2", "3"]), ([4], ["2", "3"])):  # fmt: skip
        policy.opponents[:] = np.resize(playing, 8)
        actions = policy.act(simulator.view("evader"))
        expected = [again.members[place].policy_once() for place in policy.opponents]
        assert actions.tolist() == [one.action for one in expected]  # type: ignore[attr-defined]
        assert loaded() == kept
    (tmp_path / "0.pt").write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"0.pt: not a snapshot of this run .*; delete it"):
        _ = again.snapshots[0].policy


def test_a_full_pool_covers_all_of_the_past_evenly(tmp_path: Path) -> None:
    """Every snapshot of a run is as likely to be left as any other (Vitter's algorithm R)."""
    left, trials = np.zeros(30), 1500
    for trial in range(trials):
        pool, rng = empty_pool(tmp_path, 3), np.random.default_rng(trial)
        pool.write = lambda name, state: None  # type: ignore[method-assign]
        for n in range(30):
            pool.add(f"{n}", {"action": 0}, rng)
        left[[int(name) for name in pool.names[1:]]] += 1
        assert pool.names[1:] == sorted(pool.names[1:], key=int)
    # Three of 30 are left: each with chance 0.1, whose standard error is 0.008 here.
    assert left.sum() == 3 * trials
    np.testing.assert_allclose(left / trials, 0.1, atol=0.035)


def test_a_window_keeps_the_newest(tmp_path: Path) -> None:
    pool = OpponentPool(tmp_path, Always(0), 3, lambda state: Always(0), newest=True)
    for n in range(10):
        pool.add(f"{n}", {"action": 0}, np.random.default_rng(n))
    assert pool.names[1:] == ["7", "8", "9"]


def test_two_equal_names_are_refused(tmp_path: Path) -> None:
    pool, rng = empty_pool(tmp_path), np.random.default_rng(0)
    pool.add("one", {"action": 1}, rng)
    with pytest.raises(ValueError, match="two members of a pool are called 'one'"):
        pool.add("one", {"action": 2}, rng)
    with pytest.raises(ValueError, match="called 'latest'"):
        pool.add_scripted("latest", RandomAgent())


def test_sampling_rules_have_their_documented_weights(tmp_path: Path) -> None:
    pool, rng = empty_pool(tmp_path, 10), np.random.default_rng(0)
    for n in range(4):
        pool.add(f"{n}", {"action": n}, rng)
    assert weights(pool, "latest").tolist() == [1, 0, 0, 0, 0]
    assert weights(pool, "uniform") == pytest.approx([0.2] * 5)
    assert weights(pool, "window", window=2) == pytest.approx([1 / 3, 0, 0, 1 / 3, 1 / 3])
    for member, score in zip(pool.members, (0.5, 0.9, 0.1, 0.5, 1.0), strict=True):
        member.score = score
    shares = weights(pool, "pfsp", power=2.0)
    assert shares[:4] / shares[2] == pytest.approx(np.array([25, 1, 81, 25]) / 81, abs=2e-3)
    assert shares[4] > 0
    mixture = np.array([0, 0.25, 0, 0.75, 0])
    assert weights(pool, "nash-mixture", mixture=mixture) == pytest.approx(mixture)
    assert weights(pool, "nash-mixture")[0] == 1
    pool.members.clear()
    with pytest.raises(ValueError, match="the pool is empty"):
        weights(pool, "uniform")


@pytest.mark.parametrize(
    "matrix, shares",
    [([[0.0, -1.0, 1.0], [1, 0, -1], [-1, 1, 0]], [1 / 3] * 3), ([[3.0, 2.0], [5.0, 4.0]], [1, 0])],
)
def test_the_nash_mixture_is_the_equilibrium(
    tmp_path: Path, matrix: list[list[float]], shares: list[float]
) -> None:
    pools = {
        role: OpponentPool(tmp_path / role, Always(0), 1, lambda _: Always(0))
        for role in OPPOSING_ROLES
    }
    for pool in pools.values():
        for action in range(1, len(matrix)):
            pool.add_scripted(str(action), Always(action))
    payoffs = Payoffs(pools, (), lambda one, two: matrix[one.action][two.action])  # type: ignore[attr-defined]
    for mixture in payoffs.mixtures().values():
        assert [*mixture.values()] == pytest.approx(shares)
