"""Validation of settings: rules are annotations of the fields of frozen dataclasses.

@dataclass(frozen=True)
class Example(Settings):
    steps: Count = 200
    order: Annotated[str, one_of("first", "last")] = "first"
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from math import inf
from typing import Annotated, Any, get_type_hints

from pursuit import validation
from pursuit.validation import is_int


def check(condition: bool, message: str) -> None:
    """Raise ValueError(message) unless `condition`."""
    if not condition:
        raise ValueError(message)


def check_default(settings: Any, default: Any, names: Iterable[str], why: str) -> None:
    """ValueError unless these settings have the values of `default`."""
    for name in names:
        value = getattr(settings, name)
        check(
            value == getattr(default, name),
            f"{name}={value!r} has no effect: {why}; leave it out",
        )


# -- rules of fields -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rule:
    """The allowed values of a field.

    Attributes:
        keep: (name, value) -> the normalised value; ValueError for a value that is not allowed.
        other_types: whether files may give values of other types, which `keep` converts.
    """

    keep: Callable[[str, Any], Any]
    other_types: bool = False


def rule(holds: Callable[[Any], bool], text: str) -> Rule:
    """Values for which `holds` is true; `text` describes them in messages."""

    def keep(name: str, value: Any) -> Any:
        check(holds(value), f"{name}={value}; {text}")
        return value

    return Rule(keep)


def at_least(least: int) -> Rule:
    """Numbers not below `least`."""
    return rule(lambda value: value >= least, f"give at least {least}")


def one_of(*choices: str) -> Rule:
    """One of these strings."""
    return Rule(lambda name, value: validation.one_of(name, value, choices))


def passes(function: Callable[[Any], object]) -> Rule:
    """Values for which `function` raises no ValueError."""

    def keep(name: str, value: Any) -> Any:
        function(value)
        return value

    return Rule(keep)


Count = Annotated[int, rule(lambda value: 1 <= value < 2**63, "must be at least 1, below 2**63")]
Positive = Annotated[float, rule(lambda value: 0 < value < inf, "must be above 0")]
NotNegative = Annotated[float, rule(lambda value: 0 <= value < inf, "must be finite, at least 0")]
SHARE = rule(lambda value: 0 <= value <= 1, "must be in [0, 1]")
Share = Annotated[float, SHARE]
Finite = Annotated[float, rule(lambda value: abs(value) < inf, "must be finite")]


@cache
def hints_of(form: Any) -> Mapping[str, Any]:
    """The types of a dataclass's fields by name, with their rules."""
    return get_type_hints(form, include_extras=True)


def rules_of(form: Any, name: str) -> list[Rule]:
    """The rules of a field of a dataclass."""
    metadata = getattr(hints_of(form)[name], "__metadata__", ())
    return [each for each in metadata if isinstance(each, Rule)]


@dataclass(frozen=True)
class Settings:
    """Base of settings: the rules of all fields are applied on construction."""

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            for each in rules_of(type(self), name):
                value = getattr(self, name)
                if value is not None:
                    object.__setattr__(self, name, each.keep(name, value))


# -- common limits ---------------------------------------------------------------------------------

CLOCKS = ("wall", "processor")
PRECISIONS = ("auto", "float32", "bfloat16")
MOST_THREADS = 1024
MOST_FRAMES = 64
EVALUATION_SEED = 2**62
"""Training uses seeds below this one; evaluations use this one and above. So every evaluation uses
held-out seeds."""

RANDOM_MOVES = rule(lambda value: 0 <= value <= 1, "a share of random moves must be in [0, 1]")
SEED = rule(lambda value: 0 <= value < EVALUATION_SEED, "give 0 to 2**62-1 (others: evaluation)")


def threads_from(least: int) -> Rule:
    """Allowed numbers of torch threads."""
    return rule(
        lambda value: least <= value <= MOST_THREADS,
        f"give {least} to {MOST_THREADS} threads, no more than there are cores",
    )


def check_seed(seed: int) -> None:
    """ValueError for a seed that training may not use."""
    check(is_int(seed), f"seed={seed!r}; give a whole number")
    SEED.keep("seed", seed)


def evaluation_seed(seed: int) -> int:
    """The seed of an evaluation's games for `--seed` 0, 1, ...: never a seed of training.

    Raises:
        ValueError: a seed outside 0 .. 2**62 - 1.
    """
    check_seed(seed)
    return EVALUATION_SEED + seed
