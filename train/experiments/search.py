"""Random search: draws of settings from the ranges of a study file."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from pursuit.validation import check
from train.experiments.study import Table, check_plain
from train.schemas import read_as
from train.settings.checks import check_seed

SEARCH_FORMS = "give {low=, high=, scale='log'} or {choices=[]}"


class Range(msgspec.Struct, forbid_unknown_fields=True):
    """A setting that is drawn uniformly from an interval, on a linear or logarithmic scale."""

    low: float
    high: float
    scale: str = "linear"
    whole: bool = False

    def __post_init__(self) -> None:
        check(self.scale in ("linear", "log"), f"scale={self.scale!r}; give linear or log")
        check(
            math.isfinite(self.low) and math.isfinite(self.high),
            f"low={self.low} and high={self.high}; give finite numbers",
        )
        check(self.low < self.high, f"low={self.low} is not below high={self.high}; exchange them")
        check(self.scale != "log" or self.low > 0, f"low={self.low}; scale='log' needs low above 0")


class Choices(msgspec.Struct, forbid_unknown_fields=True):
    """A setting that is drawn from a list."""

    choices: list[Any]

    def __post_init__(self) -> None:
        check(bool(self.choices), "choices is an empty list; give at least one value")


def draw_samples(search: Table, limit: int) -> list[Table]:
    """The samples of a random search, the same for all tasks and seeds.

    Args:
        search: "samples" and "seed", and for every searched setting {low, high, scale="log" or
            "linear", whole=false} or {choices=[...]}.
        limit: maximum number of samples.

    Returns:
        One dict per sample; [{}] without a search.

    Raises:
        ValueError: `search` has another form, or a range is empty.
    """
    if not search:
        return [{}]
    space = dict(search)
    samples, seed = space.pop("samples", 10), space.pop("seed", 0)
    check(
        type(samples) is int and 1 <= samples <= limit,
        f"samples={samples!r} in [search]; give a whole number from 1 to {limit:,}",
    )
    check(type(seed) is int, f"seed={seed!r} in [search]; give a whole number")
    check_seed(seed)
    check(bool(space), "[search] names no setting; give learning_rate = {low=1e-4, high=1e-2}, say")
    ranges = {name: range_of(name, spec) for name, spec in space.items()}
    generator = np.random.default_rng(seed)
    return [{name: draw(spec, generator) for name, spec in ranges.items()} for _ in range(samples)]


def range_of(name: str, spec: object) -> Range | Choices:
    """The distribution of one setting; ValueError for another form, or an empty list."""
    where = f"search of {name}"
    if isinstance(spec, dict) and "choices" in spec:
        choices = read_as(Choices, spec, where, SEARCH_FORMS)
        for value in choices.choices:
            check_plain(name, value, "[search]")
        return choices
    return read_as(Range, spec, where, SEARCH_FORMS)


def draw(spec: Range | Choices, generator: np.random.Generator) -> Any:
    """A sample of one setting."""
    if isinstance(spec, Choices):
        return spec.choices[int(generator.integers(len(spec.choices)))]
    if spec.scale == "log":
        value = float(np.exp(generator.uniform(np.log(spec.low), np.log(spec.high))))
    else:
        value = float(generator.uniform(spec.low, spec.high))
    return round(value) if spec.whole else float(f"{value:.4g}")
