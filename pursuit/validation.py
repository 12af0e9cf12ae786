"""Checks of arguments of functions, and rules of the fields of frozen dataclasses.

    @dataclass(frozen=True)
    class Settings:
        steps: Annotated[int, at_least(1)] = 200
        order: Annotated[str, choice("first", "last")] = "first"

        def __post_init__(self) -> None:
            check_fields(self)

The rules of a field are in its annotation. `whole`, `number`, `check_bool`, `one_of` and other
functions of a name and a value check arguments; `Rule(whole)` makes a rule of such a function.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from difflib import get_close_matches
from functools import cache
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeGuard, TypeVar, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

Key = TypeVar("Key")
Value = TypeVar("Value")
Plain = dict[str, Any]
"""Values by name, as in JSON."""
MOST_SHOWN = 100


def check(condition: bool, message: str) -> None:
    """Raise ValueError(message) unless `condition`."""
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True)
class Missing:
    """In place of a part that a kind of game does not have: the reason, with the remedy."""

    reason: str


def need(part: Value | Missing) -> Value:
    """The part; ValueError with the reason where it is missing."""
    if isinstance(part, Missing):
        raise ValueError(part.reason)
    return part


def one_of(what: str, value: Any, choices: Collection[str]) -> Any:
    """`value`, if it is one of `choices`; ValueError otherwise."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(unknown(what, value, choices))
    return value


def unknown(what: str, name: object, known: Iterable[str], listed: str = "one of") -> str:
    """The message for an unknown name: the closest known one, then all of them."""
    names = list(known)
    return (
        f"unknown {what} {shortened(name)}{did_you_mean(name, names)}; {listed} {', '.join(names)}"
    )


def text_of(value: object, form: Callable[[object], str] = str) -> str:
    """`str(value)`, or that of another form, in characters that files can have; if it raises, a
    text that says so."""
    try:
        return form(value).encode(errors="replace").decode()
    except Exception as error:  # of a user's class
        return f"<{type(value).__name__}, whose text raises {type(error).__name__}>"


def shortened(value: object) -> str:
    """`repr(value)` in one line of at most `MOST_SHOWN` characters, for messages."""
    text = text_of(value, repr)
    text = " ".join(text.split()) if "\n" in text else text  # arrays have several lines
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 3]}..."


def raised(error: BaseException) -> str:
    """The kind and the message of an exception on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """ " (did you mean 'x'?)" with the closest of these names, or "" if none is close."""
    by_lower = {each.lower(): each for each in known}
    close = get_close_matches(str(name).lower(), by_lower, 1)
    return f" (did you mean {by_lower[close[0]]!r}?)" if close else ""


def plain(value: Any) -> Any:
    """`value` with the numbers of Python in place of NumPy's, also in lists, tuples and dicts."""
    if isinstance(value, np.generic):
        return value.item()
    if type(value) in (list, tuple):
        return type(value)(map(plain, value))
    if type(value) is dict:
        return {plain(key): plain(each) for key, each in value.items()}
    return value


def is_int(value: object) -> TypeGuard[int]:
    """Whether it is an integer of Python or NumPy; bools are not accepted."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def is_number(value: object) -> TypeGuard[float]:
    """Whether it is an integer or float of Python or NumPy; bools are not accepted."""
    return is_int(value) or isinstance(value, (float, np.floating))


def whole(name: str, value: object, least: int = 0, most: int = 2**31 - 1) -> int:
    """`value` as an int, if it is a whole number from `least` to `most`; ValueError otherwise."""
    if not is_int(value):
        raise ValueError(f"{name}={value!r}; it is a whole number")
    if value < least:
        raise ValueError(f"{name}={value}; it is at least {least}")
    if value > most:
        raise ValueError(f"{name}={value}; it is at most {most}")
    return int(value)


def number(name: str, value: object, least: float = -inf, most: float = inf) -> float:
    """`value` as a float, if it is finite, from `least` to `most`; ValueError otherwise."""
    if not is_number(value):
        raise ValueError(f"{name}={value!r}; it is a number")
    try:
        checked = float(value)
    except OverflowError:  # a whole number of hundreds of digits
        checked = inf
    if not isfinite(checked):
        raise ValueError(f"{name}={value}; it is finite")
    if checked < least:
        raise ValueError(f"{name}={value}; it is at least {least:g}")
    if checked > most:
        raise ValueError(f"{name}={value}; it is at most {most:g}")
    return checked


def check_probability(name: str, value: object) -> float:
    """`value` as a float, if it is in [0, 1]; ValueError otherwise."""
    if not is_number(value) or not 0.0 <= value <= 1.0:
        raise ValueError(f"{name}={value!r}; it is a probability from 0 to 1")
    return float(value)


def check_discount(discount: object) -> float:
    """`discount` as a float, if it is above 0 and at most 1; ValueError otherwise."""
    checked = number("discount", discount)
    if not 0.0 < checked <= 1.0:
        raise ValueError(f"discount={discount}; give a number above 0 and at most 1")
    return checked


def checked_seed(seed: object) -> int:
    """`seed` as an int, if it is a whole number from 0 to 2**64 - 1; ValueError otherwise."""
    return whole("seed", seed, 0, 2**64 - 1)


def random_seed() -> int:
    """A random seed from the operating system."""
    return int(np.random.SeedSequence().generate_state(1, np.uint64)[0])


def check_bool(name: str, value: object) -> bool:
    """`value` as a bool, if it is True or False; ValueError otherwise."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name}={value!r}; it is True or False")
    return bool(value)


