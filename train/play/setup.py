"""Construction of play sessions from the settings of the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pursuit.validation import check, need
from scripted_agents.names import agent_name
from train.evaluation.games import other_role
from train.families import family_of
from train.play.session import Session
from train.runs.folder import CONFIG
from train.runs.opponents import is_self_play, policy_of
from train.runs.saved import load_settings
from train.runs.worlds import task_world_of
from train.settings.mazes import check_one_maze
from train.settings.self_play import OPPOSING_ROLES
from train.settings.task import TaskSettings
from train.settings.task_form import with_values


def session_of(settings: TaskSettings, beside: str, seed: int) -> Session:
    """A session in which the user plays the role of the settings.

    Args:
        settings: the task; the user plays its role, the policies of its opponent the other agents.
        beside: the policy that plays the same starts in place of the user: astar, equilibrium,
            random, package.module:Name, or the folder of a run.
        seed: of the games.

    Raises:
        ValueError: invalid settings, or policies that do not match the task.
    """
    world: Any = task_world_of(settings)
    check_one_maze(world.task, "a game by hand")
    check(
        world.task.mazes[0].is_grid,
        f"{world.task.mazes[0].name} is a graph, and arrow keys are moves in rows and columns; "
        "play in a maze",
    )
    placed = need(family_of(settings).policies).placed
    for role, policy in world.opponents.items():
        placed(policy, world.task, role, str(world.settings.opponent), 0.0)
    role = world.agent.split("_")[0]
    policy = policy_of(settings, beside, world.task, role)
    return Session(world.contest(2), name_of(beside, role), policy, seed, world.settings.opponent)


def game_of_run(against: str) -> TaskSettings:
    """The task of a run with the user in the other role.

    Raises:
        ValueError: a damaged run, or a run of the arm.
    """
    folder = Path(against)
    if is_self_play(folder):
        folder = next(
            (folder / r for r in OPPOSING_ROLES if (folder / r / CONFIG).exists()), folder
        )
    learned = load_settings(folder).task
    learned = with_values(learned, against, mask_bumps=False)
    role = learned.agent.split("_")[0]
    other = other_role(role) if role in OPPOSING_ROLES else role
    return replace(learned, role=other, opponent=None, mask_bumps=False)


def of_side(settings: TaskSettings) -> TaskSettings:
    """The settings; an opponent that is a self-play run becomes the folder of the other role."""
    folder = Path(str(settings.opponent))
    role = settings.agent.split("_")[0]
    if settings.opponent is None or not is_self_play(folder) or role not in OPPOSING_ROLES:
        return settings
    return replace(settings, opponent=str(folder / other_role(role)))


def name_of(given: str, role: str) -> str:
    """The name of an agent in results."""
    if given == "astar":
        return "nearest goal" if role == "runner" else "A*"
    if agent_name(given) == "equilibrium":
        return "optimal" if role == "runner" else "equilibrium"
    folder = Path(given)
    if not folder.exists():
        return given
    return f"{folder.parent.name}/{folder.name}" if folder.name in OPPOSING_ROLES else folder.name
