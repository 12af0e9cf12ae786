"""The settings of runs, from keyword arguments and from `config.json`."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from pursuit.observations.custom import AGENT_ID, is_builtin, without_id
from pursuit.plugins import reading
from pursuit.validation import check
from train.algorithms.registry import entry
from train.families import family_of
from train.files import Plain
from train.networks.seat import Seat
from train.runs.folder import CONFIG, KEPT, RUN, SIDE, read_config
from train.runs.forms import RESTORE
from train.runs.provenance import check_parts, check_sources
from train.settings.algorithms import JOINT, SHARED, TeamSettings
from train.settings.common import with_memory
from train.settings.curricula import curriculum_form
from train.settings.defaults import DEFAULTS_BY, default_settings
from train.settings.presets import SIZE_SETTINGS, TUNED, preset_task
from train.settings.reading import (
    check_names,
    complete_settings,
    names_of,
    plain_settings,
    read_from,
    settings_with,
    typed,
)
from train.settings.run import AgentSettings, TrainSettings
from train.settings.self_play import WholeSettings, sides_in
from train.settings.task_form import task_form

MOST_JOINT = 4096
"""The largest number of joint actions of a team that learns as one player."""


def unchecked_settings(**flat: Any) -> AgentSettings:
    """Settings by their names on the command line, with defaults from `preset`.

    Raises:
        ValueError: an unknown name, a value of the wrong type, or one that is not allowed.
    """
    flat = with_memory(plain_settings(flat))
    form = task_form(flat)
    chosen = {n: flat.get(n) for n in (*DEFAULTS_BY, *SIZE_SETTINGS)}
    preset = flat.get("preset", TUNED)
    task = settings_with(form, flat, preset_task(preset, form, flat.get("task")))
    default = default_settings(task, preset=preset, **chosen)
    hyper, own = default["hyper"], default["curriculum_settings"]
    check_names(
        flat,
        {*names_of(form, type(hyper), type(own), TrainSettings), "preset"},
        f" for algorithm {default['algorithm']!r} and curriculum {default['curriculum']!r}",
    )
    default["hyper"] = settings_with(type(hyper), flat, vars(hyper))
    default["curriculum_settings"] = settings_with(type(own), flat, vars(own))
    return TrainSettings(**{**default, **typed(TrainSettings, flat)})


def from_plain(plain: Plain, where: str) -> AgentSettings:
    """Settings from the plain values of the `config.json` at `where`.

    Raises:
        ValueError: missing or unknown settings, or values that are not allowed.
    """
    with read_from(where, RESTORE):
        own = complete_settings(TrainSettings, plain)
        forms: dict[str, type[Any]] = {
            "task": task_form(plain.get("task", {})),
            "hyper": entry(own["algorithm"]).settings,
            "curriculum_settings": curriculum_form(own["curriculum"]),
        }
        parts = {
            name: form(**complete_settings(form, plain.get(name), name))
            for name, form in forms.items()
        }
        settings: AgentSettings = TrainSettings(**own, **parts)
        learning_seat(settings)
    return settings


def load_settings(folder: Path | str) -> AgentSettings:
    """The settings of a run of a single agent, or of one role of self-play.

    Raises:
        ValueError: no such run there, or a damaged one.
    """
    folder = Path(folder)
    kind, plain = read_config(folder)
    roles = [str(folder / r) for r, own in sides_in(plain).items() if not isinstance(own, str)]
    check(
        kind in (RUN, SIDE, KEPT),
        f"{folder}: a run of kind {kind!r}, with a policy for each role; give {' or '.join(roles)}",
    )
    check_parts(folder / CONFIG, plain)
    check_sources(folder / CONFIG, plain)
    with reading(folder / CONFIG):
        return from_plain(plain, str(folder / CONFIG))


def check_source(settings: WholeSettings) -> None:
    """ValueError unless there is a run for `init_from`, which only a new run needs."""
    if settings.init_from is not None:
        read_config(Path(settings.init_from))


def evaluated_settings(folder: Path | str, others: bool = False) -> AgentSettings:
    """The settings of a run with the opponents of its evaluation.

    Of a single run these are the opponents of the training with their final share of random moves.
    Of one side of self-play they are the policies of the other sides that the run is judged by.

    Args:
        folder: as of `load_settings`.
        others: whether other opponents will be put in their place.

    Raises:
        ValueError: as `load_settings`, or the other sides of self-play are not beside the folder.
    """
    folder, settings = Path(folder), load_settings(folder)
    if others or read_config(folder)[0] != SIDE:
        return settings
    place = Path(os.path.relpath(folder.resolve().parent))
    check(
        (place / CONFIG).exists(),
        f"{folder}: is one side of self-play, and the run {place} does not exist; give --opponent",
    )
    return replace(settings, task=settings.task.beside(str(place)))


def trains_team(folder: Path | str) -> bool:
    """Whether the policy of a run was trained in all seats of a role with several agents."""
    settings, side = load_settings(folder), read_config(Path(folder))[0] == SIDE
    whole = side or entry(settings.algorithm).whole_role
    return whole and agent_seat(settings).team_size > 1


def agent_seat(settings: AgentSettings) -> Seat:
    """The learning agent in the training games of a run, alone; ValueError if there is none."""
    seat = family_of(settings.task).seat(settings)
    check(
        settings.frame_stack == 1 or not seat.NO_MEMORY,
        f"frame_stack={settings.frame_stack} is not supported for {seat.NO_MEMORY}; leave it out",
    )
    return seat


def learning_seat(settings: AgentSettings) -> Seat:
    """The learning agent in the training games of a run, or the team that learns; ValueError if
    there is none."""
    return team_seat(agent_seat(settings), settings)


def team_seat(seat: Any, settings: AgentSettings) -> Any:
    """The seat of all agents of the role, if the algorithm trains these; ValueError for a single
    agent of a role then."""
    hyper: Any = settings.hyper
    if not isinstance(hyper, TeamSettings) or seat.NO_TEAM:
        return seat
    check(
        seat.agent == seat.role,
        f"role={seat.agent!r}, but {settings.algorithm} trains all agents of a role; give "
        f"{seat.role}, or use ppo or dqn",
    )
    sharing = hyper.sharing
    check(
        sharing == SHARED or settings.frame_stack == 1,
        f"sharing={sharing!r} does not support frame_stack={settings.frame_stack}; use "
        "sharing=shared",
    )
    joint = sharing == JOINT and seat.members > 1
    if joint:
        check_team_as_one(seat, settings)
    encoding = without_id(seat.encoding)
    if hyper.with_id and seat.members > 1:
        encoding += AGENT_ID
    return replace(seat, encoding=encoding, team=True, joint=joint, critic=hyper.critic_observation)


def check_team_as_one(seat: Any, settings: AgentSettings) -> None:
    """ValueError where a team cannot learn as one player, which observes the state."""
    unable = f"sharing='joint' does not support {seat.NO_JOINT}; use sharing=shared"
    check(not seat.NO_JOINT, unable)
    task, count = seat.task, seat.task.num_actions**seat.members
    names = [name for name in task.agent_names if task.seat_roles[task.seat(name)] == seat.role]
    hidden = any(map(task.hides_from, names)) or not is_builtin(seat.encoding)
    memory = settings.frame_stack > 1 or settings.hyper.recurrent is not None
    why = {
        f"{count:,} joint actions; at most {MOST_JOINT:,} are possible": count > MOST_JOINT,
        "views that are limited, or a user-defined observation": hidden,
        "memory (recurrent, frame_stack)": memory,
        "masked actions (mask_bumps, turns)": seat.has_masks,
    }
    found = next((reason for reason, holds in why.items() if holds), "")
    check(not found, f"sharing='joint' does not support {found}; use sharing=shared")
