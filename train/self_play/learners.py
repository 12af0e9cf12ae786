"""The settings of self-play from names and values; imported without torch by the command line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from keyword import iskeyword
from typing import Any

from pursuit.validation import check, shortened
from scripted_agents.names import agent_name
from train.files import Plain
from train.settings.algorithms import TUNED_AS, Hyperparameters, hyperparameter_form
from train.settings.common import with_memory
from train.settings.presets import hyperparameters
from train.settings.reading import check_names, names_of, plain_settings, settings_with, typed
from train.settings.self_play import (
    LEARN,
    LearningSide,
    SelfPlayBase,
    self_play_form,
    self_play_ppo,
    unnested_sides,
)
from train.settings.task_form import TaskForm, task_form

ALGORITHM = "algorithm"
LONGEST = 60
"""Letters of the name of a player."""


def learning_side(role: str, task: TaskForm, common: Plain, own: Plain) -> LearningSide:
    """A side that learns, with tuned hyperparameters where none are given.

    Args:
        role: of the side.
        task: the settings of the game.
        common: the algorithm and hyperparameters of both sides; those of other algorithms are
            ignored.
        own: those of this side, which take precedence.

    Raises:
        ValueError: an unknown name in `own`, or a value that is not allowed.
    """
    algorithm = {**common, **own}.get(ALGORITHM, "ppo")
    form, default = hyperparameter_form(algorithm), self_play_ppo()
    if task.discount is not None:
        default = replace(default, gamma=task.discount, gamma_end=None)
    names = names_of(form)
    check_names(own, [ALGORITHM, *names], f" of the {role}'s algorithm {algorithm!r}")
    given = {name: value for name, value in common.items() if name in names}
    if common.get("gamma_end") is not None and "gamma_end" not in names:
        given["gamma"] = common["gamma_end"]  # both sides end with the same discount
    given |= {name: value for name, value in own.items() if name != ALGORITHM}
    hyper: Hyperparameters = default
    if TUNED_AS.get(algorithm) == "ppo":
        hyper = replace(form(), **vars(default))
    elif algorithm != "ppo":
        tuned = hyperparameters(algorithm, task.with_agent(role).profile())
        same: Plain = {"gamma": default.gamma, "gamma_end": None, "recurrent": None}
        hyper = replace(tuned, **{name: same[name] for name in same if name in names})
    return LearningSide(algorithm, settings_with(form, given, vars(hyper)))


def checked_names(names: Iterable[str], roles: Sequence[str]) -> None:
    """ValueError for a setting of one side in its former form, such as chaser_batch_size."""
    for name in names:
        role, _, rest = name.partition("_")
        if role in roles and rest:
            option = f"--{role}.{rest.replace('_', '-')}"
            check(False, f"unknown setting {name!r}; give {role}.{rest} (as an option {option})")


def unchecked_self_play(**flat: Any) -> SelfPlayBase:
    """As `self_play_settings_of`, without the checks that build the task and the policies."""
    form = task_form(flat)
    flat = with_memory(plain_settings(flat))
    task = settings_with(form, flat, form.for_self_play(flat))
    whole, roles = self_play_form(form), sides_of(task)
    flat = unnested_sides(flat, roles)
    own: dict[str, Plain] = {role: {} for role in roles}
    common: Plain = {}
    shared = {*names_of(form, whole), *roles}
    checked_names([name for name in flat if name not in shared], roles)
    for name, value in flat.items():
        role, dot, rest = name.partition(".")
        if dot and role in roles:
            own[role][rest] = value
        elif name not in shared:
            common[name] = value
    sides: Plain = {}
    known = {ALGORITHM, *shared}
    for role in roles:
        fixed = flat.get(role, LEARN)
        check(isinstance(fixed, str), f"{role}={fixed!r}; give a name, or a table of settings")
        if fixed == LEARN:
            try:
                sides[role] = learning_side(role, task, common, own[role])
            except ValueError as error:
                raise ValueError(f"{role}: {error}") from None
            known |= set(names_of(type(sides[role].hyper)))
        else:
            sides[role] = agent_name(fixed)
            given = ", ".join(f"{role}.{name}" for name in own[role])
            check(not given, f"{given} with {role}={fixed!r}, which does not learn; leave it out")
    check_names(common, known, " of self-play")
    make: Any = whole
    own_values = {"observation": form.OBSERVATION, **typed(whole, flat)}
    return make(task=task, **given_sides(whole, sides), **own_values)


def given_sides(form: type[SelfPlayBase], sides: Plain) -> Plain:
    """The sides by role as the settings hold them: by their names, or together as players."""
    return {"players": sides} if "players" in {each.name for each in fields(form)} else sides


def sides_of(task: TaskForm) -> tuple[str, ...]:
    """The sides of self-play in a task, which is not built.

    Raises:
        ValueError: no such game, or a side with the name of a setting, or none that is a word.
    """
    form = type(task)
    settings = {*names_of(form, self_play_form(form)), ALGORITHM}
    for name in task.sides:
        check(
            name.isidentifier()
            and not iskeyword(name)
            and name not in settings
            and len(name) <= LONGEST,
            f"{shortened(task.label)}: a player is called {shortened(name)}; rename it to a "
            f"word of at most {LONGEST} letters that is not the name of a setting, as options and "
            "folders have the names of players",
        )
    return task.sides
