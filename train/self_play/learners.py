"""The settings of self-play from names and values; imported without torch by the command line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from pursuit.validation import check
from train.files import Plain
from train.runs.tasks import profile_of
from train.settings.algorithms import Hyperparameters, hyperparameter_form
from train.settings.common import with_memory
from train.settings.presets import hyperparameters
from train.settings.reading import check_names, names_of, settings_with, typed
from train.settings.self_play import (
    LEARN,
    ROLES,
    LearningSide,
    SelfPlaySettings,
    default_rewards,
    self_play_ppo,
    unnested_sides,
)
from train.settings.task import TaskSettings

ALGORITHM = "algorithm"


def learning_side(role: str, task: TaskSettings, common: Plain, own: Plain) -> LearningSide:
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
    names = names_of(form)
    check_names(own, [ALGORITHM, *names], f" of the {role}'s algorithm {algorithm!r}")
    given = {name: value for name, value in common.items() if name in names}
    if common.get("gamma_end") is not None and "gamma_end" not in names:
        given["gamma"] = common["gamma_end"]  # both sides end with the same discount
    given |= {name: value for name, value in own.items() if name != ALGORITHM}
    hyper: Hyperparameters = default
    if algorithm != "ppo":
        tuned = hyperparameters(algorithm, profile_of(replace(task, role=role)))
        same: Plain = {"gamma": default.gamma, "gamma_end": None, "recurrent": None}
        hyper = replace(tuned, **{name: same[name] for name in same if name in names})
    return LearningSide(algorithm, settings_with(form, given, vars(hyper)))


def checked_names(names: Iterable[str]) -> None:
    """ValueError for a setting of one side in its former form, such as chaser_batch_size."""
    for name in names:
        role, _, rest = name.partition("_")
        if role in ROLES and rest:
            option = f"--{role}.{rest.replace('_', '-')}"
            check(False, f"unknown setting {name!r}; give {role}.{rest} (as an option {option})")


def unchecked_self_play(**flat: Any) -> SelfPlaySettings:
    """As `self_play_settings_of`, without the checks that build the task and the policies."""
    flat = with_memory(unnested_sides(flat))
    checked_names(flat)
    task = settings_with(TaskSettings, flat, {"rewards": default_rewards(flat)})
    own: dict[str, Plain] = {role: {} for role in ROLES}
    common: Plain = {}
    shared = {*names_of(TaskSettings, SelfPlaySettings), *ROLES}
    for name, value in flat.items():
        role, dot, rest = name.partition(".")
        if dot and role in ROLES:
            own[role][rest] = value
        elif name not in shared:
            common[name] = value
    sides: Plain = {}
    known = {ALGORITHM, *shared}
    for role in ROLES:
        fixed = flat.get(role, LEARN)
        check(isinstance(fixed, str), f"{role}={fixed!r}; give a name, or a table of settings")
        if fixed == LEARN:
            try:
                sides[role] = learning_side(role, task, common, own[role])
            except ValueError as error:
                raise ValueError(f"{role}: {error}") from None
            known |= set(names_of(type(sides[role].hyper)))
        else:
            sides[role] = fixed
            given = ", ".join(f"{role}.{name}" for name in own[role])
            check(not given, f"{given} with {role}={fixed!r}, which does not learn; leave it out")
    check_names(common, known, " of self-play")
    return SelfPlaySettings(task=task, **sides, **typed(SelfPlaySettings, flat))
