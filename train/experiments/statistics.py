"""Confidence intervals and significance tests for few seeds.

Means have Student's intervals, probabilities of improvement have Newcombe's. A percentile bootstrap
of 3 to 9 values covers the true value in 50 to 90 % of the cases instead of 95, and shrinks to a
point if all values of one side are lower. The intervals used here are valid from 3 values on, which
a test simulates. SciPy provides the tests; this module adds the stratification by task.
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

from train.files import Plain

NAN = float("nan")
LEVEL = 0.05
"""Of significance: corrected values of p below it decide."""
PERMUTATIONS = 20_000
Interval = tuple[float, float]


def bounded(name: str, value: float, interval: Interval) -> dict[str, float]:
    """A value and its interval as entries of a row: NAME, NAME_low, NAME_high."""
    return {name: value, f"{name}_low": interval[0], f"{name}_high": interval[1]}


def interquartile_mean(values: Sequence[float]) -> float:
    """The mean of the middle half of at least one value.

    Values at the quartiles have the weight of their part inside the middle half, so any number of
    values is allowed. For a multiple of 4 this is `scipy.stats.trim_mean(values, 0.25)`.
    """
    return float(trim_mean(np.repeat(np.asarray(values, dtype=np.float64), 4), 0.25))


def mean_interval(tasks: Sequence[Sequence[float]], level: float = 0.95) -> Interval:
    """Student's interval of the mean over tasks of the mean of their runs.

    For several tasks the degrees of freedom are those of Welch and Satterthwaite (1946). The
    coverage is the nominal one if the values are distributed symmetrically, and lower if they are
    skewed. If some runs solve their task and others do not, report their numbers instead.

    Args:
        tasks: the values of every task, one per seed.
        level: the confidence level.

    Returns:
        (nan, nan) if a task has a single value.
    """
    return _welch([(np.asarray(task, dtype=np.float64), 1.0) for task in tasks], level)


def distance_interval(tasks: Sequence[Sequence[float]], level: float = 0.95) -> Interval:
    """`mean_interval` of values that all have one sign, such as gaps to an optimum.

    The interval is cut off at 0, which does not change its coverage.
    """
    low, high = mean_interval(tasks, level)
    if np.mean([np.mean(task) for task in tasks]) >= 0.0:
        return (0.0 if low < 0.0 else low), high
    return low, (0.0 if high > 0.0 else high)


def difference_interval(
    ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]], level: float = 0.95
) -> Interval:
    """Welch's interval of the difference of two means, `ours` minus `theirs`, as `mean_interval`.

    It lies within a margin at level 0.9 exactly if two one-sided tests at 0.05 show that the means
    differ by less than the margin (Schuirmann, 1987).
    """
    signed = [(own, 1.0) for own in ours] + [(other, -1.0) for other in theirs]
    both = [(np.asarray(task, dtype=np.float64), sign * 2.0) for task, sign in signed]
    return _welch(both, level)  # times 2, because each mean is over half of the samples


def _welch(samples: Sequence[tuple[NDArray[np.float64], float]], level: float) -> Interval:
    """The interval of the mean over samples of their means, each times its weight."""
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


def ratio_with_interval(logs: Sequence[float]) -> list[float]:
    """A geometric mean of ratios and its 95 % interval, from their logarithms, as `mean_interval`:
    [ratio, low, high]."""
    return [float(np.exp(value)) for value in (np.mean(logs), *mean_interval([logs]))]


def regression(y: ArrayLike, *columns: ArrayLike) -> list[list[float]]:
    """Ordinary least squares with intervals that allow for unequal variances.

    Standard errors are those of MacKinnon and White (1985), HC3; intervals are Student's.

    Args:
        y: [n].
        columns: [n] each; a constant is added.

    Returns:
        [coefficient, low, high], with its 95 % interval, of each column and of the constant, last.
    """
    outcome = np.asarray(y, dtype=np.float64)
    x = np.stack([*map(np.asarray, columns), np.ones(len(outcome))], axis=1)
    inverse = np.linalg.inv(x.T @ x)
    fitted = inverse @ x.T @ outcome
    leverage = ((x @ inverse) * x).sum(axis=1)
    weights = ((outcome - x @ fitted) / (1.0 - leverage)) ** 2
    errors = np.sqrt(np.diag(inverse @ (x.T * weights) @ x @ inverse))
    half = student.ppf(0.975, len(outcome) - len(fitted)) * errors
    return np.stack([fitted, fitted - half, fitted + half], axis=1).tolist()


def improvement(ours: ArrayLike, theirs: ArrayLike) -> NDArray[np.float64]:
    """The share of pairs with the lower value in `ours`; ties count half.

    This is Mann and Whitney's U divided by the number of pairs.

    Args:
        ours: [..., n].
        theirs: [..., m].

    Returns:
        [...].
    """
    difference = np.asarray(theirs)[..., None, :] - np.asarray(ours)[..., :, None]
    return np.asarray(0.5 + 0.5 * np.sign(difference).mean(axis=(-1, -2)))


def _mean_improvement(ours: Sequence[Any], theirs: Sequence[Any]) -> Any:
    """The mean of `improvement` over tasks."""
    return np.mean([improvement(*task) for task in zip(ours, theirs, strict=True)], axis=0)


def probability_of_improvement(
    ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]]
) -> tuple[float, Interval]:
    """The probability that a run of `ours` ends lower than one of `theirs`, with its 95 % interval.

    It is the mean over tasks of `improvement`. The interval is that of Newcombe (2006, Confidence
    intervals for an effect size measure based on the Mann-Whitney statistic, part 2, method 5),
    with the mean variance of the tasks. It does not shrink to a point at 0 and 1.

    Args:
        ours, theirs: one value per seed for each task, in the same order; lower is better.

    Returns:
        The interval is (nan, nan) if a task has a single run of one side.
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

    inner = min(max(point, 1e-9), 1.0 - 1e-9)  # the roots at 0 and 1 are not meant
    low = 0.0 if point == 0.0 else float(brentq(beyond, 0.0, inner))
    high = 1.0 if point == 1.0 else float(brentq(beyond, inner, 1.0))
    return point, (low, high)


