"""Statistics over few seeds: against SciPy, and their coverage in simulations."""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.stats import mannwhitneyu

from train.experiments.measures import interval_of, measure_of_rows
from train.experiments.statistics import (
    difference_interval,
    distance_interval,
    first_below,
    holm,
    improvement,
    interquartile_mean,
    logrank_p,
    mean_interval,
    mean_over,
    permutation_p,
    probability_of_improvement,
    ratio_with_interval,
    regression,
)

SPREAD: dict[str, tuple[float, Callable[..., Any]]] = {
    "normal": (0.0, lambda rng, size: rng.normal(size=size)),
    "uniform": (0.5, lambda rng, size: rng.random(size)),
    "two-sided exponential": (0.0, lambda rng, size: rng.laplace(size=size)),
    "somewhat to one side": (4.0, lambda rng, size: rng.gamma(4.0, size=size)),
}


@pytest.mark.parametrize("spread", SPREAD)
@pytest.mark.parametrize("runs", [2, 3, 5, 10, 20])
def test_the_interval_of_a_mean_covers_it_at_every_number_of_runs(runs: int, spread: str) -> None:
    truth, draw = SPREAD[spread]
    drawn = draw(np.random.default_rng(runs), (1500, runs))
    ends = np.array([mean_interval([sample]) for sample in drawn])
    covered = np.mean((ends[:, 0] <= truth) & (truth <= ends[:, 1]))
    assert 0.9 < covered < 0.985


@pytest.mark.parametrize("shift", [0.0, 1.0, 2.0, 4.0])
@pytest.mark.parametrize(("runs", "tasks"), [(3, 1), (5, 1), (10, 1), (3, 3)])
def test_the_interval_of_p_covers_it_even_if_all_runs_of_one_side_are_lower(
    runs: int, tasks: int, shift: float
) -> None:
    rng, covered = np.random.default_rng(runs), 0
    truth = float(stats.norm.cdf(shift / np.sqrt(2.0)))
    for _ in range(400):
        ours = rng.normal(size=(tasks, runs)).tolist()
        _, (low, high) = probability_of_improvement(
            ours, rng.normal(shift, size=(tasks, runs)).tolist()
        )
        covered += low <= truth <= high
    # At 3 against 3 U has 10 values, and a tenth of all cases are its ends.
    assert covered / 400 > (0.87 if (runs, tasks) == (3, 1) else 0.915)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_interval_of_a_distance_has_one_sign_and_the_same_coverage(sign: float) -> None:
    drawn = sign * np.random.default_rng(4).gamma(1.0, size=(1500, 4))
    plain, cut = (
        np.array([interval([sample]) for sample in drawn])
        for interval in (mean_interval, distance_interval)
    )
    assert ((plain * sign).min(axis=1) < 0.0).mean() > 0.05 and (cut * sign >= 0.0).all()
    for ends in (plain, cut):
        assert np.array_equal((ends <= sign), (plain <= sign))
    inside = (plain * sign >= 0.0).all(axis=1)
    assert np.array_equal(cut[inside], plain[inside])
    assert np.isnan(distance_interval([[1.0]])).all()


def test_the_interval_of_returns_goes_beyond_0() -> None:
    values = [-4.0, -1.0, 0.5]
    returns = measure_of_rows([{"objective": "mean_return", "unit": "return"}])
    goals = measure_of_rows([{"objective": "mean_goals", "unit": "goals"}])
    assert interval_of(returns, values) == mean_interval([values])
    assert interval_of(returns, values)[1] > 0.0
    assert interval_of(goals, [0.1, 0.2, 1.5])[0] == 0.0


def test_three_against_three_never_gives_an_interval_of_width_0() -> None:
    point, (low, high) = probability_of_improvement([[1, 2, 3]], [[4, 5, 6]])
    assert point == 1.0 == high and 0.45 < low < 0.55
    assert probability_of_improvement([[4, 5, 6]], [[1, 2, 3]])[1] == pytest.approx((0.0, 1 - low))


