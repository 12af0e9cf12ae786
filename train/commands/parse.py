"""Parsing of options into dataclasses with tyro, with one-line errors."""

from __future__ import annotations

import contextlib
import io
import re
import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import Any, NoReturn, TypeVar, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec

from pursuit.plugins import allow
from pursuit.validation import check
from train.commands.help import asks_help, parts_in, print_help, values_in
from train.files import Plain
from train.settings.groups import OTHER_NAMES

Form = TypeVar("Form")
AGENT_OPTIONS = ("--line-of-sight", "--unknown-maze")
"""Options that name agents; without a value they mean all agents."""


def fail(message: str, status: int = 2) -> NoReturn:
    """Print one line on stderr, and exit with this status."""
    print(f"pursuit: error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(status)


@contextlib.contextmanager
def warnings_in_lines() -> Iterator[None]:
    """Print each different warning for the user, and of NumPy, as one line on stderr."""
    said = set[str]()

    def show(
        message: Any, category: Any, filename: str, lineno: int, *rest: Any, **more: Any
    ) -> None:
        text = " ".join(str(message).split())
        if issubclass(category, RuntimeWarning):
            text += f" ({Path(filename).name}:{lineno})"
        elif not issubclass(category, UserWarning):
            others(message, category, filename, lineno, *rest, **more)
            return
        if text not in said:
            said.add(text)
            warn(text)

    with warnings.catch_warnings():
        others, warnings.showwarning = warnings.showwarning, show
        warnings.simplefilter("always", UserWarning)
        yield


def warn(text: str) -> None:
    """Print a warning as one line on stderr."""
    print(f"pursuit: warning: {text}", file=sys.stderr)


def options_in(arguments: Sequence[str]) -> dict[str, str]:
    """The last value of each option in the arguments, by its Python name; "" without a value.

    For options that determine the other options, before `parse`, which reports errors.
    """
    found: dict[str, str] = {}
    name = ""
    for argument in arguments:
        if argument.startswith("--"):
            option, _, value = argument[2:].partition("=")
            name = option.replace("-", "_")
            found[name] = value
        elif name:
            found[name] = found[name] or argument
    return found


def names_in(arguments: Sequence[str]) -> set[str]:
    """The names of the options in the arguments, those of flags also without "no_"."""
    return {name.removeprefix("no_") for name in options_in(arguments)} | {*options_in(arguments)}


def default_budget(options: Mapping[str, str], seconds: float) -> Plain:
    """The default budget: `seconds`, or a placeholder for frames if --frames is given."""
    return {"frames": 1} if "frames" in options else {"seconds": seconds}


def take_allow_options(arguments: Sequence[str]) -> list[str]:
    """The arguments without every --allow MODULE; these modules are allowed from now on.

    Raises:
        ValueError: --allow without a module name.
    """
    rest, given = [], iter(arguments)
    for argument in given:
        name, equals, value = argument.partition("=")
        if name == "--allow":
            allow(value if equals else next(given, ""))
        else:
            rest.append(argument)
    return rest


def add_all(arguments: Sequence[str]) -> list[str]:
    """The arguments, with "all" after options of `AGENT_OPTIONS` without a value."""
    found: list[str] = []
    for argument, after in zip(arguments, [*arguments[1:], "--"], strict=False):
        found.append(argument)
        if argument.replace("_", "-") in AGENT_OPTIONS and after.startswith("--"):
            found.append("all")
    return found


def whole_number(text: str) -> int:
    """The whole number of a text, as 1000 or 1e3; ValueError for others."""
    try:
        return int(text)
    except ValueError:
        with contextlib.suppress(ValueError, OverflowError):
            if (value := float(text)) == int(value):
                return int(value)
        raise


NO_PATH = "'': give a path"


def path_of(text: str) -> Path:
    """The path of a text; ValueError for an empty one, which would be the present folder."""
    check(text != "", NO_PATH)
    return Path(text)


PRIMITIVES = ConstructorRegistry()
"""How texts become whole numbers and paths."""


def _read_by(kind: type[Any], metavar: str, read: Callable[[str], Any]) -> None:
    form = PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda texts: read(texts[0]),
        is_instance=lambda value: isinstance(value, kind),
        str_from_instance=lambda value: [str(value)],
    )
    PRIMITIVES.primitive_rule(lambda given: form if given.type is kind else None)


