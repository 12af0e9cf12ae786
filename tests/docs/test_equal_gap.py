"""The study of errors at an equal gap: the tables of its page, and made rows."""

from __future__ import annotations

from importlib import import_module
from itertools import combinations
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


study = import_module("equal_gap")


def test_the_tables_of_the_page_are_those_of_the_rows() -> None:
    page = (ROOT / "docs" / "results" / "equal_gap.md").read_text(encoding="utf-8")
    for table in study.tables():
        assert table in page, table
    runs, pairs = study.rows_of("runs"), study.rows_of("pairs")
    per_maze = len(study.CURRICULA) * study.SEEDS
    assert len(runs) == len(study.MAZES) * per_maze
    assert len(pairs) == len(study.MAZES) * per_maze * (per_maze - 1) // 2


def test_differences_are_those_of_made_rows() -> None:
    """Runs of a curriculum correlate by 0.5, of two by 0.2, and of the first two by 0.4."""
    runs = [(name, seed) for name in study.CURRICULA for seed in range(2)]
    pairs = []
    for (one, first), (two, second) in combinations(runs, 2):
        likeness = 0.5 if one == two else 0.4 if study.CURRICULA[2] not in (one, two) else 0.2
        pairs.append({"maze": "a", "one": two, "one_seed": second, "two": one, "two_seed": first})
        pairs[-1]["spearman"] = str(likeness)
    assert study.differences(pairs, study.CURRICULA[:2]) == pytest.approx([0.1])
    assert study.differences(pairs, study.CURRICULA) == pytest.approx([0.5 - (0.4 + 0.2 + 0.2) / 3])
