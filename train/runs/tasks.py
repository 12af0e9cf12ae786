"""Tasks, agents and default settings from the settings of a task."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pursuit.mazes.maze import Maze
from pursuit.mazes.suite_files import PREFIX, is_suite
from pursuit.tasks.rewards import REWARDS
from pursuit.tasks.task import Task, make_task
from pursuit.validation import check
from scripted_agents.games.agents import DISCOUNT as GAME_DISCOUNT
from scripted_agents.games.episodes import longest_play, return_range
from scripted_agents.games.named import load_game
from scripted_agents.games.simulator import GameTask
from scripted_agents.games.small_game import KEPT
from train.files import Plain
from train.settings.presets import (
    TUNED,
    TaskProfile,
    curriculum_for,
    for_budget,
    for_episodes,
    hyperparameters,
    preset_algorithm,
    preset_run,
)
from train.settings.task import AnyTask, ReacherSettings, SmallGameSettings, TaskSettings
from train.teaching.mazes import named_maze

DEFAULTS_BY = ("algorithm", "curriculum", "recurrent", "gamma", "frames")
"""Settings of a run that the defaults of others depend on, besides `SIZES`."""


def task_of(settings: TaskSettings) -> Task:
    """The task of these settings, with its maze loaded; one object for equal settings.

    Raises:
        ValueError: no such maze, or settings that the task does not allow.
    """
    given = {field.name: getattr(settings, field.name, None) for field in fields(Task)}
    # None, and the rewards "default", are those of the named task.
    changed = {name: value for name, value in given.items() if value is not None}
    if settings.rewards == "default":
        del changed["rewards"]
    changed["maze"] = maze_of(settings.maze)
    if REWARDS.origin(settings.rewards) is not None:  # the function of a name may change
        return make_task(settings.task, **changed)
    return _built_once(settings.task, **changed)


@lru_cache(maxsize=4)
def _built_once(name: str, **changed: Any) -> Task:
    """As `make_task`: tasks are immutable, and a run needs its task in several places."""
    return make_task(name, **changed)


def game_of(settings: SmallGameSettings) -> GameTask:
    """The small game of these settings, enumerated; one object for equal settings.

    Raises:
        ValueError: no such game, or one that cannot be enumerated.
    """
    return _game_with(settings.game, settings.max_steps)


@lru_cache(maxsize=KEPT)
def _game_with(name: str, max_steps: int) -> GameTask:
    return GameTask(load_game(name), name, max_steps)


def discount_of(settings: SmallGameSettings) -> float:
    """The default discount of a small game: 1 if it always ends within `max_steps`."""
    longest = _longest_play(game_of(settings))
    ends = longest is not None and longest <= settings.max_steps
    return 1.0 if ends else GAME_DISCOUNT


@lru_cache(maxsize=KEPT)
def _longest_play(task: GameTask) -> int | None:
    return longest_play(task.game)


def horizon_of(task: GameTask, discount: float) -> int | None:
    """The horizon of exact results in a small game: its time limit, None with a discount."""
    return task.max_steps if discount == 1.0 else None


@lru_cache(maxsize=2 * KEPT)
def reward_scale(task: GameTask, player: str, discount: float) -> float:
    """The factor of a player's rewards in training with which all its returns lie in [-1, 1].

    They are the units of the coefficients of losses; large returns would make the value loss
    dominate. Without discount (1) returns are those within `max_steps`.
    """
    horizon = horizon_of(task, discount)
    largest = float(np.abs(return_range(task.game, player, discount, horizon)).max())
    return 1.0 / largest if largest > 0.0 else 1.0


def player_in(settings: SmallGameSettings, task: GameTask) -> str:
    """The learning player; ValueError unless the game has it."""
    return task.agent_names[0 if settings.player == "auto" else task.seat(settings.player)]


def check_one_maze(task: Task, what: str) -> None:
    """ValueError if a task has several mazes; `what` is the subject of the message."""
    name = task.mazes[0].name
    check(
        len(task.mazes) == 1,
        f"{what} needs one maze, but the task has {len(task.mazes)}; use one of them, such as "
        f"{PREFIX if '/' in name else ''}{name}",
    )


def maze_of(maze: str) -> Maze | str:
    """The maze of settings, as `named_maze`; ValueError if there is none.

    The name of a suite is returned as it is.
    """
    return maze if is_suite(maze) else named_maze(maze)


def maze_text_of(settings: AnyTask) -> str | None:
    """The maze as text; None if there is none, and for a suite, which has its own files."""
    if not isinstance(settings, TaskSettings):
        return None
    maze = maze_of(settings.maze)
    return None if isinstance(maze, str) else maze.to_text()


def agent_of(settings: TaskSettings, task: Task) -> str:
    """The learning agent; ValueError unless the task has it."""
    known = {*task.agent_names, *task.seat_roles}
    check(
        settings.agent in known,
        f"role {settings.agent!r} does not exist in task {settings.task!r}; use one of "
        f"{', '.join(sorted(known))}",
    )
    return settings.agent


def profile_of(settings: AnyTask) -> TaskProfile:
    """The profile of a task for the presets: task, role and size; joints of an arm."""
    if isinstance(settings, ReacherSettings):
        return TaskProfile("reacher", "arm", 0, joints=settings.build().joints)
    if isinstance(settings, SmallGameSettings):
        return TaskProfile(settings.task, settings.player, 0)
    task = task_of(settings)
    return TaskProfile(
        settings.task,
        agent_of(settings, task).split("_")[0],
        task.max_cells,
        random_start=settings.start == "random",
        duel=task.is_duel,
        many_mazes=len(task.mazes) > 1,
        goals=task.num_goals,
    )


def default_settings(
    task: AnyTask,
    algorithm: str | None = None,
    preset: str = TUNED,
    curriculum: str | None = None,
    recurrent: str | None = None,
    gamma: float | None = None,
    frames: int | None = None,
    **sizes: int | None,
) -> Plain:
    """The default settings of a run: task, hyper, curriculum_settings, algorithm and curriculum,
    and those of the run that the preset changes.

    Args:
        task: its settings.
        algorithm, curriculum: by name; by default those of the preset.
        preset: by name.
        recurrent, gamma: the user's values, which the defaults depend on.
        frames: the budget, which tuned defaults in one maze depend on; None for one in seconds.
        **sizes: the user's values of `SIZES`; if there is one, the budget changes nothing.

    Raises:
        ValueError: an unknown name, settings that the task does not allow, or a preset of another
            algorithm.
    """
    algorithm = algorithm or preset_algorithm(preset) or "ppo"
    setting = replace(profile_of(task), recurrent=recurrent is not None)
    hyper = hyperparameters(algorithm, setting, preset, gamma is not None)
    if isinstance(task, SmallGameSettings) and gamma is None:
        constant: Plain = {"gamma_end": None} if hasattr(hyper, "gamma_end") else {}
        hyper = replace(hyper, gamma=discount_of(task), **constant)
    of_preset = curriculum is None
    curriculum, curriculum_settings = curriculum_for(algorithm, setting, preset, curriculum)
    one_maze = preset == TUNED and not setting.many_mazes and isinstance(task, TaskSettings)
    if one_maze and isinstance(frames, int) and frames > 0 and not any(sizes.values()):
        usual, hyper = hyper, for_budget(hyper, frames)
        if hyper != usual and of_preset:
            episodes = frames / (hyper.num_games * task.max_steps)
            curriculum_settings = for_episodes(curriculum_settings, episodes)
    return {
        **preset_run(preset),
        "task": task,
        "hyper": hyper,
        "curriculum_settings": curriculum_settings,
        "algorithm": algorithm,
        "curriculum": curriculum,
    }