def as_path(name: str, value: str | Path) -> Path:
    """`value` as a path, if a file may have it; ValueError otherwise."""
    try:
        path = Path(value)
        path.lstat()
    except (TypeError, ValueError):  # another type, or a null character
        raise ValueError(f"{name}={shortened(value)}; give a path") from None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise ValueError(f"{name}={shortened(value)}; a name of a file is shorter") from None
    return path


def whole_numbers(name: str, value: ArrayLike, least: int, most: int) -> NDArray[Any]:
    """`value` as an array of whole numbers from `least` to `most`; ValueError otherwise."""
    array = as_array(name, value, "iu", f"whole numbers from {least} to {most}")
    if array.size and not least <= array.min() <= array.max() <= most:
        raise ValueError(f"{name}={shortened(value)}; whole numbers from {least} to {most}")
    return array


def as_array(name: str, value: ArrayLike, kinds: str, rule: str) -> NDArray[Any]:
    """`value` as an array, if its dtype is of one of the `kinds` of NumPy (or it is empty)."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name}={shortened(value)}; {rule}") from None
    if array.size and array.dtype.kind not in kinds:
        raise ValueError(f"{name}={shortened(value)}; {rule}")
    return array


# -- rules of fields -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rule:
    """The allowed values of a field of a dataclass.

    Attributes:
        checked: (name, value) -> the value to store; ValueError for a value that is not allowed.
        other_types: whether files may give values of other types, which `checked` converts.
    """

    checked: Callable[[str, Any], Any]
    other_types: bool = False


def rule(holds: Callable[[Any], bool], text: str) -> Rule:
    """Values for which `holds` is true; `text` describes them in messages."""

    def checked(name: str, value: Any) -> Any:
        check(value is not None and holds(value), f"{name}={value}; {text}")
        return value

    return Rule(checked)


def at_least(least: int) -> Rule:
    """Numbers not below `least`."""
    return rule(lambda value: value >= least, f"give at least {least}")


def choice(*choices: str) -> Rule:
    """One of these strings."""
    return Rule(lambda name, value: one_of(name, value, choices))


def passes(function: Callable[[Any], object]) -> Rule:
    """Values for which `function` raises no ValueError."""

    def checked(name: str, value: Any) -> Any:
        function(value)
        return value

    return Rule(checked)


Whole = Annotated[int, Rule(whole)]
WholeFrom1 = Annotated[int, Rule(lambda name, value: whole(name, value, 1))]
Flag = Annotated[bool, Rule(check_bool)]


@cache
def field_rules(form: Any) -> Mapping[str, tuple[Rule, ...]]:
    """The rules of the fields of a dataclass, by name."""
    hints = get_type_hints(form, include_extras=True)
    return {
        name: tuple(each for each in getattr(hint, "__metadata__", ()) if isinstance(each, Rule))
        for name, hint in hints.items()
    }


def check_fields(settings: Any) -> None:
    """Apply the rules of all fields of a frozen dataclass, and store the values that they return.

    None is allowed where it is the default.
    """
    form: Any = type(settings)
    for field in fields(settings):
        value = plain(getattr(settings, field.name))
        object.__setattr__(settings, field.name, value)
        if value is not None or field.default is not None:
            for each in field_rules(form)[field.name]:
                value = each.checked(field.name, value)
                object.__setattr__(settings, field.name, value)


# -- settings by name ------------------------------------------------------------------------------


def named_settings(function: str, settings: Plain, known: Sequence[str]) -> Plain:
    """`settings` with the names in `known`; `max_cycles`, PettingZoo's name, becomes `max_steps`.

    Raises:
        TypeError: an unknown setting, or both `max_cycles` and `max_steps`.
    """
    named = dict(settings)
    if "max_cycles" in named:
        if "max_steps" in named:
            raise TypeError(f"{function}() got max_steps and max_cycles; give only one of them")
        named["max_steps"] = named.pop("max_cycles")
    for setting in named:
        if setting not in known:
            raise TypeError(
                f"{function}() got an unexpected keyword argument {setting!r}; the settings are "
                f"{', '.join(known)}"
            )
    return named


def reset_options(options: Any, needed: Sequence[str], known: Sequence[str] = ()) -> Plain:
    """The `options` of an environment's `reset`; an empty dict for None.

    Args:
        options: a mapping, or None.
        needed: names that must be given together, or not at all.
        known: further names, allowed only with those.

    Raises:
        ValueError: not a mapping, an unknown name, or a missing name of `needed`.
    """
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"options={options!r}; give a dict")
    # PettingZoo's own tests of environments pass {"options": 1}.
    own = {name: value for name, value in (options or {}).items() if name != "options"}
    for name in own:
        if name not in (*needed, *known):
            raise ValueError(
                f"options={options!r}: "
                + unknown("option", name, [*needed, *known], "the options of reset are")
            )
    if own and not set(needed) <= set(own):
        raise ValueError(f"options={options!r}; give {' and '.join(needed)} too, or no option")
    return own


class FrozenDict(dict[Key, Value]):
    """An immutable dict, hashed by its content."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)

    def _refuse(self, *args: Any, **kwargs: Any) -> NoReturn:
        raise TypeError("this dict is immutable; make a copy with dict(...)")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse
