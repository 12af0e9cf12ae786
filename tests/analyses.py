"""The scripts beside the data of results pages, and the sections of these pages."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

from train.experiments.analysis import module_at

RESULTS = Path(__file__).parents[1] / "docs" / "results"
DATA = RESULTS / "data"
HEADINGS = ("How it was measured", "What would break it", "Related work", "Repeat it")
"""Of a results page, after its answer."""


@cache
def script(study: str, name: str = "analysis") -> Any:
    """The module in `docs/results/data/STUDY/NAME.py`."""
    return module_at(DATA / study / f"{name}.py")


@cache
def tables_of(study: str) -> dict[str, str]:
    """The tables that the analysis of a study makes, by title."""
    return script(study).tables(DATA / study)


def sections_of(page: str) -> dict[str, str]:
    """The text of a results page under each heading; under "" what stands before the first."""
    text = (RESULTS / f"{page}.md").read_text(encoding="utf-8")
    first, *others = re.split(r"^## ", text, flags=re.MULTILINE)
    return {"": first} | {head: rest for head, _, rest in (each.partition("\n") for each in others)}


def measured(page: str) -> str:
    """What a results page says of how it was measured: a section, else the first paragraph."""
    sections = sections_of(page)
    return sections.get(HEADINGS[0]) or sections[""].split("\n\n")[1]
