"""Statistics over few seeds, after Agarwal et al. (2021), Deep RL at the Edge of the Precipice.

SciPy resamples, permutes and trims; rliable, which would do the same in their names, brings 80 MB
and 3 s of imports and does not run beside pandas 3. Ours are the weights of values at the quartiles
(rliable's interquartile mean of three seeds is their plain mean), and splits within each of several
tasks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb, prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import bootstrap, monte_carlo_test, permutation_test, trim_mean

RESAMPLES = 2000
PERMUTATIONS = 10 * RESAMPLES
Interval = tuple[float, float]


def interquartile_means(values: ArrayLike) -> NDArray[np.float64]:
    """[...]: the mean of the middle half along the last axis; needs at least one value.

    Values at the quartiles count with the share of them that lies inside, so that it is defined for
    any number; where that is a multiple of 4 it equals `scipy.stats.trim_mean(values, 0.25)`.
    """
    quarters = np.repeat(np.asarray(values, dtype=np.float64), 4, axis=-1)
    return np.asarray(trim_mean(quarters, 0.25, axis=-1))


def interquartile_mean(values: Sequence[float]) -> float:
    """`interquartile_means` of one list."""
    return float(interquartile_means(values))


def bootstrap_interval(values: Sequence[float]) -> Interval:
    """The 95 % bootstrap interval of the mean (percentiles); (nan, nan) below two values."""
    return _interval([values], lambda drawn: drawn[0].mean(axis=-1))


def stratified_interval(
    strata: Sequence[Sequence[float]], estimate: Callable[[Any], Any] = interquartile_means
) -> Interval:
    """The 95 % stratified bootstrap interval of an estimate over all values.

    Args:
        strata: the values of every task, one for each seed; seeds are drawn within a task only.
        estimate: from [..., values] to [...].

    Returns:
        Percentiles; (nan, nan) where a stratum has a single value, which tells of no spread.
    """
    return _interval(strata, lambda drawn: estimate(np.concatenate(drawn, axis=-1)))


def _interval(samples: Sequence[Sequence[float]], estimate: Callable[[Any], Any]) -> Interval:
    """Of an estimate over samples, [..., values] each, of which every one is drawn anew."""
    if min(map(len, samples)) < 2:
        return float("nan"), float("nan")
    interval = bootstrap(
        [np.asarray(sample, dtype=np.float64) for sample in samples],
        lambda *drawn, axis: estimate(drawn),
        method="percentile",
        n_resamples=RESAMPLES,
        vectorized=True,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def improvement(ours: ArrayLike, theirs: ArrayLike) -> NDArray[np.float64]:
    """[...]: the share of pairs in which ours is the lower one, ties counted half.

    Mann and Whitney's U over the number of pairs.

    Args:
        ours: [..., n].
        theirs: [..., m].
    """
    difference = np.asarray(theirs)[..., None, :] - np.asarray(ours)[..., :, None]
    return np.asarray(0.5 + 0.5 * np.sign(difference).mean(axis=(-1, -2)))


def _mean_improvement(ours: Sequence[Any], theirs: Sequence[Any]) -> Any:
    """The mean of `improvement` over tasks."""
    return np.mean([improvement(*task) for task in zip(ours, theirs, strict=True)], axis=0)


def probability_of_improvement(
    ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]]
) -> tuple[float, Interval]:
    """How likely a run of ours ends lower than one of theirs, and the 95 % interval of that.

    The mean over tasks of `improvement`; the interval is a stratified bootstrap over seeds.

    Args:
        ours, theirs: for each task, in the same order, one value for each seed; lower is better.
    """
    point, tasks = float(_mean_improvement(ours, theirs)), len(ours)
    return point, _interval(
        [*ours, *theirs], lambda drawn: _mean_improvement(drawn[:tasks], drawn[tasks:])
    )


def permutation_p(ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]]) -> float:
    """Two-sided p of `probability_of_improvement` if ours and theirs were drawn alike.

    With one task exact, over all ways to split the runs (for values without ties that of Mann and
    Whitney); with several tasks, very many ways or a single run, from `PERMUTATIONS` random splits
    within the tasks.
    """
    sizes, rng = [len(own) for own in ours], np.random.default_rng(0)
    pools = [np.array([*task[0], *task[1]], float) for task in zip(ours, theirs, strict=True)]

    def apart(own: Sequence[Any], other: Sequence[Any]) -> Any:
        return abs(_mean_improvement(own, other) - 0.5)

    def apart_in(*pools: Any, axis: int) -> Any:
        halves = [np.split(pool, [size], axis) for pool, size in zip(pools, sizes, strict=True)]
        return apart(*zip(*halves, strict=True))

    how: Any = {"n_resamples": PERMUTATIONS, "vectorized": True, "alternative": "greater"}
    exact = len(pools) == 1 and comb(len(pools[0]), sizes[0]) <= PERMUTATIONS
    if exact and min(sizes[0], len(theirs[0])) > 1:
        return float(
            permutation_test((ours[0], theirs[0]), lambda a, b, axis: apart([a], [b]), **how).pvalue
        )
    anew: Any = [  # SciPy takes one for each sample; its stubs know of one alone
        lambda size, pool=pool: rng.permuted(np.broadcast_to(pool, size), axis=-1) for pool in pools
    ]
    return float(monte_carlo_test(pools, anew, apart_in, **how).pvalue)


def least_p(sizes: Sequence[tuple[int, int]]) -> float:
    """The least p that `permutation_p` can give for so many runs, whatever they end with.

    All of ours below all of theirs in every task is one split of the runs, the reverse another, and
    p is the share of the splits that are as far from 0.5: 2 over their number. Where splits are
    drawn instead of counted (`PERMUTATIONS`), the one that was found counts too.

    Args:
        sizes: the runs of ours and theirs, for each task; at least one each.
    """
    splits = prod(comb(ours + theirs, ours) for ours, theirs in sizes)
    least = 2.0 / splits
    exact = len(sizes) == 1 and splits <= PERMUTATIONS
    return least if exact else max(least, 1.0 / (PERMUTATIONS + 1))


def is_range(runs: int) -> bool:
    """Whether the 95 % bootstrap interval of the mean of this many values is from the least to the
    greatest: where more than 2.5 % of all ways to draw them draw one of them alone."""
    return runs > 0 and float(runs) ** -runs > 0.025


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
