"""Analyses of studies: a file `analysis.py` beside their rows, which makes a results page.

It defines `tables(data)`, which returns the tables of the page as Markdown by title from the files
in the folder `data`, and if the page has pictures `figures(data, out)`, which draws them into the
folder `out`.
"""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pursuit.plugins import check_allowed, reading
from pursuit.validation import check, raised, shortened
from train.files import begins_with, only_one, write_bytes
from train.reports.pages import write_markdown
from train.reports.tables import in_markdown

ANALYSIS = "analysis.py"
TITLE = "Results of "
"""Start of the titles of reports of analyses."""


def module_at(path: Path) -> Any:
    """Import the module in a file, under the name of the file, without keeping it.

    Raises:
        ValueError: it cannot be imported.
    """
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # the module may raise anything
        raise ValueError(f"{path}: cannot be imported ({raised(error)}); correct it") from error
    return module


def read_analysis(folder: Path) -> Any:
    """The module `analysis.py` of a folder.

    Raises:
        ValueError: the module "analysis" is not allowed, it cannot be imported, or has no tables.
    """
    with reading(folder):
        check_allowed("analysis:tables")
    module = module_at(folder / ANALYSIS)
    check(
        callable(getattr(module, "tables", None)),
        f"{folder / ANALYSIS}: has no function tables; define tables(data), which returns Markdown "
        "by title",
    )
    return module


def report_analysis(folder: Path, out: Path) -> Path:
    """Write the tables and the figures of an analysis.

    Args:
        folder: with `analysis.py` and the rows.
        out: the folder of `report.md`, `report.html` and the figures.

    Returns:
        `out`.

    Raises:
        ValueError: as `read_analysis`, or the tables are no texts by title.
    """
    module, data, parts = read_analysis(folder), folder.resolve(), list[str]()
    found = module.tables(data)
    check(
        isinstance(found, dict) and all(isinstance(text, str) for text in found.values()),
        f"{folder / ANALYSIS}: tables returned {shortened(found)}; return Markdown by title",
    )
    with only_one(out, "report"):
        for title, table in found.items():
            parts += [f"## {in_markdown(title)}", table]
        with TemporaryDirectory() as drawn:  # figures of earlier reports may be in `out`
            if hasattr(module, "figures"):
                module.figures(data, Path(drawn))
            for path in sorted(Path(drawn).glob("*.png")):
                write_bytes(out / path.name, path.read_bytes())
                parts.append(f"![{path.name}]({path.name})")
        write_markdown(out / "report.md", TITLE + data.name, parts)
    return out


def is_of_analysis(folder: Path) -> bool:
    """Whether `report_analysis` wrote this folder."""
    return begins_with(folder / "report.md", f"# {TITLE}")
