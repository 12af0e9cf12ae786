"""Validation of the settings of self-play, and construction of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from scripted_agents.environments import (
    AGENTS,
    SEARCHERS,
    check_agent,
    custom_policy,
    custom_roles,
    scripted_policy,
)
from train.algorithms.registry import entry
from train.networks.policy import Seat
from train.runs.forms import RESTORE
from train.runs.opponents import policy_in_seat
from train.runs.parts import build_of, check_sizes
from train.runs.tasks import check_one_maze, task_of
from train.self_play.learners import complete, hyper_of
from train.self_play.side import SideParts
from train.settings.algorithms import PPOSettings, hyperparameter_form
from train.settings.checks import check
from train.settings.common import RunSettings, with_memory
from train.settings.reading import check_names, names_of, picked, read_from, typed, whole
from train.settings.run import TrainSettings
from train.settings.self_play import LEARN, ROLES, SelfPlaySettings, self_play_ppo
from train.settings.task import TaskSettings


@dataclass(frozen=True)
class SelfPlayParts:
    """The parts of self-play.

    Attributes:
        task: the game.
        sides: the parts of each role that learns.
        frozen: the policy of each role that does not.
        scripted: scripted agents by name and role, for pools and for comparison.
        discount: of the exact game.
    """

    task: Task
    sides: dict[str, SideParts]
    frozen: dict[str, Policy]
    scripted: dict[tuple[str, str], Policy]
    discount: float


def self_play_parts(settings: SelfPlaySettings) -> SelfPlayParts:
    """The parts of self-play.

    Raises:
        ValueError: settings without two sides, or that an algorithm does not support.
    """
    task = task_of(settings.task)
    check_one_maze(task, "self-play")
    check_sides(settings, task)
    discount, masks = settings.discount, settings.task.mask_bumps
    scripted = {
        (name, role): scripted_policy(
            name,
            role,
            # The random moves of A* are a setting.
            settings.task.opponent_epsilon if name == "astar" else 0.0,
            task.move_order,  # type: ignore[arg-type]
            discount,
        )
        for name in AGENTS
        for role in ROLES
        if role in SEARCHERS.get(name, ROLES)
    }
    scripted |= {
        (name, role): custom_policy(name, task, role)
        for name in settings.members
        if name not in AGENTS
        for role in custom_roles(name, task)
    }
    frozen = {
        role: scripted[name, role]
        if (name, role) in scripted
        else policy_in_seat(
            name,
            task,
            role,
            played=settings.task.opponent_policy,
            observation=settings.task.opponent_observation,
        )
        for role in ROLES
        if role not in settings.learning
        for name in [str(getattr(settings, role))]
    }
    sides: dict[str, SideParts] = {}
    for role in settings.learning:
        own = side_settings(settings, role)
        seat = Seat(task, role, own.observation, masks, own.frame_stack, own.network)
        check_sizes(own.hyper, seat)
        entry(own.algorithm).check_memory(own.hyper, seat)
        sides[role] = SideParts(
            seat,
            entry(own.algorithm),
            own.hyper,
            build_of(own),
            discount,
            # Returns of up to 1 / (1 - gamma) steps would make the value loss dominate.
            1.0 - discount if settings.task.rewards == "zero_sum" else 1.0,
            settings.min_probability,
        )
    return SelfPlayParts(task, sides, frozen, scripted, discount)


def check_sides(settings: SelfPlaySettings, task: Task) -> None:
    """ValueError unless the task has chasers and evaders only, and the algorithms support it."""
    check(
        bool(task.num_chasers and task.num_evaders),
        f"task {task.name!r} has no chasers or no evaders; use chase or heist",
    )
    check(
        not task.num_goals or settings.task.rewards == "zero_sum",
        f"rewards={settings.task.rewards!r} with goals; use zero_sum: opponents are scored by "
        "steps, so chasers must be rewarded for short episodes",
    )
    check(not task.num_runners, f"task {task.name!r} has runners; use chase or heist")
    for role in ROLES:
        members = [name for name in settings.members if role in SEARCHERS.get(name, ROLES)]
        for name in (getattr(settings, role), *members):
            if name in AGENTS:
                check_agent(name, task, role)
    for role in settings.learning:
        entry(settings.algorithm(role)).check_self_play(role, task.count(role))


def side_settings(settings: SelfPlaySettings, role: str) -> TrainSettings[Any]:
    """The settings of the learner of one role, as those of a single-agent run."""
    task = replace(settings.task, role=role)
    members = task_of(task).count(role)
    algorithm, hyper = settings.algorithm(role), hyper_of(settings, role)
    games = max(hyper.num_games // members, 1) * members
    if isinstance(hyper, PPOSettings):
        batch = min(hyper.minibatch_size, games * hyper.rollout_steps)
        hyper = replace(hyper, num_games=games, minibatch_size=batch)
    else:
        hyper = replace(hyper, num_games=games)
    names = {"observation", "network", "threads", *(f.name for f in fields(RunSettings))}
    whole = {name: getattr(settings, name) for name in names}
    return TrainSettings(task, hyper, algorithm=algorithm, **whole)


# -- settings from mappings ------------------------------------------------------------------------


def self_play_settings_of(**flat: Any) -> SelfPlaySettings:
    """Settings of self-play by their names on the command line, checked.

    The hyperparameters of other algorithms than PPO are prefixed with the role:
    `self_play_settings_of(chaser_algorithm="dqn", chaser_batch_size=64, frames=1000)`.

    Raises:
        ValueError: an unknown name, a value of the wrong type, or one that is not allowed.
    """
    flat = with_memory(flat)
    learn = {
        r: str(flat.get(f"{r}_algorithm", "ppo")) for r in ROLES if flat.get(r, LEARN) == LEARN
    }
    others = {r: hyperparameter_form(name) for r, name in learn.items() if name != "ppo"}
    names = {f"{role}_{name}" for role, form in others.items() for name in names_of(form)}
    ppo = [] if learn and len(others) == len(learn) else [PPOSettings]
    check_names(flat, {*names_of(TaskSettings, SelfPlaySettings, *ppo), *names}, " of self-play")
    settings = complete(
        SelfPlaySettings(
            task=picked(TaskSettings, flat, {"rewards": "zero_sum"}),
            hyper=picked(PPOSettings, flat, vars(self_play_ppo())),
            **typed(SelfPlaySettings, flat),
        )
    )
    changed: Any = {}
    for role, form in others.items():
        given = {n.removeprefix(f"{role}_"): v for n, v in flat.items() if n in names}
        changed[f"{role}_hyper"] = picked(form, given, vars(getattr(settings, f"{role}_hyper")))
    settings = replace(settings, **changed)
    self_play_parts(settings)
    return settings


def self_play_from_plain(plain: Mapping[str, Any], where: str) -> SelfPlaySettings:
    """Settings from the plain values of `config.json`; ValueError if these are invalid."""
    with read_from(where, RESTORE):
        own = whole(SelfPlaySettings, plain)
        forms: dict[str, type[Any]] = {"task": TaskSettings, "hyper": PPOSettings}
        forms |= {f"{r}_hyper": entry(own[f"{r}_algorithm"]).settings for r in ROLES}
        parts: Any = {
            name: None
            if name != "task" and plain.get(name) is None
            else form(**whole(form, plain.get(name), name))
            for name, form in forms.items()
        }
        settings = SelfPlaySettings(**own, **parts)
        check_sides(settings, task_of(settings.task))
    return settings
