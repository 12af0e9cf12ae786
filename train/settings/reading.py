"""Settings from mappings: keyword arguments, the tables of a sweep file, those of `config.json`."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from difflib import get_close_matches
from typing import Any, TypeVar, get_type_hints

import msgspec

from train.settings.checks import check, rules_of
from train.settings.common import RunSettings

Form = TypeVar("Form")

TYPES = {
    "tuple": "a list of texts",
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
}
"""The types of settings, as messages call them; the first that fits."""
INNER = frozenset({"task", "hyper", "lessons", "chaser_hyper", "evader_hyper"})
"""Settings of a run that are settings themselves."""


def names_of(*forms: type[Any]) -> list[str]:
    """The names of the settings of these dataclasses that are values."""
    return [
        field.name
        for form in forms
        for field in fields(form)
        if not (field.name in INNER and issubclass(form, RunSettings))
    ]


def check_names(given: Iterable[str], known: Iterable[str], where: str = "") -> None:
    """ValueError for a name that is not known, with the nearest that is."""
    names = sorted(known)
    for name in given:
        close = get_close_matches(name, names, 1)
        check(
            name in names,
            f"unknown setting {name!r}{where}"
            + (f"; did you mean {close[0]!r}?" if close else f"; one of {', '.join(names)}"),
        )


def typed(form: type[Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Those of `given` that `form` has, as values of the types of its fields.

    Raises:
        ValueError: a value of another type.
    """
    hints = get_type_hints(form)
    found = {}
    for name in (name for name in names_of(form) if name in given):
        value, hint = given[name], hints[name]
        if not any(rule.other_types for rule in rules_of(form, name)):
            try:
                value = msgspec.convert(value, hint)
            except (msgspec.ValidationError, OverflowError):
                word = next(word for kind, word in TYPES.items() if kind in str(hint))
                raise ValueError(f"{name}={shortened(value)}; {word} is needed") from None
        found[name] = value
    return found


def shortened(value: Any) -> str:
    """A value as messages show it."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def picked(form: type[Form], given: Mapping[str, Any], default: Mapping[str, Any]) -> Form:
    """A `form` of those of `given` that it has, over `default`; ValueError as `typed`."""
    return form(**{**default, **typed(form, given)})


def whole(form: type[Any], given: Any, name: str = "") -> dict[str, Any]:
    """All settings of `form` that are values, from a table that has these and no others.

    Args:
        form: a dataclass.
        given: the table.
        name: of the table, in messages.

    Raises:
        ValueError: no table, a setting missing or unknown, or a value of another type.
    """
    check(isinstance(given, Mapping), f"{name}={shortened(given)}; a table is needed")
    names = names_of(form)
    own = {key: value for key, value in given.items() if name or key not in INNER}
    missing = next((known for known in names if known not in own), None)
    where = f" of {name}" if name else ""
    check(missing is None, f"setting {missing!r}{where} is missing")
    check_names(own, names, where)
    return typed(form, own)


@contextlib.contextmanager
def read_from(where: object, remedy: str) -> Iterator[None]:
    """What is wrong inside is told of the file `where`, with what a person can do."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{where}: {error}; {remedy}") from None