def test_intervals_of_means_are_scipys() -> None:
    rng = np.random.default_rng(1)
    own, other = rng.normal(size=5), rng.normal(1.0, 3.0, size=7)
    assert mean_interval([own]) == pytest.approx(stats.ttest_1samp(own, 0).confidence_interval())
    welch = stats.ttest_ind(own, other, equal_var=False).confidence_interval(0.9)
    assert difference_interval([own], [other], 0.9) == pytest.approx((welch.low, welch.high))
    # Two tasks of very different size, each with equal seeds: nothing is uncertain.
    assert mean_interval([[1.0, 1.0], [9.0, 9.0]]) == (5.0, 5.0)
    # Half the difference of two tasks is the mean of one and of the other's negative.
    halves = difference_interval([own / 2], [other / 2])
    assert mean_interval([own, -other]) == pytest.approx(halves)
    assert np.isnan(mean_interval([[1.0, 2.0], [9.0]])).all()


def test_holms_correction_is_closed_testing_with_bonferroni() -> None:
    ps = np.random.default_rng(0).random(5) ** 3
    sets = [set(c) for size in range(1, 6) for c in combinations(range(5), size)]
    closed = [
        max(min(1.0, len(s) * min(ps[list(s)])) for s in sets if number in s) for number in range(5)
    ]
    assert holm(ps.tolist()) == pytest.approx(closed)
    assert holm([0.03, float("nan"), 0.02])[::2] == pytest.approx([0.04, 0.04])
    assert np.isnan(holm([0.03, float("nan")])[1]) and holm([]) == []


def logrank_by_hand(
    tasks: Sequence[tuple[Sequence[float], Sequence[float]]], end: float
) -> tuple[float, float]:
    """Sum over tasks and times of observed minus expected, and of the variances, as published."""
    difference = variance = 0.0
    for ours, theirs in tasks:
        for time in sorted({t for t in (*ours, *theirs) if t < end}):
            a, b = sum(t >= time for t in ours), sum(t >= time for t in theirs)
            n, got = a + b, sum(t == time for t in (*ours, *theirs))
            difference += sum(t == time for t in ours) - got * a / n
            variance += got * (a / n) * (b / n) * (n - got) / (n - 1) if n > 1 else 0.0
    return difference, variance


def test_the_log_rank_test_is_that_of_its_definition() -> None:
    ours, theirs = [2.0, 3.0, np.inf], [3.0, 5.0, np.inf, np.inf]
    difference, variance = logrank_by_hand([(ours, theirs)], 9.0)
    p = 2.0 * stats.norm.sf(abs(difference) / variance**0.5)
    assert logrank_p([ours], [theirs], ([[9.0] * 3], [[9.0] * 4])) == pytest.approx(p)
    assert np.isnan(logrank_p([[np.inf]], [[np.inf]], ([[1.0]], [[1.0]])))
    assert np.isnan(logrank_p([[1.0]], [[]], ([[1.0]], [[]])))


def test_the_log_rank_test_of_one_task_is_scipys() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        times, ends = rng.integers(1, 9, (2, 6)).astype(float), rng.integers(1, 9, (2, 6))
        got = times <= ends
        got[0, 0] = True
        samples = [
            stats.CensoredData.right_censored(np.where(g, t, e), ~g)
            for g, t, e in zip(got, times, ends, strict=True)
        ]
        ours, theirs = (np.where(g, t, np.inf).tolist() for g, t in zip(got, times, strict=True))
        found = logrank_p([ours], [theirs], ([ends[0].tolist()], [ends[1].tolist()]))
        assert found == pytest.approx(stats.logrank(*samples).pvalue)


def test_the_log_rank_test_of_two_tasks_compares_within_them() -> None:
    # R's survdiff gives chi-squared 2.14673 for these; two tasks like this have twice the sum of
    # the differences and twice that of the variances, so twice the chi-squared. Ends that are no
    # arrivals are censored.
    inf = np.inf
    ours, our_ends = [inf, 1.0, 2.0, 3.0, inf, inf, 5.0, inf], [3.0, 1, 2, 3, 2, 1, 5, 3]
    theirs = [inf, 1.0, inf, inf, 7.0, inf, 5.0, inf, 9.0]
    their_ends = [1.0, 1, 2, 3, 7, 1, 5, 3, 9]
    for tasks in (1, 2):
        p = logrank_p([ours] * tasks, [theirs] * tasks, ([our_ends] * tasks, [their_ends] * tasks))
        assert p == pytest.approx(stats.chi2.sf(tasks * 2.14673, 1), abs=1e-5)