_read_by(int, "INT", whole_number)
_read_by(Path, "PATH", path_of)
read_options: Any = partial(
    tyro.cli,
    config=(
        tyro.conf.OmitArgPrefixes,
        tyro.conf.HelptextFromCommentsOff,
        tyro.conf.AvoidSubcommands,  # the default determines the form of the task
    ),
    registry=PRIMITIVES,
)


def is_instance(typ: Any, value: Any) -> bool:
    """Whether a default value fits the type of its field: in place of tyro's function, which for
    `int | None` imports typeguard, and that asyncio, longer than all else that tyro does."""
    origin = get_origin(typ)
    if origin is UnionType:
        return any(is_instance(each, value) for each in get_args(typ))
    return typ is Any or tyros_is_instance(origin if isinstance(origin, type) else typ, value)


RESOLVER: Any = getattr(tyro, "_resolver", tyro)  # as of the versions of tyro so far
tyros_is_instance: Callable[[Any, Any], bool] = getattr(RESOLVER, "is_instance", isinstance)
RESOLVER.is_instance = is_instance


def hide_help_texts(command: Any) -> None:
    """Empty help texts of the fields of dataclasses: for the message of an error tyro reads the
    docstrings of all fields without a text. It prints those of required options."""
    for each in (each for part in parts_in(command) for each in fields(part)):
        if each.default is not MISSING or each.default_factory is not MISSING:
            each.metadata = MappingProxyType({**each.metadata, "help": ""})


def parse(
    form: type[Form], arguments: Sequence[str], prog: str, default: Form | None = None
) -> Form:
    """`arguments` as the dataclass `form`, parsed by tyro; its error boxes become one line.

    Raises:
        ValueError: options that the form does not have, or values that are not allowed.
    """
    args = add_all(take_allow_options(arguments))
    boxed = io.StringIO()
    extra: Plain = {} if default is None else {"default": default}
    own: Any = get_origin(form) or form
    if asks_help(args):
        print_help(prog, default or own, options_in(args))
    hide_help_texts(default or own)
    try:
        with contextlib.redirect_stderr(boxed):
            return read_options(form, args=args, prog=f"pursuit {prog}", **extra)
    except SystemExit:
        message = tyro_message(boxed.getvalue(), values_in(default))
        raise ValueError(f"{message} (see pursuit {prog} --help)") from None


def parse_known(default: Form, arguments: Sequence[str]) -> Form:
    """Those of `arguments` that the dataclass of `default` has; `default` if one is wrong.

    For options that determine the other options; `parse` reports errors.
    """
    args = [argument for argument in arguments if not asks_help([argument])]
    hide_help_texts(default)
    how: Plain = {"args": args, "default": default, "return_unknown_args": True}
    with contextlib.suppress(SystemExit, ValueError), contextlib.redirect_stderr(io.StringIO()):
        return read_options(type(default), **how)[0]
    return default


def tyro_message(boxed: str, names: Collection[str]) -> str:
    """tyro's error box as one line, without Python types, for options of these names."""
    text = re.sub(r"\x1b\[[0-9;]*m|[─╭╮╰╯│]+|-{5,}", " ", boxed)
    text = " ".join(text.split("For full helptext")[0].split())
    kinds = "Value error|Parsing error|Unrecognized options|Required options|Missing argument"
    text = re.sub(rf"^({kinds})\s*", "", text)
    if text.startswith("Error parsing [[PATH"):  # several paths, of which one is empty
        return NO_PATH
    text = re.sub(r"Error parsing \S+: ", "", text)
    if unknown := re.match(r"Unrecognized options: --([\w.-]+)", text):
        name = unknown[1].replace("-", "_")
        near = [OTHER_NAMES.get(name), *get_close_matches(name, names, 1)]
        if meant := next((each for each in near if each in names), None):
            text = f"{unknown[0]} Perhaps you meant --{meant.replace('_', '-')}"
    text = re.sub(r" Perhaps you meant:? (--\S+).*", r"; perhaps you meant \1", text)
    wrong = r"(invalid literal for int\(\) with base 10|could not convert string to float)"
    number = re.search(rf"{wrong}: (?P<value>'[^']*')", text)
    option = re.search(r"Argument helptext: (?P<name>\S+)", text)
    if number and option:
        kind = "a whole number" if number[1].startswith("invalid") else "a number"
        return f"{option['name']} {number['value']}: give {kind}"
    if option and NO_PATH in text:
        return f"{option['name']} {NO_PATH}"
    text = text.split(" Argument helptext:")[0]
    return re.sub(r"\{None\}\|\S+ ?|<class '\w+'>", "", text)
