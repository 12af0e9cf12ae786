"""The scripts beside the data of results pages, and the sections of these pages."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

from train.experiments.analysis import module_at

RESULTS = Path(__file__).parents[1] / "docs" / "results"
DATA = RESULTS / "data"
PAGES = {"reacher_bars": "arm", "effects": "index"}
"""The pages of studies whose names are not those of their pages."""
BESIDE = {"self_play_mixing": ["self_play_entropy"]}
"""By page the folders of data, besides its own, whose README has tables of its analysis."""
HEADINGS = ("How it was measured", "What would break it", "Related work", "Repeat it")
"""Of a results page, after its answer."""


@cache
def script(study: str, name: str = "analysis") -> Any:
    """The module in `docs/results/data/STUDY/NAME.py`."""
    return module_at(DATA / study / f"{name}.py")


def readme_of(page: str) -> Path:
    """The README beside the rows of the study of a page."""
    study = next((study for study, own in PAGES.items() if own == page), page)
    return DATA / study / "README.md"


def text_of(page: str) -> str:
    """A page of results, if there is one, with the further tables in READMEs beside its rows."""
    readmes = [readme_of(page), *(DATA / folder / "README.md" for folder in BESIDE.get(page, ()))]
    parts = [path for path in (RESULTS / f"{page}.md", *readmes) if path.exists()]
    return "\n".join(path.read_text(encoding="utf-8") for path in parts)


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