def test_the_log_rank_test_of_tasks_of_different_speed_is_not_that_of_all_runs_together() -> None:
    # Sooner in each task, but most of its runs are in the slow one: pooled it seems to be late.
    tasks = [([1.0, 2.0], [3.0, 4.0, 5.0, 6.0, 7.0]), ([50.0, 51.0, 52.0, 53.0], [60.0, 61.0])]
    ends = tuple([[99.0] * len(task[side]) for task in tasks] for side in (0, 1))
    difference, variance = logrank_by_hand(tasks, 99.0)
    p = 2.0 * stats.norm.sf(abs(difference) / variance**0.5)
    found = logrank_p([task[0] for task in tasks], [task[1] for task in tasks], ends)
    assert found == pytest.approx(p) and p < 0.01
    pooled = [[t for task in tasks for t in task[side]] for side in (0, 1)]
    assert logrank_p([pooled[0]], [pooled[1]], ([[99.0] * 6], [[99.0] * 7])) > 0.1


def test_the_stratified_log_rank_test_has_its_nominal_level() -> None:
    rng, rejected = np.random.default_rng(1), 0
    ends = [[3.0] * 8, [30.0] * 8]
    for _ in range(1000):
        drawn = rng.exponential([[[1.0], [10.0]]] * 2, (2, 2, 8))
        sides = np.where(drawn < np.array(ends), drawn, np.inf).tolist()
        rejected += logrank_p(sides[0], sides[1], (ends, ends)) < 0.05
    assert 0.03 < rejected / 1000 < 0.07


def test_the_interquartile_mean_is_that_of_the_middle_half() -> None:
    generator = np.random.default_rng(0)
    for count in (4, 8, 20, 40):
        values = generator.normal(size=count)
        assert interquartile_mean(list(values)) == pytest.approx(stats.trim_mean(values, 0.25))
    assert interquartile_mean([3.0]) == 3.0
    assert interquartile_mean([1.0, 2.0]) == pytest.approx(1.5)
    assert interquartile_mean([0.0, 1.0, 100.0]) == pytest.approx((0.25 * 0 + 1 + 25.0) / 1.5)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40))
def test_the_interquartile_mean_is_scipys_trimmed_mean(values: list[float]) -> None:
    four = np.repeat(values, 4)  # a multiple of four: nothing is cut in two
    assert interquartile_mean(list(four)) == pytest.approx(stats.trim_mean(four, 0.25), abs=1e-9)
    assert min(values) - 1e-9 <= interquartile_mean(values) <= max(values) + 1e-9


def test_the_interquartile_mean_allows_infinite_values() -> None:
    assert interquartile_mean([1.0, 2.0, 3.0, float("inf")]) == 2.5
    assert interquartile_mean([1, 2, 3, 100]) == 2.5


@given(
    st.lists(st.integers(0, 6), min_size=1, max_size=9),
    st.lists(st.integers(0, 6), min_size=1, max_size=9),
)
def test_improvement_is_mann_and_whitneys_u(ours: list[int], theirs: list[int]) -> None:
    u = stats.mannwhitneyu(theirs, ours).statistic  # pairs in which ours is lower, ties half
    found = improvement(np.array(ours, float), np.array(theirs, float))
    assert float(found) == pytest.approx(u / (len(ours) * len(theirs)))


def test_the_probability_of_improvement_over_tasks_is_their_mean() -> None:
    point, (low, high) = probability_of_improvement([[1, 2, 3], [5, 6]], [[4, 5, 6], [5, 6]])
    assert point == pytest.approx((1.0 + 0.5) / 2) and low < point < high
    assert probability_of_improvement([[2.0] * 3], [[2.0] * 3])[0] == 0.5
    assert np.isnan(probability_of_improvement([[1.0]], [[2.0]])[1][0])


