"""Curricula in games of which nothing is known but their batch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pursuit import ReacherTask
from scripted_agents.games import enumerate_game
from scripted_agents.games.named import load_game
from scripted_agents.games.simulator import GameSimulator, GameTask
from train.settings.curricula import curriculum_form
from train.teaching.context import ArmContext, Context, SmallGameContext
from train.teaching.plan import Plan, plan_curriculum
from train.teaching.teacher import EpisodeMetrics, Teacher

TASK = GameTask(load_game("soccer"), "soccer")
ANY = Context(TASK, "A")


class Alone:
    """A game of one player that ends at once."""

    players = ("A",)

    def starts(self) -> Any:
        return [(1.0, 0)]

    def legal_actions(self, state: Any, player: int) -> Any:
        return (0,)

    def transitions(self, state: Any, actions: Any) -> Any:
        return [(1.0, 0, (1.0,), True)]


def plan(name: str, context: Context, **given: Any) -> Plan | None:
    return plan_curriculum(name, curriculum_form(name)(**given), context, 0)


def test_levels_of_any_game_are_replayed() -> None:
    found = plan("level-replay", ANY, level_score="learnability", replay_share=1.0)
    assert found is not None and found.optimum is None and found.task is TASK
    games = GameSimulator(TASK, 8, auto_restart=False)
    metrics = EpisodeMetrics(lambda g: g.returns[:, 0] > 0, lambda g: g.returns[:, 0])
    teacher = Teacher(found, games, metrics)
    every = np.arange(8)
    for share in (0.0, 0.5):
        teacher.before_restart(every)
        games.reset(games=every)
        teacher.after_restart(every)
        games.returns[:4, 0] = 1.0
        teacher.episode_ended(np.ones(8, dtype=bool))
        teacher.update(share, 8, 1.0)
    assert teacher.episodes == 16
    first = games.state.copy()
    games.seed_starts(every, teacher.playing.astype(np.int64))
    games.reset(games=every)
    assert (games.state == first).all()  # the value of an episode is the seed of its start


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("level-replay", {}, "needs the exact optimum of every start"),
        ("maze-replay", {}, "chooses among mazes, and task 'soccer' has one"),
        ("opponent-epsilon", {}, "'opponent-epsilon' needs games in mazes"),
        ("maze-size", {}, "needs games in mazes"),
        ("hold", {}, "needs an arm"),
        ("uniform", {}, "axis='auto' needs a default axis, and task 'soccer' has none"),
    ],
)
def test_what_needs_more_is_refused(name: str, given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plan(name, ANY, **given)


def test_a_batch_with_random_moves_of_opponents_has_their_axis() -> None:
    found = plan("uniform", replace(ANY, opponent_epsilon=0.25))
    assert found is not None and found.axis is not None
    assert (found.axis.name, found.axis.easiest, found.axis.hardest) == (
        "opponent-epsilon", 1.0, 0.25,
    )  # fmt: skip
    with pytest.raises(ValueError, match="needs opponents, all of them scripted"):
        plan("uniform", replace(ANY, opponent_epsilon=0.0, learned_opponent="runs/a"))


def test_an_axis_of_opponents_needs_some() -> None:
    with pytest.raises(ValueError, match="'opponent-epsilon' needs games in mazes"):
        plan("opponent-epsilon", ArmContext(ReacherTask()))
    with pytest.raises(ValueError, match="needs other players, which this game does not have"):
        plan("hold", SmallGameContext(GameTask(enumerate_game(Alone())), "A", {}, 0.0))
