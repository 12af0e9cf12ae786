"""Rules and limits of settings in `train`; see `pursuit.validation` for the rules of fields."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Annotated, ClassVar

from pursuit.validation import Rule, check, check_fields, is_int, rule

Count = Annotated[int, rule(lambda value: 1 <= value < 2**63, "must be at least 1, below 2**63")]
Shown = Annotated[int, rule(lambda value: 1 <= value <= 1000, "give 1 to 1000 episodes to look at")]
Positive = Annotated[float, rule(lambda value: 0 < value < inf, "must be above 0")]
NotNegative = Annotated[float, rule(lambda value: 0 <= value < inf, "must be finite, at least 0")]
SHARE = rule(lambda value: 0 <= value <= 1, "must be in [0, 1]")
Share = Annotated[float, SHARE]
Finite = Annotated[float, rule(lambda value: abs(value) < inf, "must be finite")]

CLOCKS = ("wall", "processor")
PRECISIONS = ("auto", "float32", "bfloat16")
MOST_THREADS = 1024
MOST_FRAMES = 64
EVALUATION_SEED = 2**62
"""Training uses seeds below this one; evaluations use this one and above. So every evaluation uses
held-out seeds."""

RANDOM_MOVES = rule(lambda value: 0 <= value <= 1, "a share of random moves must be in [0, 1]")
SEED = rule(lambda value: 0 <= value < EVALUATION_SEED, "give 0 to 2**62-1 (others: evaluation)")


@dataclass(frozen=True)
class Settings:
    """Base of settings: the rules of all fields are applied on construction.

    Attributes:
        ADDED: settings that older versions did not write.
        REMOVED: settings that only older versions wrote, with their defaults. They are not read,
            and did not change results but for rounding. Fingerprints of runs count the defaults, so
            that finished runs of studies keep their names.
    """

    ADDED: ClassVar[tuple[str, ...]] = ()
    REMOVED: ClassVar[Mapping[str, object]] = {}

    def __post_init__(self) -> None:
        check_fields(self)


def check_default(settings: object, default: object, names: Iterable[str], why: str) -> None:
    """ValueError unless these settings have the values of `default`."""
    for name in names:
        value = getattr(settings, name)
        shown = str(value) if isinstance(value, Path) else value
        check(
            value == getattr(default, name), f"{name}={shown!r} has no effect: {why}; leave it out"
        )


def threads_from(least: int) -> Rule:
    """Allowed numbers of torch threads."""
    text = f"give {least} to {MOST_THREADS} threads, no more than there are cores"
    return rule(lambda value: least <= value <= MOST_THREADS, text)


def check_seed(seed: int) -> None:
    """ValueError for a seed that training may not use."""
    check(is_int(seed), f"seed={seed!r}; give a whole number")
    SEED.checked("seed", seed)


def evaluation_seed(seed: int) -> int:
    """The seed of an evaluation's games for `--seed` 0, 1, ...: never a seed of training.

    Raises:
        ValueError: a seed outside 0 .. 2**62 - 1.
    """
    check_seed(seed)
    return EVALUATION_SEED + seed
