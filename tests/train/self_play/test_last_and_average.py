"""Last and averaged weights of self-play: which are played, and NashConv of both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pursuit.mazes.maze import load_maze
from scripted_agents.games import load_game, nash_conv
from train.evaluation.exploitability import duel_nash_conv as duel_nash_conv
from train.kinds import start
from train.runs.folder import SELF_PLAY
from train.runs.opponents import policy_of
from train.self_play.parts import self_play_settings_of

SMALL = {"frames": 6000, "num_games": 32, "minibatch_size": 256, "width": 8, "learning_rate": 0.03}


def ended(folder: Path, **settings: Any) -> Any:
    """A run that has ended, with its results."""
    run = start(SELF_PLAY, self_play_settings_of(**SMALL, **settings), folder)
    run.train(lambda run, row: None)
    return run, run.results(20)


def without(table: np.ndarray[Any, Any], least: float) -> np.ndarray[Any, Any]:
    """Rows without the entries below `least`."""
    kept = np.where(table >= least, table, 0.0)
    return np.asarray(kept / kept.sum(axis=-1, keepdims=True))


@pytest.mark.parametrize("average", [True, False])
def test_nash_conv_of_a_small_game_is_that_of_both_weights(tmp_path: Path, average: bool) -> None:
    name = "soccer(rows=2,columns=4)"
    run, results = ended(tmp_path / "run", game=name, average=average, min_probability=0.0)
    game, discount = load_game(name), run.trainee.parts.game.discount
    found = results["nash_conv_of"]
    for which, averaged in (("last", False), ("average", True)):
        weights = {
            role: side.average if averaged else side.learner.network.state_dict()
            for role, side in run.trainee.sides.items()
        }
        tables = {}
        for role, side in run.trainee.sides.items():
            before = {k: v.clone() for k, v in side.learner.network.state_dict().items()}
            side.learner.network.load_state_dict(weights[role])
            policy = side.learner.policy(greedy=False)
            tables[role] = policy.state_probabilities().copy()
            side.learner.network.load_state_dict(before)
        task = run.trainee.game.task
        for suffix, least in (("", 0.0), ("_likely", 0.05)):
            own = {role: task.flat(role, without(table, least)) for role, table in tables.items()}
            expected = nash_conv(game, own, discount).nash_conv
            assert found[which + suffix] == pytest.approx(expected, abs=1e-5)
    assert found["last"] != pytest.approx(found["average"], abs=1e-6)
    played = found["average" if average else "last"]
    assert results["evaluation"]["nash_conv"] == pytest.approx(played, abs=1e-9)
    given, folder = run.trainee.settings.task, str(tmp_path / "run")
    saved = {role: policy_of(given, folder, run.trainee.game.task, role) for role in "AB"}
    tables = {role: policy.table(run.trainee.game.task) for role, policy in saved.items()}
    assert nash_conv(game, tables, discount).nash_conv == pytest.approx(played, abs=1e-5)


def test_nash_conv_of_a_duel_is_that_of_the_policies(tmp_path: Path) -> None:
    run, results = ended(tmp_path / "run", maze="3x3", average=False)
    maze, found = load_maze("3x3"), results["nash_conv_of"]
    for name, averaged, least in (("last", False, 0.0), ("average_likely", True, 0.05)):
        tables = [
            run.trainee.sides[role].policy_with(averaged, least).action_probabilities(maze)
            for role in ("chaser", "evader")
        ]
        assert found[name] == pytest.approx(duel_nash_conv(maze, *tables, 0.95), abs=1e-6)
    assert results["evaluation"]["nash_conv"] == pytest.approx(found["last_likely"], abs=1e-9)
