"""Statistics over few seeds, after Agarwal et al. (2021), Deep RL at the Edge of the Precipice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

RESAMPLES = 2000
Interval = tuple[float, float]


def interquartile_means(values: ArrayLike) -> NDArray[np.float64]:
    """[...]: the mean of the middle half along the last axis; needs at least one value.

    Values at the quartiles count with the share of them that lies inside, so that it is defined for
    any number; where that is a multiple of 4 it equals `scipy.stats.trim_mean(values, 0.25)`.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=-1)
    count = ordered.shape[-1]
    edges = np.arange(count + 1)
    upper, lower = np.minimum(edges[1:], 0.75 * count), np.maximum(edges[:-1], 0.25 * count)
    inside = np.clip(upper - lower, 0.0, 1.0)
    # Infinite values outside the middle half do not count, though 0 * inf is no number.
    kept = np.where(inside > 0, ordered, 0.0)
    return np.asarray((kept * inside).sum(axis=-1) / inside.sum())


def interquartile_mean(values: Sequence[float]) -> float:
    """`interquartile_means` of one list."""
    return float(interquartile_means(values))


def bootstrap_interval(values: Sequence[float]) -> Interval:
    """The 95 % bootstrap interval of the mean (percentiles; SciPy); (nan, nan) below two values."""
    from scipy.stats import bootstrap

    array = np.asarray(values, dtype=np.float64)
    if len(array) < 2:
        return float("nan"), float("nan")
    if np.ptp(array) == 0:
        return float(array[0]), float(array[0])
    interval = bootstrap(
        (array,), np.mean, method="percentile", n_resamples=RESAMPLES, rng=np.random.default_rng(0)
    ).confidence_interval
    return float(interval.low), float(interval.high)


def resampled(strata: Sequence[Sequence[float]], rng: np.random.Generator) -> NDArray[np.float64]:
    """[RESAMPLES, all values]: every stratum drawn anew from itself, with replacement."""
    parts = []
    for stratum in strata:
        array = np.asarray(stratum, dtype=np.float64)
        parts.append(array[rng.integers(0, len(array), (RESAMPLES, len(array)))])
    return np.concatenate(parts, axis=1)


def percentiles(estimates: NDArray[np.float64]) -> Interval:
    """The middle 95 % of resampled estimates."""
    low, high = np.percentile(estimates, (2.5, 97.5))
    return float(low), float(high)


def stratified_interval(
    strata: Sequence[Sequence[float]],
    estimate: Callable[[Any], NDArray[np.float64]] = interquartile_means,
) -> Interval:
    """The 95 % stratified bootstrap interval of an estimate over all values.

    Args:
        strata: the values of every task, one for each seed; seeds are drawn within a task only.
        estimate: from [..., values] to [...].

    Returns:
        Percentiles; (nan, nan) where no stratum has two values.
    """
    if max(map(len, strata)) < 2:
        return float("nan"), float("nan")
    return percentiles(estimate(resampled(strata, np.random.default_rng(0))))


def improvement(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> NDArray[np.float64]:
    """[...]: the share of pairs in which ours is the lower one, ties counted half.

    Mann and Whitney's U over the number of pairs.

    Args:
        ours: [..., n].
        theirs: [..., m].
    """
    difference = theirs[..., None, :] - ours[..., :, None]
    return np.asarray(((difference > 0) + 0.5 * (difference == 0)).mean(axis=(-1, -2)))


def probability_of_improvement(
    ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]]
) -> tuple[float, Interval]:
    """How likely a run of ours ends lower than one of theirs, and the 95 % interval of that.

    The mean over tasks of `improvement`; the interval is a stratified bootstrap over seeds.

    Args:
        ours, theirs: for each task, in the same order, one value for each seed; lower is better.
    """
    rng = np.random.default_rng(0)
    points, draws = [], []
    for own, other in zip(ours, theirs, strict=True):
        points.append(improvement(np.asarray(own, float), np.asarray(other, float)))
        draws.append(improvement(resampled([own], rng), resampled([other], rng)))
    point = float(np.mean(points))
    if max(map(len, ours)) < 2 or max(map(len, theirs)) < 2:
        return point, (float("nan"), float("nan"))
    return point, percentiles(np.mean(draws, axis=0))


def permutation_p(ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]]) -> float:
    """Two-sided p of `probability_of_improvement` if ours and theirs were drawn alike.

    With one task exact, over all ways to split the runs (for values without ties that of Mann and
    Whitney); with several tasks, or very many ways, from `RESAMPLES` * 10 random splits within the
    tasks.
    """

    def apart(splits: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> float:
        return abs(float(np.mean([improvement(own, other) for own, other in splits])) - 0.5)

    pools = [np.array([*own, *other], float) for own, other in zip(ours, theirs, strict=True)]
    sizes = [len(own) for own in ours]
    found = apart([(pool[:size], pool[size:]) for pool, size in zip(pools, sizes, strict=True)])
    if len(pools) == 1 and comb(len(pools[0]), sizes[0]) <= 10 * RESAMPLES:
        pool, every = pools[0], range(len(pools[0]))
        distances = []
        for chosen in combinations(every, sizes[0]):
            rest = [i for i in every if i not in chosen]
            distances.append(apart([(pool[list(chosen)], pool[rest])]))
        return float(np.mean(np.array(distances) >= found - 1e-12))
    rng = np.random.default_rng(0)
    distances = [found]
    for _ in range(10 * RESAMPLES):
        mixed = [rng.permutation(pool) for pool in pools]
        distances.append(apart([(m[:n], m[n:]) for m, n in zip(mixed, sizes, strict=True)]))
    return float(np.mean(np.array(distances) >= found - 1e-12))


def first_below(places: ArrayLike, values: ArrayLike, threshold: float) -> float:
    """The first of `places` at which `values` is at most the threshold; inf where none is."""
    below = np.flatnonzero(np.asarray(values) <= threshold)
    return float(np.asarray(places)[below[0]]) if len(below) else float("inf")


def mean_over(places: ArrayLike, values: ArrayLike) -> float:
    """The mean of a curve over the range of its places: its area (trapezoids) over its length."""
    x, y = np.asarray(places, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if len(x) == 1 or x[-1] == x[0]:
        return float(y[-1])
    return float(np.trapezoid(y, x) / (x[-1] - x[0]))
