"""The settings of self-play from names and values; imported without torch by the command line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from keyword import iskeyword
from typing import Any

from pursuit.validation import check, shortened
from scripted_agents.environments import agent_name
from scripted_agents.games.enumeration import names_of_players
from scripted_agents.games.named import game_named
from scripted_agents.games.small_game import KEPT
from train.files import Plain
from train.runs.tasks import discount_of, profile_of
from train.settings.algorithms import TUNED_AS, Hyperparameters, hyperparameter_form
from train.settings.common import with_memory
from train.settings.presets import hyperparameters
from train.settings.reading import check_names, names_of, plain_settings, settings_with, typed
from train.settings.self_play import (
    LEARN,
    ROLES,
    LearningSide,
    PlayedTask,
    SelfPlayBase,
    SelfPlaySettings,
    SmallGameSelfPlay,
    default_rewards,
    self_play_ppo,
    unnested_sides,
)
from train.settings.task import SmallGameSettings, TaskSettings, task_form

ALGORITHM = "algorithm"
LONGEST = 60
"""Letters of the name of a player."""


def learning_side(role: str, task: PlayedTask, common: Plain, own: Plain) -> LearningSide:
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
    if isinstance(task, SmallGameSettings):
        default = replace(default, gamma=discount_of(task), gamma_end=None)
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
        tuned = hyperparameters(algorithm, profile_of(with_role(task, role)))
        same: Plain = {"gamma": default.gamma, "gamma_end": None, "recurrent": None}
        hyper = replace(tuned, **{name: same[name] for name in same if name in names})
    return LearningSide(algorithm, settings_with(form, given, vars(hyper)))


def with_role(task: PlayedTask, role: str) -> PlayedTask:
    """The settings of a game in which one role learns."""
    if isinstance(task, SmallGameSettings):
        return replace(task, player=role)
    return replace(task, role=role)


def checked_names(names: Iterable[str]) -> None:
    """ValueError for a setting of one side in its former form, such as chaser_batch_size."""
    for name in names:
        role, _, rest = name.partition("_")
        if role in ROLES and rest:
            option = f"--{role}.{rest.replace('_', '-')}"
            check(False, f"unknown setting {name!r}; give {role}.{rest} (as an option {option})")


def unchecked_self_play(**flat: Any) -> SelfPlayBase:
    """As `self_play_settings_of`, without the checks that build the task and the policies."""
    small = task_form(flat) is SmallGameSettings
    flat = with_memory(plain_settings(flat))
    task: PlayedTask
    form: type[SelfPlayBase]
    if small:
        task, form = settings_with(SmallGameSettings, flat, {}), SmallGameSelfPlay
        roles = players_of(task)
    else:
        task = settings_with(TaskSettings, flat, {"rewards": default_rewards(flat)})
        form, roles = SelfPlaySettings, ROLES
    flat = unnested_sides(flat, roles)
    if not small:
        checked_names(flat)
    own: dict[str, Plain] = {role: {} for role in roles}
    common: Plain = {}
    shared = {*names_of(type(task), form), *roles}
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
    given_sides: Plain = {"players": sides} if small else sides
    make: Any = form
    return make(task=task, **given_sides, **typed(form, flat))


@lru_cache(maxsize=KEPT)
def _players_named(game: str) -> tuple[str, ...]:
    return names_of_players(game_named(game))


def players_of(task: SmallGameSettings) -> tuple[str, ...]:
    """The players of a small game, which is not enumerated.

    Raises:
        ValueError: no such game, or a player with the name of a setting, or none that is a word.
    """
    players = _players_named(task.game)
    settings = {*names_of(SmallGameSettings, SmallGameSelfPlay), ALGORITHM}
    for name in players:
        check(
            name.isidentifier()
            and not iskeyword(name)
            and name not in settings
            and len(name) <= LONGEST,
            f"game={shortened(task.game)}: a player is called {shortened(name)}; rename it to a "
            f"word of at most {LONGEST} letters that is not the name of a setting, as options and "
            "folders have the names of players",
        )
    return players