def permutation_p(ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]]) -> float:
    """The p of a two-sided permutation test of `probability_of_improvement` against 0.5.

    For one task it is exact, over all splits of the runs; without ties it is that of Mann and
    Whitney. `PERMUTATIONS` random splits within the tasks are used for several tasks, for a single
    run, and if there are more splits than that.
    """
    sizes, rng = [len(own) for own in ours], np.random.default_rng(0)
    pools = [np.array([*task[0], *task[1]], float) for task in zip(ours, theirs, strict=True)]

    def apart(own: Sequence[Any], other: Sequence[Any]) -> Any:
        return abs(_mean_improvement(own, other) - 0.5)

    def apart_in(*pools: Any, axis: int) -> Any:
        halves = [np.split(pool, [size], axis) for pool, size in zip(pools, sizes, strict=True)]
        return apart(*zip(*halves, strict=True))

    options: Plain = {"n_resamples": PERMUTATIONS, "vectorized": True, "alternative": "greater"}
    exact = len(pools) == 1 and comb(len(pools[0]), sizes[0]) <= PERMUTATIONS
    if exact and min(sizes[0], len(theirs[0])) > 1:
        both = (ours[0], theirs[0])
        test = permutation_test(both, lambda a, b, axis: apart([a], [b]), **options)
        return float(test.pvalue)
    anew: Any = [  # one per sample, which SciPy's stubs do not allow
        lambda size, pool=pool: rng.permuted(np.broadcast_to(pool, size), axis=-1) for pool in pools
    ]
    return float(monte_carlo_test(pools, anew, apart_in, **options).pvalue)


def sign_flip_p(differences: ArrayLike) -> float:
    """The p of a two-sided test that paired differences [n] are symmetric around 0.

    The statistic is their mean under changes of their signs: all 2**n changes if these are at most
    `PERMUTATIONS` (up to n = 14), otherwise that many random ones. For the smallest p see
    `least_sign_flip_p`.
    """
    values = np.asarray(differences, dtype=np.float64)
    options: Plain = {"n_resamples": PERMUTATIONS, "permutation_type": "samples", "rng": 0}
    return float(permutation_test((values,), np.mean, vectorized=True, **options).pvalue)


def least_sign_flip_p(count: int) -> float:
    """The smallest p that `sign_flip_p` can give for so many differences.

    2 of the 2**count changes of signs are the most extreme; with random ones it is 2 over their
    number plus 1.
    """
    return 2.0 / 2**count if 2**count <= PERMUTATIONS else 2.0 / (PERMUTATIONS + 1)


def least_p(sizes: Sequence[tuple[int, int]]) -> float:
    """The smallest p that `permutation_p` can give for these numbers of runs.

    Two splits are the most extreme: all runs of `ours` are lower than all of `theirs` in every
    task, or the reverse. So the smallest p is 2 over the number of splits. With random splits
    (`PERMUTATIONS`) it is also at least 1 over their number plus 1.

    Args:
        sizes: the numbers of runs of `ours` and `theirs` for each task, at least 1.
    """
    splits = prod(comb(ours + theirs, ours) for ours, theirs in sizes)
    least = 2.0 / splits
    exact = len(sizes) == 1 and splits <= PERMUTATIONS
    return least if exact else max(least, 1.0 / (PERMUTATIONS + 1))


def holm(ps: Sequence[float]) -> list[float]:
    """Holm's correction (1979) for multiple comparisons; nan are kept and not counted."""
    order = sorted((number for number, p in enumerate(ps) if p == p), key=lambda n: ps[n])
    corrected, least = list(ps), 0.0
    for rank, number in enumerate(order):
        least = max(least, min(1.0, (len(order) - rank) * ps[number]))
        corrected[number] = least
    return corrected


def logrank_p(
    ours: Sequence[Sequence[float]],
    theirs: Sequence[Sequence[float]],
    ends: tuple[Sequence[Sequence[float]], Sequence[Sequence[float]]],
) -> float:
    """The p of a two-sided log-rank test (Mantel, 1966) of times to an event, stratified by task.

    Observed minus expected numbers and their hypergeometric variances are summed over tasks. A task
    with runs of one side only has no effect.

    Args:
        ours, theirs: the times of all runs for each task, in the same order; inf without an event.
        ends: likewise, the durations of all runs: runs without an event are censored at their end.

    Returns:
        nan if there is no event, or all events are at the same time.
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


def first_below(x: ArrayLike, values: ArrayLike, threshold: float) -> float:
    """The first `x` at which `values` is at most the threshold; inf if there is none."""
    below = np.flatnonzero(np.asarray(values) <= threshold)
    return float(np.asarray(x)[below[0]]) if len(below) else float("inf")


def mean_over(x: ArrayLike, values: ArrayLike) -> float:
    """The mean of a curve over the range of `x`: its area (trapezoids) divided by the range."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if len(x) == 1 or x[-1] == x[0]:
        return float(y[-1])
    return float(np.trapezoid(y, x) / (x[-1] - x[0]))
