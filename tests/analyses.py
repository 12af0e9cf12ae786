"""The scripts beside the data of results pages."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from train.experiments.analysis import module_at

RESULTS = Path(__file__).parents[1] / "docs" / "results"
DATA = RESULTS / "data"


def basis_of(text: str) -> str:
    """What a results page says of its runs: how it was measured, or its first lines."""
    if (head := "\n## How it was measured\n") in text:
        return text.partition(head)[2].partition("\n## ")[0]
    return text.partition("\n\n")[2].partition("\n\n")[0]


@cache
def script(study: str, name: str = "analysis") -> Any:
    """The module in `docs/results/data/STUDY/NAME.py`."""
    return module_at(DATA / study / f"{name}.py")


@cache
def tables_of(study: str) -> dict[str, str]:
    """The tables that the analysis of a study makes, by title."""
    return script(study).tables(DATA / study)
