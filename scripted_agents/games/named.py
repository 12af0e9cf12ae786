"""Games by name: shipped ones, those of OpenSpiel, and user-defined ones."""

from __future__ import annotations

import ast
import re
from functools import lru_cache
from inspect import signature
from pkgutil import resolve_name
from typing import Any

from pursuit.plugins import OPENSPIEL, Registry, accepts
from pursuit.validation import check, shortened
from scripted_agents.games.encoding import mended
from scripted_agents.games.enumeration import enumerate_game
from scripted_agents.games.game import Game
from scripted_agents.games.library import SHIPPED
from scripted_agents.games.openspiel_optional import openspiel_game
from scripted_agents.games.small_game import KEPT, SmallGame

GAMES: Registry[Any] = Registry(
    "game",
    "a class or function that returns a Game (players, starts, legal_actions, transitions) or a "
    "SmallGame",
    callable,
    ours=tuple(SHIPPED),
)
"""Shipped and user-defined games."""


def split_name(text: str) -> tuple[str, str]:
    """ "module:Name" and "size=4" from "module:Name(size=4)"; without parentheses no arguments."""
    found = re.fullmatch(r"\s*([^()\s]+)\s*(?:\((.*)\))?\s*", str(text), re.DOTALL)
    if found is None:
        raise ValueError(
            f"game={shortened(text)}; give a name, as soccer, openspiel:tic_tac_toe or "
            "module:Name, with arguments in parentheses: goofspiel(cards=4)"
        )
    return found[1], found[2] or ""


def arguments_of(text: str, given: str) -> dict[str, Any]:
    """The keyword arguments in "size=4, kind=open"; a bare word is a text.

    Raises:
        ValueError: something else than name=value with numbers, texts, True, False or None.
    """
    rule = (
        f"game={shortened(text)}; give arguments as name=value, each once, with numbers and texts "
        "(in quotes unless a word), in one pair of parentheses"
    )
    values: dict[str, Any] = {}
    try:
        call: Any = ast.parse(f"f({given})", mode="eval").body
        one = isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
        check(one and not call.args, rule)
        for each in call.keywords:
            word = each.value.id if isinstance(each.value, ast.Name) else None
            value = ast.literal_eval(each.value) if word is None else word
            check(each.arg is not None and each.arg not in values, rule)
            values[each.arg] = {"true": True, "false": False}.get(word or "", value)
    except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError):
        raise ValueError(rule) from None
    return values


def game_key(text: str) -> tuple[object, ...]:
    """Equal for names of one game: without spaces and the order of arguments, and with defaults; of
    OpenSpiel's games without spaces only.

    Raises:
        ValueError: as `game_named`.
    """
    name, given = split_name(text)
    if name.startswith(OPENSPIEL):
        return ("".join(str(text).split()),)
    make, values = maker_of(name), arguments_of(text, given)
    defaults = {key: each.default for key, each in signature(make).parameters.items()}
    return (name, *sorted((key, repr(value)) for key, value in {**defaults, **values}.items()))


def maker_of(name: str) -> Any:
    """The class or function of a shipped or user-defined game; ValueError if there is none."""
    return resolve_name(f"pursuit.{SHIPPED[name]}") if name in SHIPPED else GAMES.get(name)


@lru_cache(maxsize=KEPT)
def game_named(text: str) -> Game | SmallGame:
    """The game of this name, enumerated only if its function does that; see `load_game`.

    Raises:
        ValueError: an unknown name, arguments that it does not accept, or no `Game`.
    """
    name, given = split_name(text)
    if name.startswith(OPENSPIEL):
        return openspiel_game(str(text).strip().removeprefix(OPENSPIEL))
    values = arguments_of(text, given)
    make = maker_of(name)
    check(
        accepts(make, **values),
        f"game={shortened(text)}: {name} does not accept the arguments {shortened(given)}; see its "
        "documentation",
    )
    with mended(f"game={shortened(text)}"):
        game = make(**values)
    check(
        isinstance(game, Game | SmallGame) and not isinstance(game, type),
        f"game={shortened(text)} is {shortened(game)}; it must be {GAMES.needs}",
    )
    return game


@lru_cache(maxsize=KEPT)
def load_game(text: str) -> SmallGame:
    """A game by name, enumerated; one object for equal names.

    Args:
        text: the name of a shipped game ("soccer"), of a game of OpenSpiel
            ("openspiel:tic_tac_toe"), or of a class or function that returns a `Game`
            ("package.module:Name"); with keyword arguments in parentheses, "goofspiel(cards=4)".

    Raises:
        ValueError: an unknown name, arguments that it does not accept, no `Game`, or one that
            cannot be enumerated, as its functions raise exceptions.
    """
    game = game_named(text)
    if isinstance(game, SmallGame):
        return game
    with mended(f"game={shortened(text)}"):
        return enumerate_game(game, progress=True)
