"""Random search: sampling of the settings in [search] of a sweep file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from train.experiments.forms import Choices, Range, check_plain
from train.schemas import read_as
from train.settings.checks import check, check_seed

LEAST_GAP = 1e-3
"""Gaps below this count as equal in the selection of settings."""
FORMS = "give {low=, high=, scale='log'} or {choices=[]}"


Trial = TypeVar("Trial")


def draw_samples(search: dict[str, Any], limit: int) -> list[dict[str, Any]]:
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
    given = dict(search)
    samples, seed = given.pop("samples", 10), given.pop("seed", 0)
    check(
        type(samples) is int and 1 <= samples <= limit,
        f"samples={samples!r} in [search]; give a whole number from 1 to {limit:,}",
    )
    check(type(seed) is int, f"seed={seed!r} in [search]; give a whole number")
    check_seed(seed)
    check(bool(given), "[search] names no setting; give learning_rate = {low=1e-4, high=1e-2}, say")
    ranges = {name: range_of(name, spec) for name, spec in given.items()}
    generator = np.random.default_rng(seed)
    return [{name: draw(spec, generator) for name, spec in ranges.items()} for _ in range(samples)]


def range_of(name: str, spec: Any) -> Range | Choices:
    """The distribution of one setting; ValueError for another form, or an empty list."""
    where = f"search of {name}"
    if isinstance(spec, dict) and "choices" in spec:
        found = read_as(Choices, spec, where, FORMS)
        for value in found.choices:
            check_plain(name, value, "[search]")
        return found
    return read_as(Range, spec, where, FORMS)


def draw(spec: Range | Choices, generator: np.random.Generator) -> Any:
    """A sample of one setting."""
    if isinstance(spec, Choices):
        return spec.choices[int(generator.integers(len(spec.choices)))]
    if spec.scale == "log":
        value = float(np.exp(generator.uniform(np.log(spec.low), np.log(spec.high))))
    else:
        value = float(generator.uniform(spec.low, spec.high))
    return round(value) if spec.whole else float(f"{value:.4g}")


def log_gap(gap: float) -> float:
    """The logarithm of a gap to the optimum; its mean over mazes selects settings."""
    return math.log(max(gap, LEAST_GAP))


def best_of(scores: Mapping[Trial, Sequence[float | None]]) -> Trial | None:
    """The first trial with the lowest mean score; trials with a failed run (None) are ignored."""
    means = {
        trial: sum(each) / len(each)  # type: ignore[arg-type]
        for trial, each in scores.items()
        if each and None not in each
    }
    return min(means, key=lambda trial: means[trial]) if means else None
