"""Validation of the content of files against schemas.

A schema is a `msgspec.Struct`, a dataclass, or any type that `msgspec.convert` supports. Errors are
one line with file, field and remedy.
"""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import msgspec

from pursuit.plugins import reading
from pursuit.validation import did_you_mean

Form = TypeVar("Form")

WORDS = {
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "str": "a string",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
    "bytes": "bytes",
}
_MISMATCH = re.compile(r"^Expected `(?P<wanted>[^`]*)`(?: of length [^,]*)?, got `(?P<got>[^`]*)`")
_PLACE = re.compile(r" - at `(?P<place>[^`]*)`$")


def read_as(form: type[Form], content: object, where: object, remedy: str) -> Form:
    """`content` as a `form`.

    Args:
        form: the schema; dataclasses need every field without a default, and allow no others.
        content: plain values: dicts, lists, strings, numbers.
        where: the file, for messages.
        remedy: what the user can do, the end of every message.

    Raises:
        ValueError: a field is missing, unknown, of another type, or refused by the schema; code
            that is not allowed.
    """
    try:
        with reading(where):  # a dataclass may look its values up
            made: Form = msgspec.convert(content, form)
    except msgspec.ValidationError as error:
        raise ValueError(f"{where}: {_in_words(str(error), form)}; {remedy}") from None
    if is_dataclass(form) and isinstance(content, dict):
        known = [field.name for field in fields(form)]
        for name in content:
            if name not in known:
                near = did_you_mean(name, known)
                raise ValueError(f"{where}: unknown field {name!r}{near}; {remedy}")
    return made


def _in_words(message: str, form: Any) -> str:
    """msgspec's message without Python types, and with the field first."""
    place = _PLACE.search(message)
    text = message[: place.start()] if place else message
    field = re.sub(r"^\$\.?", "", place["place"]).replace("[...]", "[]") if place else ""
    mismatch = _MISMATCH.match(text)
    if mismatch:
        wanted = " or ".join(_word(part) for part in mismatch["wanted"].split(" | "))
        text = f"{wanted} expected, {_word(mismatch['got'])} found"
    text = re.sub(r"^Object missing required field `(.*)`$", r"field '\1' is missing", text)
    if name := re.match(r"^Object contains unknown field `(.*)`$", text):
        near = did_you_mean(name[1], _names_in(msgspec.inspect.type_info(form)))
        text = f"unknown field {name[1]!r}{near}"
    return f"field {field}: {text}" if field else text


def _names_in(form: Any) -> list[str]:
    """The names of all fields of a schema, including nested ones."""
    own = getattr(form, "fields", ())
    inner = [field.type for field in own] + list(getattr(form, "types", ()))
    inner += [getattr(form, n) for n in ("item_type", "value_type") if hasattr(form, n)]
    return [field.encode_name for field in own] + [n for each in inner for n in _names_in(each)]


def _word(kind: str) -> str:
    return WORDS.get(kind.strip(), kind.strip())
