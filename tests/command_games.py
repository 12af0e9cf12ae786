"""A game with known answers, a learner, and wrong games and policies, for tests of commands."""

from __future__ import annotations

from typing import Any

import numpy as np
from small_games import Doors

from train.algorithms.registry import entry


class Commons:
    """Players contribute 1 or nothing; all share twice the sum equally. One step."""

    players = ("a", "b", "c")

    def starts(self) -> Any:
        return [(1.0, "only")]

    def legal_actions(self, state: Any, player: int) -> Any:
        return (0, 1)

    def transitions(self, state: Any, actions: Any) -> Any:
        rewards = [2.0 * sum(actions) / 3.0 - own for own in actions]
        return [(1.0, state, rewards, True)]


LEARNER = entry("a2c")
"""A user-defined learner."""


class Seen(Doors):
    """With an `observe` that returns something else than arrays of one shape."""

    def __init__(self, what: str) -> None:
        self.what = what

    def observe(self, state: Any, player: int) -> Any:
        if self.what == "raises":
            raise KeyError(state)
        found = {"shapes": [1.0] * (1 + state[2]), "nan": [np.nan], "empty": [], "text": ["a"]}
        return found[self.what]


class Hop(Doors):
    """Other actions in the same states."""

    def legal_actions(self, state: Any, player: int) -> Any:
        return ("wait", "go", "hop")


class Raises(Doors):
    def legal_actions(self, state: Any, player: int) -> Any:
        raise IndexError("two\nlines")


class Unordered(Doors):
    """Its actions can have another order in every process."""

    def legal_actions(self, state: Any, player: int) -> Any:
        return {"wait", "go"}


class Large:
    """Its first state has 4 * 10**12 joint actions."""

    players = ("a", "b")

    def starts(self) -> Any:
        return [(1.0, 0)]

    def legal_actions(self, state: Any, player: int) -> Any:
        return range(2_000_000)

    def transitions(self, state: Any, actions: Any) -> Any:
        raise NotImplementedError


class Silent(tuple[Any, ...]):
    """A state without a text."""

    __slots__ = ()

    def __repr__(self) -> str:
        raise RuntimeError("no text")


class Undrawn(Doors):
    """Its first states are drawn, later ones raise; the states of `Silent` have no text either."""

    def __init__(self, silent: bool = False) -> None:
        self.state = Silent if silent else tuple

    def starts(self) -> Any:
        return [(chance, self.state(state)) for chance, state in super().starts()]

    def transitions(self, state: Any, actions: Any) -> Any:
        later = super().transitions(state, actions)
        return [(chance, self.state(after), *rest) for chance, after, *rest in later]

    def draw(self, state: Any) -> str:
        if state[2] == 1:
            raise KeyError(state[0])
        return super().draw(state)


class Named(Doors):
    """With a player whose name is a setting, or no word."""

    def __init__(self, name: str) -> None:
        self.players = (name, "thief")  # type: ignore[assignment]


def go(state: Any) -> Any:
    """Policies of `Doors`: a right one, and wrong ones."""
    return {"go": 1.0}


def half(state: Any) -> Any:
    return {"go": 0.5}


def flies(state: Any) -> Any:
    return {"fly": 1.0}


def fails(state: Any) -> Any:
    raise ZeroDivisionError("no\npolicy")


def one(state: Any) -> Any:
    """A policy of `Nim`: take one."""
    return {None: 1.0} if state[1] == 0 else {1: 1.0}


class Alone(Commons):
    """Of one player."""

    players = ("a",)  # type: ignore[assignment]
