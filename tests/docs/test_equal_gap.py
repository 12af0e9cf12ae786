"""The study of errors at an equal gap: its rows are complete; made rows."""

from __future__ import annotations

from itertools import combinations

import pytest
from analyses import DATA, script

from train.experiments.committed import read_table

study, made = script("equal_gap"), script("equal_gap", "make_rows")


def test_all_runs_and_pairs_have_rows() -> None:
    runs, pairs = (read_table(DATA / "equal_gap" / f"{name}.csv") for name in ("runs", "pairs"))
    per_maze = len(study.CURRICULA) * made.SEEDS
    assert len(runs) == len(made.MAZES) * per_maze
    assert len(pairs) == len(made.MAZES) * per_maze * (per_maze - 1) // 2


def test_differences_are_those_of_made_rows() -> None:
    """Runs of a curriculum correlate by 0.5, of two by 0.2, and of the first two by 0.4."""
    runs = [(name, seed) for name in study.CURRICULA for seed in range(2)]
    pairs = []
    for (one, first), (two, second) in combinations(runs, 2):
        likeness = 0.5 if one == two else 0.4 if study.CURRICULA[2] not in (one, two) else 0.2
        pairs.append({"maze": "a", "one": two, "one_seed": second, "two": one, "two_seed": first})
        pairs[-1]["spearman"] = likeness
    assert study.differences(pairs, study.CURRICULA[:2]) == pytest.approx([0.1])
    assert study.differences(pairs, study.CURRICULA) == pytest.approx([0.5 - (0.4 + 0.2 + 0.2) / 3])
