"""The help of commands: of those that train first the options that most need, else all."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, NoReturn, get_args, get_origin, get_type_hints

import tyro
from docstring_parser import parse_from_object

from pursuit.plugins import ALLOW
from train.settings.groups import GROUPS, group_of
from train.settings.self_play import LEARN

COLUMN = 28
"""Where the texts of options begin."""
UNSAID = ("", "None", "False")
"""Defaults that go without saying."""
METAVARS = {int: " INT", float: " FLOAT", Path: " PATH", bool: ""}
ALLOW_TEXT = f"""Allow files (of runs, sweeps, models) to name user-defined parts of this module;
can be repeated; {ALLOW}=MODULE,OTHER does the same."""


Line = Callable[[Any, str, Any], str]
"""(dataclass, name, value) -> the line of an option, "" for none."""


def asks_help(arguments: Sequence[str]) -> bool:
    """Whether the arguments ask for the help."""
    return not {"-h", "--help", "--help-all"}.isdisjoint(arguments)


def print_help(prog: str, command: Any, given: Mapping[str, str], unused: Any = None) -> NoReturn:
    """Print the help of a command, and exit.

    Args:
        prog: its name.
        command: the dataclass with its options, or an instance with other defaults.
        given: options by name, whose values are shown in place of defaults.
        unused: settings without effect, of a command that trains; None of others, which have no
            short help.
    """
    short, usage = unused is not None and "help_all" not in given, [f"usage: pursuit {prog}"]

    def line(form: Any, name: str, value: Any) -> str:
        kind, more = hints_of(form)[name], hints_of(form, include_extras=True)[name]
        more = getattr(more, "__metadata__", ())
        text = next((own.help for own in more if hasattr(own, "help")), texts_of(form).get(name))
        if short:  # sides of self-play in small games are not in the table
            text = GROUPS[group_of(form, name)].get(name, "a fixed policy" * (value == LEARN))
        if tyro.conf.Suppress in more or (short and not text):
            return ""
        option = f"  --{name.replace('_', '-')}{metavar(kind)}"
        if tyro.conf.Positional in more:
            usage.append(metavar(kind).strip())
            option = f" {metavar(kind)}"
        elif kind is bool and not short:
            option += f", --no-{option[4:]}"
        value = given.get(name) or value
        shown = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
        return row(option, f"{text or ''}{'' if shown in UNSAID else f' [{shown}]'}")

    lines = [*grouped(command, unused or (), line)]
    about = described(command if isinstance(command, type) else type(command))
    print(*usage, "[OPTIONS]", end="\n\n")
    print(about.partition("\n\n")[0] if short else about, "", *lines, "", sep="\n")
    more = f"[value]: used without the option. All options: pursuit {prog} --help-all"
    print(more if short else row("  --allow MODULE", ALLOW_TEXT))
    sys.exit(0)


def grouped(command: Any, hidden: Collection[str], line: Line) -> Iterator[str]:
    """The lines of the options of a command, each group below its title.

    Args:
        command: the dataclass with its options, or an instance with other defaults.
        hidden: options that are left out.
        line: makes the line of an option.
    """
    rows = {title: dict.fromkeys(names, "") for title, names in GROUPS.items()}
    for part in parts_in(command):
        form = part if isinstance(part, type) else type(part)
        for name in (each.name for each in fields(form)):
            value = getattr(part, name, None)
            if not (is_dataclass(value) or name in hidden):
                rows[group_of(form, name)][name] = line(form, name, value)
    for title, own in rows.items():
        if any(own.values()):
            yield from (title, *filter(None, own.values()))


def parts_in(value: Any) -> Iterator[Any]:
    """A dataclass, or an instance of one, and its parts that are such."""
    if is_dataclass(value):
        yield value
        for each in fields(value):
            yield from parts_in(getattr(value, each.name, None))


def values_in(command: Any) -> dict[str, Any]:
    """The values of a command and its parts by name."""
    pairs = (pair for part in parts_in(command) for pair in vars(part).items())
    return {name: value for name, value in pairs if not is_dataclass(value)}


def metavar(kind: Any) -> str:
    """What stands for the values of an option of this type, after a space."""
    kinds = [*get_args(kind), kind]  # of an optional one and of a tuple the first
    if get_origin(kind) is tuple:
        return f"{metavar(kinds[0])} ..."
    return METAVARS.get(kinds[0], " STR")


hints_of: Any = cache(get_type_hints)


def row(option: str, text: str) -> str:
    """An option with its text, wrapped to the terminal."""
    indent, width = " " * COLUMN, shutil.get_terminal_size().columns
    begin = option.ljust(COLUMN) if len(option) < COLUMN - 1 else f"{option}\n{indent}"
    text = textwrap.fill(" ".join(text.split()), width - COLUMN, break_on_hyphens=False)
    return begin + text.replace("\n", f"\n{indent}")


@cache
def texts_of(form: type[Any]) -> dict[str, str | None]:
    """The docstrings of the fields of a dataclass."""
    bases = reversed(form.__mro__[:-1])
    return {own.arg_name: own.description for b in bases for own in parse_from_object(b).params}


def described(form: type[object]) -> str:
    """The docstring of a command, wrapped to the terminal."""
    if str(form.__doc__).startswith(f"{form.__name__}("):  # without docstrings, as by python -OO
        return ""
    width, parts = shutil.get_terminal_size().columns, re.split(r"\n\s*\n", str(form.__doc__))
    return "\n\n".join(textwrap.fill(" ".join(part.split()), width) for part in parts)
