"""Parsing of options into dataclasses with tyro, with one-line errors."""

from __future__ import annotations

import contextlib
import io
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import Any, NoReturn, TypeVar, get_args, get_origin

import tyro
from docstring_parser import parse_from_object
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec

from pursuit.plugins import ALLOW, allow
from pursuit.validation import check
from train.files import Plain

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


def default_budget(options: Mapping[str, str], seconds: float) -> Plain:
    """The default budget: `seconds`, or a placeholder for frames if --frames is given."""
    return {"frames": 1} if "frames" in options else {"seconds": seconds}


ALLOW_HELP = f"""all commands:
  --allow MODULE    allow files (of runs, sweeps, models) to name user-defined
                    parts of this module; can be repeated;
                    {ALLOW}=MODULE,OTHER does the same
"""


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


CONFIG = (
    tyro.conf.OmitArgPrefixes,
    tyro.conf.HelptextFromCommentsOff,
    tyro.conf.AvoidSubcommands,  # the default determines the form of the task
)


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


def join_lines(text: str) -> str:
    """The paragraphs of a docstring as single lines, without the indentation of the source."""
    return "\n\n".join(" ".join(part.split()) for part in re.split(r"\n\s*\n", text.strip()))


@cache
def set_help_texts(form: Any, wanted: bool) -> None:
    """Make the docstrings of a dataclass's fields their help texts, with joined lines.

    tyro finds them, too, but keeps line breaks; for the message of an error it reads those of all
    fields without a text, and prints those of required options.
    """
    texts = {
        part.arg_name: join_lines(part.description or "")
        for base in (reversed(form.__mro__[:-1]) if wanted else ())
        for part in parse_from_object(base).params
    }
    for each in fields(form):
        required = each.default is MISSING and each.default_factory is MISSING
        other = None if wanted or required else each.metadata.get("help", "")
        text = texts.get(each.name, other)
        each.metadata = MappingProxyType({**each.metadata, "help": text})


def described(form: type[object]) -> str:
    """The docstring of a command, wrapped to the terminal, which tyro does not do.

    tyro joins lines, but not those that begin with a space.
    """
    if str(form.__doc__).startswith(f"{form.__name__}("):  # without docstrings, as by python -OO
        return ""
    width = shutil.get_terminal_size().columns
    parts = join_lines(str(form.__doc__)).split("\n\n")
    return "\n\n".join(textwrap.fill(part, width, subsequent_indent="  ") for part in parts)


def forms_in(value: object) -> Iterator[Any]:
    """The dataclasses of a default value and its parts."""
    if is_dataclass(value):
        yield type(value)
        for each in fields(value):
            yield from forms_in(getattr(value, each.name))


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
    extra["description"] = described(own)
    for each in (own, *forms_in(default)):
        set_help_texts(each, not {"-h", "--help"}.isdisjoint(args))
    try:
        with contextlib.redirect_stderr(boxed):
            return tyro.cli(
                form, args=args, prog=f"pursuit {prog}", config=CONFIG, registry=PRIMITIVES, **extra
            )
    except SystemExit as exit_:
        if not exit_.code:
            print(ALLOW_HELP)
            raise
        raise ValueError(f"{tyro_message(boxed.getvalue())} (see pursuit {prog} --help)") from None


def parse_known(default: Form, arguments: Sequence[str]) -> Form:
    """Those of `arguments` that the dataclass of `default` has; `default` if one is wrong.

    For options that determine the other options; `parse` reports errors.
    """
    args = [argument for argument in arguments if argument not in ("-h", "--help")]
    for each in forms_in(default):
        set_help_texts(each, wanted=False)
    with contextlib.suppress(SystemExit, ValueError), contextlib.redirect_stderr(io.StringIO()):
        found, _ = tyro.cli(
            type(default),
            args=args,
            default=default,
            config=CONFIG,
            registry=PRIMITIVES,
            return_unknown_args=True,
        )
        return found
    return default


def tyro_message(boxed: str) -> str:
    """tyro's error box as one line, without Python types."""
    text = re.sub(r"\x1b\[[0-9;]*m|[─╭╮╰╯│]+|-{5,}", " ", boxed)
    text = " ".join(text.split("For full helptext")[0].split())
    kinds = "Value error|Parsing error|Unrecognized options|Required options|Missing argument"
    text = re.sub(rf"^({kinds})\s*", "", text)
    text = re.sub(r"Error parsing \S+: ", "", text)
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
