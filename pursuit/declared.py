"""Fields of frozen dataclasses that say beside them what they may hold, checked at birth.

    @dataclass(frozen=True)
    class Settings:
        steps: int = count(1, default=200)
        order: str = choice(("first", "last"), default="first")

        def __post_init__(self) -> None:
            check_fields(self)

A check takes the field's name and the value given, and returns the value as it is kept; its
ValueError names the value, the rule and the remedy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field, fields
from math import isfinite
from typing import Any, NoReturn, TypeVar

import numpy as np

Key = TypeVar("Key")
Value = TypeVar("Value")
Check = Callable[[str, Any], Any]


def declared(check: Check, default: Any) -> Any:
    """A field with a check of its own."""
    return field(default=default, metadata={"check": check})


def count(least: int, default: int) -> Any:
    """A field for a whole number from `least` to 2**31 - 1."""

    def check(name: str, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
            raise ValueError(f"{name}={value!r}; it is a whole number")
        if not least <= value < 2**31:
            raise ValueError(f"{name}={value}; it is at least {least}")
        return int(value)

    return declared(check, default)


def finite(default: float) -> Any:
    """A field for a finite number."""

    def check(name: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise ValueError(f"{name}={value!r}; it is a number")
        if not isfinite(value):
            raise ValueError(f"{name}={value}; it is finite")
        return float(value)

    return declared(check, default)


def flag(default: bool) -> Any:
    """A field for True or False."""

    def check(name: str, value: Any) -> bool:
        if not isinstance(value, (bool, np.bool_)):
            raise ValueError(f"{name}={value!r}; it is True or False")
        return bool(value)

    return declared(check, default)


def choice(choices: Sequence[str], default: str) -> Any:
    """A field for one of `choices`."""
    return declared(lambda name, value: one_of(name, value, choices), default)


def one_of(what: str, value: Any, choices: Sequence[str]) -> Any:
    """`value`, if it is one of `choices`; ValueError otherwise."""
    if value not in choices:
        raise ValueError(f"unknown {what} {value!r}; one of {', '.join(choices)}")
    return value


def check_fields(settings: Any) -> None:
    """Check every declared field of a frozen dataclass, and keep what its check returns."""
    for each in fields(settings):
        if "check" in each.metadata:
            kept = each.metadata["check"](each.name, getattr(settings, each.name))
            object.__setattr__(settings, each.name, kept)


class FrozenDict(dict[Key, Value]):
    """A dict that never changes, and hashes by its content."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)

    def _refuse(self, *args: Any, **kwargs: Any) -> NoReturn:
        raise TypeError("this dict never changes; take dict(it) for one that does")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse
