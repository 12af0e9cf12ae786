"""The report of a sweep or of an ablation."""

from __future__ import annotations

from pathlib import Path

from train.experiments.ablation_report import ablation_report
from train.experiments.forms import read_hints
from train.experiments.page import page_of
from train.experiments.sweep_report import sweep_report
from train.figures import PLAIN, Look
from train.files import only_one


def report(out: Path | str, look: Look = PLAIN) -> Path:
    """Collect the runs in `out`, draw their figures and write their tables.

    Returns:
        The folder: `report.md` and the same as a page, `report.html`; `methods.md`, `table.csv`,
        `table.tex`, and the figures.

    Raises:
        ValueError: neither a sweep nor an ablation in `out`, or none of its runs has results.
    """
    out = Path(out)
    ablation = read_hints(out).control is not None
    with only_one(out / "report", "report"):
        folder = ablation_report(out, look) if ablation else sweep_report(out, look)
        page_of(folder / "report.md")
    return folder
