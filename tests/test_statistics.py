"""Statistics over seeds, against SciPy and by how often they hold."""

import numpy as np
import pytest
from scipy.stats import trim_mean

from train.experiments.statistics import bootstrap_interval, interquartile_mean


def test_the_interquartile_mean_and_the_interval_are_right() -> None:
    generator = np.random.default_rng(0)
    for count in (4, 8, 20, 40):
        values = generator.normal(size=count)
        assert interquartile_mean(list(values)) == pytest.approx(trim_mean(values, 0.25))
    assert interquartile_mean([3.0]) == 3.0
    assert interquartile_mean([1.0, 2.0]) == pytest.approx(1.5)
    assert interquartile_mean([0.0, 1.0, 100.0]) == pytest.approx((0.25 * 0 + 1 + 25.0) / 1.5)
    covered = 0
    for _ in range(200):
        low, high = bootstrap_interval(list(generator.normal(size=30)))
        covered += low <= 0.0 <= high
    assert 180 <= covered <= 199  # of 95 %, a little fewer at 30 values
    assert np.isnan(bootstrap_interval([1.0])).all()
    assert bootstrap_interval([2.0, 2.0]) == (2.0, 2.0)
