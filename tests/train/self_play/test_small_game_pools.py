"""Self-play in small games: sampling rules, resumption, sides, and mixtures of snapshots."""

from __future__ import annotations

import json
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from round_games import Rounds
from self_play_runs import go_on, sides_of_task, tables_of

from scripted_agents.games import enumerate_game
from scripted_agents.games.simulator import GameTask
from train.evaluation.return_sides import describe_returns as describe_small_game
from train.kinds import start
from train.runs.folder import SELF_PLAY
from train.runs.loop import Run
from train.self_play.mixtures import mixture_bounds
from train.self_play.parts import self_play_settings_of

PAYOFF = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]])
"""[own, other] of rock, paper, scissors."""
ONCE, TWICE = "round_games:Rounds", "round_games:Rounds(rounds=2)"
THREE = "round_games:OddOneOut"
RULES = ("latest", "window", "uniform", "pfsp", "round_games:newest")


def make(folder: Path, game: str, **changes: Any) -> Run:
    given: dict[str, Any] = {"frames": 2048, "num_games": 16, "snapshots": 4, "max_steps": 5}
    if "algorithm" not in changes:
        given["minibatch_size"] = 64
    return start(SELF_PLAY, self_play_settings_of(game=game, **(given | changes)), folder)


# -- mixtures --------------------------------------------------------------------------------------


def best_against_mixture(moves: Any) -> float:
    """What the best opponent gets in two rounds against one of these players, drawn at random:
    the maximum over all plans (a move, and one after each move of the player in round one).

    Args:
        moves: [players, rounds], the moves that each makes.
    """

    def worth(plan: tuple[int, ...]) -> float:
        first, later = plan[0], plan[1:]
        return float(np.mean([PAYOFF[first, m[0]] + PAYOFF[later[m[0]], m[1]] for m in moves]))

    return max(map(worth, product(range(3), repeat=4)))


@pytest.mark.parametrize("role", ["row", "column"])
@pytest.mark.parametrize("seed", range(4))
def test_a_mixture_lies_between_its_bounds(role: str, seed: int) -> None:
    game = enumerate_game(Rounds(2))
    task = GameTask(game, "twice", 5)
    moves = np.random.default_rng(seed).integers(3, size=(3, 2))
    tables = np.eye(3)[moves].reshape(3, -1)
    lower, upper = mixture_bounds(sides_of_task(task, 1.0), role, tables, np.full(3, 1 / 3))
    exact = best_against_mixture(moves)  # the value of the game is 0
    assert lower - 1e-9 <= exact <= upper + 1e-9
    assert upper == pytest.approx(2.0)  # each of them is beaten in both rounds
    # Without discount the second round counts as the first, with 0.5 half as much.
    one = mixture_bounds(sides_of_task(task, 0.5), role, tables[:1], np.ones(1))
    assert one == pytest.approx((1.5, 1.5))


@pytest.mark.parametrize("sampling", ["uniform", "nash-mixture", "psro"])
def test_the_nash_conv_of_a_mixture_in_a_matrix_game(tmp_path: Path, sampling: str) -> None:
    run = make(tmp_path / "run", ONCE, sampling=sampling, algorithm="dqn", learning_starts=64)
    run.train()
    content = run.results(10)
    trainee, gained = run.trainee, 0.0
    for role, pool in trainee.pools.items():
        tables = {m.name: m.policy.table(trainee.game.task) for m in pool.snapshots}
        equal = dict.fromkeys(tables, 1.0 / len(tables))
        shares = trainee.mixtures[role] if sampling != "uniform" else equal
        mixture = np.sum([shares[name] * table for name, table in tables.items()], axis=0)
        gained += (PAYOFF @ mixture).max()
    lower, upper = content["mixture_nash_conv"]
    assert lower == pytest.approx(gained, abs=1e-9) and lower <= upper  # in one state it is exact
    assert content["evaluation"]["played_nash_conv"] == lower
    written = json.loads((tmp_path / "run" / "results.json").read_text())
    assert written["mixture_nash_conv"] == [lower, upper]
    assert any("NashConv of drawing from" in line for line in describe_small_game(content))


