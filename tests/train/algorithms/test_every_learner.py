"""Every learner of the registry reaches a gap on two small tasks, within a budget in frames."""

from __future__ import annotations

import pytest
from benchmarks.bench_learners import CASES, Case, measure

from train.algorithms.registry import ALGORITHMS


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_learner_has_two_cases(name: str) -> None:
    found = {case.task for case in CASES if case.algorithm == name}
    assert len(found) >= 2, f"add cases of {name!r} to tools/benchmarks/bench_learners.py"


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.algorithm}, {case.task}")
def test_it_reaches_the_bound_by_learning(case: Case) -> None:
    """After one iteration alone the gap is above the bound."""
    assert measure(case).gap <= case.bound
    assert measure(case._replace(frames=1)).gap > case.bound
