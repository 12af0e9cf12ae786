"""Statistics over few seeds.

Of means Student's intervals, of probabilities of improvement Newcombe's: percentile bootstraps of 3
to 9 values cover the truth in 50 to 90 % of the cases instead of 95, and shrink to a point where
all values lie apart; these hold at 3 (a test simulates it). SciPy permutes, tests and trims; ours
are the weights of values at the quartiles, and what takes several tasks at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb, prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.stats import monte_carlo_test, norm, permutation_test, trim_mean
from scipy.stats import t as student

PERMUTATIONS = 20_000
Interval = tuple[float, float]


def interquartile_mean(values: Sequence[float]) -> float:
    """The mean of the middle half; needs at least one value.

    Values at the quartiles count with the share of them that lies inside, so that it is defined for
    any number; where that is a multiple of 4 it equals `scipy.stats.trim_mean(values, 0.25)`.
    """
    return float(trim_mean(np.repeat(np.asarray(values, dtype=np.float64), 4), 0.25))


def mean_interval(tasks: Sequence[Sequence[float]], level: float = 0.95) -> Interval:
    """Student's interval of the mean over tasks of the mean of their runs.

    With one task the usual one; with several Welch's, its degrees of freedom by Satterthwaite
    (1946). It covers as often as it says where runs are spread about evenly around their mean, and
    somewhat less where few lie far on one side. Of runs that either solve their task or do not no
    interval of a mean says much: count them.

    Args:
        tasks: the values of every task, one for each seed.
        level: how often it is to cover the truth.

    Returns:
        (nan, nan) where a task has a single value, which tells of no spread.
    """
    return _welch([(np.asarray(task, dtype=np.float64), 1.0) for task in tasks], level)


def distance_interval(tasks: Sequence[Sequence[float]], level: float = 0.95) -> Interval:
    """`mean_interval` of what lies on one side of 0 by its nature, such as a gap to an optimum.

    It ends at 0 where Student's goes on beyond: no mean can lie there, so it covers as often.
    """
    low, high = mean_interval(tasks, level)
    if np.mean([np.mean(task) for task in tasks]) >= 0.0:
        return (0.0 if low < 0.0 else low), high
    return low, (0.0 if high > 0.0 else high)


def difference_interval(
    ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]], level: float = 0.95
) -> Interval:
    """Welch's interval of the mean of ours minus that of theirs, as `mean_interval` has it.

    At level 0.9 it lies within a margin exactly where two one-sided tests at 0.05 say that the
    means differ by no more (Schuirmann, 1987).
    """
    signed = [(own, 1.0) for own in ours] + [(other, -1.0) for other in theirs]
    both = [(np.asarray(task, dtype=np.float64), sign * 2.0) for task, sign in signed]
    return _welch(both, level)  # the mean over half of them: those of either side


def _welch(samples: Sequence[tuple[NDArray[np.float64], float]], level: float) -> Interval:
    """Of the mean over samples of their means, each times its weight."""
    if min(len(sample) for sample, _ in samples) < 2:
        return float("nan"), float("nan")
    weights = np.array([weight for _, weight in samples]) / len(samples)
    mean = float(weights @ [sample.mean() for sample, _ in samples])
    parts = weights**2 * [sample.var(ddof=1) / len(sample) for sample, _ in samples]
    if not parts.sum() > 0.0:
        return mean, mean
    freedom = parts.sum() ** 2 / (parts**2 / [len(sample) - 1 for sample, _ in samples]).sum()
    half = float(student.ppf(0.5 + level / 2.0, freedom) * np.sqrt(parts.sum()))
    return mean - half, mean + half


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

    The mean over tasks of `improvement`. The interval is Newcombe's (2006, Confidence intervals for
    an effect size measure based on the Mann-Whitney statistic, part 2, method 5), which stays wide
    where all of ours lie below all of theirs; of several tasks, with the mean of their variances.

    Args:
        ours, theirs: for each task, in the same order, one value for each seed; lower is better.

    Returns:
        The interval is (nan, nan) where a task has a single run of either.
    """
    point = float(_mean_improvement(ours, theirs))
    sizes = [(len(own), len(other)) for own, other in zip(ours, theirs, strict=True)]
    if min(map(min, sizes)) < 2:
        return point, (float("nan"), float("nan"))
    z = float(norm.ppf(0.975))

    def variance(p: float) -> float:
        more = (1.0 - p) / (2.0 - p) + p / (1.0 + p)
        each = [(1.0 + ((m + n) / 2.0 - 1.0) * more) / (m * n) for m, n in sizes]
        return p * (1.0 - p) * sum(each) / len(sizes) ** 2

    def beyond(p: float) -> float:
        return (p - point) ** 2 - z**2 * variance(p)

    inner = min(max(point, 1e-9), 1.0 - 1e-9)  # at 0 and 1 the variance is 0: a root, but not ours
    low = 0.0 if point == 0.0 else float(brentq(beyond, 0.0, inner))
    high = 1.0 if point == 1.0 else float(brentq(beyond, inner, 1.0))
    return point, (low, high)


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
    """The smallest p that `permutation_p` can give for these numbers of runs.

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


def holm(ps: Sequence[float]) -> list[float]:
    """The p of several comparisons, corrected so that in all of them together chance is taken for a
    difference as rarely as in one (Holm, 1979). Those that are nan stay so, and do not count."""
    order = sorted((number for number, p in enumerate(ps) if p == p), key=lambda n: ps[n])
    corrected, least = list(ps), 0.0
    for place, number in enumerate(order):
        least = max(least, min(1.0, (len(order) - place) * ps[number]))
        corrected[number] = least
    return corrected


def logrank_p(
    ours: Sequence[Sequence[float]],
    theirs: Sequence[Sequence[float]],
    ends: tuple[Sequence[Sequence[float]], Sequence[Sequence[float]]],
) -> float:
    """Two-sided p of the log-rank test (Mantel, 1966) that ours and theirs get there alike soon.

    Stratified by task: runs are compared within their task alone. Observed minus expected numbers
    and their hypergeometric variances are summed over tasks before one is divided by the other. A
    task in which only one side has runs adds nothing.

    Args:
        ours, theirs: for each task, in the same order, when each run got there; inf for one that
            did not.
        ends: likewise, when each run ended: one that did not get there by then is censored.

    Returns:
        nan where no run got there, or all did at the same time.
    """
    difference = variance = 0.0
    for own, other, own_ends, other_ends in zip(ours, theirs, *ends, strict=True):
        times, is_own = np.array([*own, *other]), np.arange(len(own) + len(other)) < len(own)
        last = np.where(np.isfinite(times), times, [*own_ends, *other_ends])
        for time in np.unique(times[np.isfinite(times)]):
            at_risk, arrived = last >= time, times == time
            n, got, share = at_risk.sum(), arrived.sum(), is_own[at_risk].mean()
            difference += (arrived & is_own).sum() - got * share
            variance += got * share * (1.0 - share) * (n - got) / max(n - 1, 1)
    if variance == 0.0:
        return float("nan")
    return float(2.0 * norm.sf(abs(difference) / np.sqrt(variance)))


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