def test_without_a_mixture_the_last_policies_are_what_is_played(tmp_path: Path) -> None:
    for name, game, sampling in (("a", ONCE, "latest"), ("b", THREE, "uniform")):
        run = make(tmp_path / name, game, sampling=sampling, frames=512)
        run.train()
        content = run.results(10)
        assert "mixture_nash_conv" not in content
        assert content["evaluation"]["played_nash_conv"] == content["evaluation"]["nash_conv"]


# -- pools -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("game", "sampling"),
    [*zip(cycle((TWICE, THREE)), RULES), (TWICE, "nash-mixture"), (TWICE, "psro")],
)
def test_every_sampling_rule_resumes_bit_for_bit(tmp_path: Path, game: str, sampling: str) -> None:
    changes: dict[str, Any] = {"sampling": sampling, "window": 2 if sampling == "window" else 5}
    if sampling != "latest":
        changes["members"] = ("uniform",)
    whole = make(tmp_path / "whole", game, **changes)
    whole.train()
    part = make(tmp_path / "part", game, **changes)

    class Killed(Exception):
        pass

    def kill(run: Run, row: dict[str, float]) -> None:
        if row and run.progress > 0.4:
            raise Killed

    with pytest.raises(Killed):
        part.train(kill)
    again = go_on(tmp_path / "part")
    assert 0.3 < again.progress < 1.0
    again.train()
    for role, side in whole.trainee.sides.items():
        ours, theirs = side.snapshot()["network"], again.trainee.sides[role].snapshot()["network"]
        assert all(torch.equal(ours[name], theirs[name]) for name in ours)
        for other, policy in side.opponents.policies.items():
            same = again.trainee.sides[role].opponents.policies[other].opponents
            assert (policy.opponents == same).all()
    pools = ({r: p.state_dict() for r, p in run.trainee.pools.items()} for run in (whole, again))
    assert next(pools) == next(pools)
    assert all(len(pool.snapshots) > 1 for pool in whole.trainee.pools.values())


def test_opponents_of_three_players_are_drawn_for_each_role(tmp_path: Path) -> None:
    run = make(tmp_path / "run", THREE, members=("uniform",), sampling="uniform")
    side = run.trainee.sides["b"]
    assert set(side.opponents.policies) == set(side.opponents.shares) == {"a", "c"}
    side.opponents.shares = {"a": np.array([0.0, 1.0]), "c": np.array([1.0, 0.0])}
    side.opponents.after_restart(np.arange(16))
    drawn = {role: policy.opponents for role, policy in side.opponents.policies.items()}
    assert (drawn["a"] == 1).all() and (drawn["c"] == 0).all()
    # The score against a pair of opponents counts for both of them.
    side.opponents.episode_ended(np.ones(16, dtype=bool))
    games = {role: [m.games for m in run.trainee.pools[role].members] for role in "ac"}
    assert games == {"a": [0.0, 16.0], "c": [16.0, 0.0]}


def test_sides_have_their_own_algorithms_or_are_fixed(tmp_path: Path) -> None:
    own = {"a.algorithm": "dqn", "a.learning_starts": 64, "c.algorithm": "mmd"}
    run = make(tmp_path / "run", THREE, **own, b="uniform", algorithm="ppo", minibatch_size=64)
    run.train()
    names = {role: side.parts.algorithm.name for role, side in run.trainee.sides.items()}
    assert names == {"a": "dqn", "c": "mmd"}
    assert tables_of(run)["b"] == pytest.approx(0.5)
    rows = {(r["player"], r["policy"]) for r in run.results(10)["returns"]}
    assert {("a", "learned"), ("b", "frozen"), ("c", "learned")} <= rows


@pytest.mark.parametrize(
    ("game", "sampling", "message"),
    [
        (THREE, "psro", "'psro' needs two players with opposite rewards"),
        ("round_games:Clash", "nash-mixture", "needs two players with opposite rewards"),
        (THREE, "round_games:by_payoff", "payoffs are those of two players, but 3 play"),
    ],
)
def test_rules_with_payoffs_are_for_two_players(
    tmp_path: Path, game: str, sampling: str, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        make(tmp_path / "run", game, sampling=sampling)
