"""The report of a sweep or of an ablation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from train.experiments.ablation_report import ablation_report
from train.experiments.methods import METHODS, METHODS_LINE, methods
from train.experiments.sweep_report import sweep_report
from train.experiments.tables import read_study
from train.files import only_one, write_text
from train.reports.figures import PLAIN, Look
from train.reports.pages import page_of
from train.reports.tables import ResultTable, in_markdown


def report(out: Path, look: Look = PLAIN) -> Path:
    """Collect the runs in `out`, draw their figures and write their tables.

    Returns:
        The folder: `report.md` and the same as a page, `report.html`; `methods.md`, `table.csv`,
        `table.tex`, and the figures.

    Raises:
        ValueError: neither a sweep nor an ablation in `out`, or none of its runs has results.
    """
    out = Path(out)
    folder = out / "report"
    with only_one(folder, "report"):
        study = read_study(out)
        make = sweep_report if study.hints.control is None else ablation_report
        table, paragraphs, figures = make(study, folder, look)
        lines = [*ran_on(study.rows), *paragraphs, "", METHODS_LINE]
        missing = [row for row in study.everything if row["status"] != "complete"]
        if missing:
            lines += ["", f"Not complete: {len(missing)} runs.", ""]
            told = (f"{row['run']}: {row['status']} {row['error'] or ''}" for row in missing)
            lines += [f"- {in_markdown(line)}" for line in told]
        lines += ["", *(f"![{name}]({name})\n" for name in figures)]
        runs = [out / "runs" / row["run"] for row in study.rows]
        write_report(folder, study.hints.title, table, lines, runs)
    return folder


def write_report(
    folder: Path, title: str, table: ResultTable, lines: Sequence[str], runs: Sequence[Path | str]
) -> None:
    """Write a report: its table, how its `runs` were made, and the page; `lines` follow the table
    on it."""
    table.write(folder)
    write_text(folder / METHODS, methods(runs))
    head = [f"# {in_markdown(title)}", "", table.markdown(), ""]
    write_text(folder / "report.md", "\n".join([*head, *lines]))
    page_of(folder / "report.md")


def ran_on(rows: list[dict[str, Any]]) -> list[str]:
    """How many runs, of which seeds, on which machines."""
    seeds = ", ".join(map(str, sorted({row["seed"] for row in rows})))
    machines = "; ".join(sorted({str(row["machine"]) for row in rows}))
    return [f"{len(rows)} runs, seeds {seeds}, on {in_markdown(machines)}."]
