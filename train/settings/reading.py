"""Settings from mappings: keyword arguments, tables of a sweep file, and `config.json`."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any, TypeGuard, TypeVar, get_args, get_type_hints

import msgspec

from pursuit.validation import check, did_you_mean, field_rules, plain, shortened
from train.files import Plain
from train.schemas import WORDS
from train.settings.common import RunSettings
from train.settings.groups import OTHER_NAMES

Form = TypeVar("Form")

TYPE_WORDS = {"tuple": "a list of strings", **WORDS}
"""The types of settings in messages; the first match is used."""
INNER = frozenset({"task", "hyper", "curriculum_settings", "chaser", "evader", "players"})
"""Fields of run settings that are themselves settings."""


def names_of(*forms: type[Any]) -> list[str]:
    """The names of the fields of these dataclasses that are plain values."""
    return [
        field.name
        for form in forms
        for field in fields(form)
        if not (field.name in INNER and issubclass(form, RunSettings))
    ]


def check_names(given: Iterable[str], known: Iterable[str], where: str = "") -> None:
    """ValueError for an unknown name, with the closest known one, or else with all of them."""
    names = sorted(known)
    for name in (each for each in given if each not in names):
        new = OTHER_NAMES.get(name)
        near = f"; give {new}" if new in names else did_you_mean(name, names)
        raise ValueError(
            f"unknown setting {name!r}{where}" + (near or f"; one of {', '.join(names)}")
        )


def plain_settings(flat: Mapping[str, object]) -> Plain:
    """Settings by name with the numbers of Python in place of NumPy's, and `frames` as a whole
    number if it is one, as 1e6: other defaults depend on it."""
    found: Plain = plain(dict(flat))
    frames = found.get("frames")
    return found | ({"frames": int(frames)} if is_whole_float(frames) else {})


def is_whole_float(value: object) -> TypeGuard[float]:
    """Whether it is a float that is exactly a whole number, as 1e6."""
    return isinstance(value, float) and value.is_integer() and abs(value) <= 2**53


def typed(form: Any, given: Mapping[str, object]) -> Plain:
    """Those entries of `given` that are fields of `form`, converted to the types of the fields.

    Raises:
        ValueError: a value of another type.
    """
    hints = get_type_hints(form)
    converted = {}
    for name in (name for name in names_of(form) if name in given):
        value, hint = given[name], hints[name]
        kinds = (hint, *get_args(hint))
        if is_whole_float(value) and int in kinds and float not in kinds:
            value = int(value)  # 1e6
        if not any(rule.other_types for rule in field_rules(form)[name]):
            try:
                value = msgspec.convert(value, hint)
            except (msgspec.ValidationError, OverflowError):
                word = next(word for kind, word in TYPE_WORDS.items() if kind in str(hint))
                if callable(value):  # settings are saved, so they hold names
                    word = f"its name, 'package.module:{getattr(value, '__name__', 'Name')}'"
                raise ValueError(f"{name}={shortened(value)}; give {word}") from None
        converted[name] = value
    return converted


def settings_with(
    form: type[Form], given: Mapping[str, object], default: Mapping[str, object]
) -> Form:
    """A `form` with `default` values, overridden by `given`; ValueError as `typed`."""
    return form(**{**default, **typed(form, given)})


def complete_settings(form: type[Any], given: Any, name: str = "") -> Plain:
    """All plain fields of `form`, from a table that has exactly these.

    The names in `form.ADDED`, which older versions did not write, may be missing; those in
    `form.REMOVED`, which only older versions wrote, are left out.

    Args:
        form: a class of settings.
        given: the table.
        name: of the table, in messages.

    Raises:
        ValueError: not a table, a missing or unknown setting, or a value of another type.
    """
    check(isinstance(given, Mapping), f"{name}={shortened(given)}; give a table")
    names = names_of(form)
    own: Plain = {added: getattr(form, added) for added in form.ADDED}
    left_out = {*form.REMOVED} if name else {*form.REMOVED, *INNER}
    own |= {key: value for key, value in given.items() if key not in left_out}
    missing = next((known for known in names if known not in own), None)
    where = f" of {name}" if name else ""
    check(missing is None, f"setting {missing!r}{where} is missing")
    check_names(own, names, where)
    return typed(form, own)


@contextlib.contextmanager
def read_from(where: object, remedy: str) -> Iterator[None]:
    """Prefix errors raised inside with the file `where`, and append the remedy."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{where}: {error}; {remedy}") from None
