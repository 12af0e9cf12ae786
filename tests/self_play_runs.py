"""Short runs of self-play, for the tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import GameView
from scripted_agents.games.simulator import GameTask
from train.evaluation.maze_sides import MazeSides
from train.evaluation.return_sides import SmallGameSides
from train.evaluation.sides import Sides
from train.kinds import resume, start
from train.runs.folder import SELF_PLAY
from train.runs.loop import Run
from train.runs.worlds import task_world_of
from train.self_play.learners import learning_side
from train.self_play.pool import OpponentPool
from train.settings.self_play import OPPOSING_ROLES, LearningSide, SelfPlaySettings, self_play_ppo
from train.settings.task import TaskSettings


def sides_of_task(task: Any, discount: float = 0.95, **settings: Any) -> Sides:
    """The sides of a game in a maze or of a small game, without the settings of a run."""
    given: Any = TaskSettings(**settings)
    if isinstance(task, GameTask):
        given = SimpleNamespace(sides=task.agent_names)
        return SmallGameSides(SimpleNamespace(settings=given), task, discount)
    return MazeSides(task_world_of(given), task, discount)


def tables_of(run: Run[Any]) -> dict[str, Any]:
    """The tables of the policies of a run in a small game."""
    tables: dict[str, Any] = run.trainee.game.tables_of(run.trainee.policies)
    return tables


QUICK = replace(self_play_ppo(), num_games=64, minibatch_size=512)


class Always:
    """Takes one action, and notes how many games it was asked for."""

    def __init__(self, action: int) -> None:
        self.action, self.asked = action, 0

    def act(self, view: GameView) -> NDArray[np.int32]:
        self.asked = view.num_games
        return np.full(view.num_games, self.action, dtype=np.int32)


def make_settings(**changes: Any) -> SelfPlaySettings:
    task = {"maze": "3x3", "rewards": "zero_sum", **changes.pop("task", {})}
    sides = dict.fromkeys(OPPOSING_ROLES, LearningSide(hyper=changes.pop("hyper", QUICK)))
    given: dict[str, Any] = {**sides, "frames": 40_000, "snapshots": 5, **changes}
    return SelfPlaySettings(task=TaskSettings(**task), **given)


def side_by(algorithm: str, role: str = "chaser", maze: str = "3x3", **own: Any) -> LearningSide:
    return learning_side(role, TaskSettings(maze=maze), {}, {"algorithm": algorithm, **own})


def make_run(folder: Path, **changes: Any) -> Run:
    return start(SELF_PLAY, make_settings(**changes), folder)


def go_on(folder: Path) -> Run:
    return resume(folder, SELF_PLAY)


def empty_pool(folder: Path, capacity: int = 3) -> OpponentPool:
    return OpponentPool(folder, Always(0), capacity, lambda state: Always(state["action"]))
