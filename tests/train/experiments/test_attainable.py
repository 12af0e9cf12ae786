"""What a plan says beforehand, against the tests themselves on the most extreme results."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from train.commands.main import main
from train.experiments.attainable import comparison_out_of_reach, out_of_reach
from train.experiments.statistics import holm, permutation_p, sign_flip_p
from train.experiments.study import Study


def plan(variants: int, tasks: int, seeds: int, kind: str, primary: str | None) -> Study:
    names = ["control", *(f"v{number}" for number in range(variants))]
    runs: Any = [
        SimpleNamespace(label={"variant": name, "maze": str(task)}, seed=seed, kind=kind)
        for name in names
        for task in range(tasks)
        for seed in range(seeds)
    ]
    report = {"variants": names, "control": "control", "primary": primary, "x": "maze"}
    return Study("a plan", tuple(runs), report)


@pytest.mark.parametrize("kind", ["single", "self-play"])
@pytest.mark.parametrize(("variants", "primary"), [(1, None), (3, None), (3, "v1"), (7, None)])
def test_p_is_out_of_reach_exactly_where_the_most_extreme_runs_do_not_reach_it(
    kind: str, variants: int, primary: str | None
) -> None:
    for tasks in (1, 2, 6, 9):
        for seeds in (2, 3, 4, 5):
            ours, theirs = [[0.0 + i for i in range(seeds)]], [[50.0 + i for i in range(seeds)]]
            if kind == "self-play" and tasks > 1:
                p = sign_flip_p(np.arange(1.0, 1.0 + tasks))
            else:
                p = permutation_p(ours * tasks, theirs * tasks)
            corrected = holm([p] * (variants - (primary is not None)))
            lines = " ".join(out_of_reach(plan(variants, tasks, seeds, kind, primary)))
            assert ("v0" in lines) == (corrected[0] >= 0.05), (tasks, seeds, lines)
            if primary:
                assert (primary in lines) == (p >= 0.05)
            if kind == "single" and lines and "or more" in lines:  # the remedy is one
                enough = max(int(part.split()[0]) for part in lines.split("give ")[1:])
                assert not out_of_reach(plan(variants, tasks, enough, kind, primary))


@pytest.mark.parametrize("seeds", [2, 3, 4, 5])
def test_a_comparison_of_libraries_says_so_too(seeds: int) -> None:
    p = permutation_p([[float(n) for n in range(seeds)]], [[9.0 + n for n in range(seeds)]])
    assert bool(comparison_out_of_reach(seeds)) == (p >= 0.05)


def test_the_dry_run_of_a_shipped_study_says_it(capsys: pytest.CaptureFixture[str]) -> None:
    main(["ablate", "self-play-methods", "--dry-run"])
    assert "with 6 mazes the least p is 0.031, corrected for 8 comparisons" in (
        capsys.readouterr().out
    )
