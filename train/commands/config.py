"""Settings in TOML files: `--config` reads one, `--print-config` prints one."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from pursuit.plugins import reading
from pursuit.validation import check, shortened
from train.commands.help import grouped, values_in
from train.commands.parse import names_in, options_in, take_allow_options
from train.files import read_toml
from train.runs.unused_settings import (
    check_unused_settings,
    resolved_settings,
    unused_settings,
)
from train.settings.groups import GROUPS
from train.settings.reading import read_from
from train.settings.self_play import WholeSettings, unnested_sides

T = TypeVar("T")
OF_ONE_COMMAND = ("out", "resume", "stretch", "config", "print_config")
"""Options that files do not hold."""
BUDGET = {"seconds", "frames"}
LISTED_AS_TEXT = ("exits", "log", "curriculum_mazes")
"""Options that take several values as one text with commas."""


def with_config(arguments: Sequence[str], parsed: Callable[[Sequence[str]], T]) -> T:
    """What `parsed` makes of the arguments after those in the file of --config.

    Raises:
        ValueError: as `parsed`, with the name of the file if its content alone is wrong.
    """
    name = options_in(arguments).get("config")
    if not name:
        return parsed(arguments)
    path, given = Path(name), take_allow_options(arguments)
    with reading(path):
        own, alone = (arguments_in(path, names) for names in (names_in(given), ()))
        try:
            return parsed([*own, *given])
        except ValueError as error:
            with read_from(path, "correct this file"):
                parsed(alone)
            raise ValueError(f"{error}; these options do not fit the settings in {path}") from None


def arguments_in(path: Path, given: Collection[str]) -> list[str]:
    """The settings in a TOML file as arguments, without those that the given options replace."""
    content, found = read_toml(path, "--print-config prints such a file"), list[str]()
    tables = [name for name, value in content.items() if isinstance(value, Mapping)]
    replaced = {*given} | (BUDGET if BUDGET & {*given} else set())
    for name, value in unnested_sides(content, tables).items():
        side, dot, own = name.rpartition(".")
        check(name not in OF_ONE_COMMAND, f"{path}: {name} is for the command line; leave it out")
        if not replaced.isdisjoint((name, own, side)):
            continue
        words = value if isinstance(value, list) else [value]
        kinds = {type(each) for each in words}
        check(
            kinds <= {str, int, float} or isinstance(value, bool),
            f"{path}: {name} = {shortened(value)}; give text, a number, true, false, or a list",
        )
        if name in LISTED_AS_TEXT:
            words = [",".join(map(str, words))]
        flag = f"--{side}{dot}{'' if value else 'no_'}{own}"
        found += [flag] if isinstance(value, bool) else [f"--{name}", *map(str, words)]
    return found


def print_config(settings: WholeSettings, given: Any, default: Any, sides: Any = ()) -> NoReturn:
    """Print the settings of a run in the form that --config reads, and exit.

    Args:
        settings: of the run.
        given, default: the command, and that without options.
        sides: of self-play (role, `LearningSide`, its default) of those that learn.

    Raises:
        ValueError: a setting without effect.
    """
    check_unused_settings(settings)
    resolved = resolved_settings(settings)
    hidden = {*OF_ONE_COMMAND, "players", *unused_settings(settings)}
    defaults, tables = values_in(default), []
    for role, *pair in sides:
        own, usual = ({"algorithm": side.algorithm, **vars(side.hyper)} for side in pair)
        tables += ["", f"[{role}]", *(row(name, own[name], usual[name], own[name]) for name in own)]
        hidden |= {role, *own, "opponent", settings.task.AGENT}

    def line(form: Any, name: str, value: Any) -> str:
        return row(name, value, defaults[name], resolved.get(name, value))

    lines = [*grouped(given, hidden, line), *tables]
    print("# For --config; options on the command line take precedence.")
    print(*(f"\n# {each}" if each in GROUPS else each for each in lines), sep="\n")
    sys.exit(0)


def row(name: str, value: Any, default: Any, shown: Any) -> str:
    """A line of the file: the value, or what it means in this run, with a comment at a default;
    a comment alone where that is None. Options take "None" for None."""
    mark = "" if value != default else "  # default" if shown == value else f"  # default: {value}"
    if shown is None:
        return f"# {name}: None{mark}" if mark else f'{name} = "None"'
    text = repr(shown) if isinstance(shown, float) else json.dumps(shown, ensure_ascii=False)
    return f"{name} = {text}{mark}"