def test_times_and_areas() -> None:
    assert first_below([1, 2, 3], [9.0, 5.0, 7.0], 5.0) == 2
    assert first_below([1, 2, 3], [9.0, 5.0, 7.0], 4.0) == float("inf")
    assert mean_over([0, 1, 3], [0.0, 1.0, 1.0]) == pytest.approx(2.5 / 3)
    assert mean_over([2], [7.0]) == 7.0


def test_the_p_value_is_mann_and_whitneys_where_there_are_no_ties() -> None:
    rng = np.random.default_rng(0)
    for ours, theirs in ((3, 3), (4, 4), (5, 3), (7, 6)):
        own, other = rng.normal(size=ours), rng.normal(0.8, size=theirs)
        exact = mannwhitneyu(own, other, method="exact").pvalue
        assert permutation_p([list(own)], [list(other)]) == pytest.approx(exact)
    assert permutation_p([[1, 2, 3]], [[4, 5, 6]]) == pytest.approx(0.1)
    assert permutation_p([[1, 2, 3, 4]], [[5, 6, 7, 8]]) == pytest.approx(2 / 70)
    assert permutation_p([[1.0]], [[2.0, 3.0]]) == pytest.approx(2 / 3, abs=0.02)
    # Two tasks: differences of opposite sign cancel.
    alike = permutation_p([[1, 2, 3], [4, 5, 6]], [[4, 5, 6], [1, 2, 3]])
    apart = permutation_p([[1, 2, 3], [1, 2, 3]], [[4, 5, 6], [4, 5, 6]])
    assert alike == pytest.approx(1.0) and apart == pytest.approx(2 / 400, abs=0.003)


def test_the_p_value_of_several_tasks_is_that_of_all_splits_within_them() -> None:
    rng = np.random.default_rng(3)
    ours = [rng.normal(size=size).round(1).tolist() for size in (4, 3)]
    theirs = [rng.normal(0.8, size=4).round(1).tolist() for _ in range(2)]
    every = []
    for own, other in zip(ours, theirs, strict=True):
        pool = np.array([*own, *other])
        splits = [list(chosen) for chosen in combinations(range(len(pool)), len(own))]
        every.append([float(improvement(pool[s], np.delete(pool, s))) for s in splits])
    apart = abs(np.add.outer(*map(np.array, every)) / 2 - 0.5)
    found = abs(probability_of_improvement(ours, theirs)[0] - 0.5)
    exact = float(np.mean(apart >= found - 1e-9))
    assert 0.01 < exact < 0.5 and permutation_p(ours, theirs) == pytest.approx(exact, abs=0.01)


def test_the_mean_over_a_curve_is_its_area_over_its_range() -> None:
    assert mean_over([0.0, 1.0, 3.0], [0.0, 2.0, 2.0]) == pytest.approx(5.0 / 3.0)
    assert mean_over([0.0, 1.0, 1.0], [0.0, 2.0, 4.0]) == pytest.approx(1.0)
    assert mean_over([2.0, 2.0], [1.0, 5.0]) == mean_over([2.0], [5.0]) == 5.0


def test_robust_errors_are_those_of_leaving_one_observation_out() -> None:
    rng = np.random.default_rng(0)
    x, noise = rng.random((12, 2)), rng.normal(size=12)
    y = 3.0 * x[:, 0] + noise * (1.0 + 4.0 * x[:, 1])
    found, low, high = np.array(regression(y, *x.T)).T
    design = np.column_stack([x, np.ones(12)])

    def fitted(left: Any) -> Any:
        return np.linalg.lstsq(design[left], y[left], rcond=None)[0]

    assert found == pytest.approx(fitted(np.ones(12, dtype=bool)))
    without = [fitted(np.arange(12) != one) for one in range(12)]
    # HC3 is the sum of squared changes by leaving one observation out (MacKinnon and White, 1985).
    errors = np.sqrt(((np.array(without) - found) ** 2).sum(axis=0))
    assert (high - low) / 2.0 == pytest.approx(stats.t.ppf(0.975, 9) * errors)
    assert (high + low) / 2.0 == pytest.approx(found)


def test_the_interval_of_a_ratio_is_that_of_its_logarithms() -> None:
    logs = [0.1, -0.2, 0.4]
    expected = np.exp([np.mean(logs), *mean_interval([logs])])
    assert ratio_with_interval(logs) == pytest.approx(expected.tolist())
