"""The scripts beside the data of results pages."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from train.experiments.analysis import module_at

RESULTS = Path(__file__).parents[1] / "docs" / "results"
DATA = RESULTS / "data"


@cache
def script(study: str, name: str = "analysis") -> Any:
    """The module in `docs/results/data/STUDY/NAME.py`."""
    return module_at(DATA / study / f"{name}.py")


@cache
def tables_of(study: str) -> dict[str, str]:
    """The tables that the analysis of a study makes, by title."""
    return script(study).tables(DATA / study)
