"""The report of a sweep, of an ablation, or of several folders of runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from train.experiments.ablation_report import ablation_report
from train.experiments.methods import METHODS, METHODS_LINE, methods
from train.experiments.self_play_ablation import self_play_ablation_report
from train.experiments.sweep_report import sweep_report
from train.experiments.tables import FinishedStudy, read_several, read_study
from train.files import begins_with, only_one, write_text
from train.reports.pages import write_markdown
from train.reports.tables import in_markdown
from train.runs.folder import SELF_PLAY

SEVERAL = "Runs of "
"""Start of the titles of reports on several folders."""


def report_on(out: Path, unit: str | None = None, log: bool = False) -> Path:
    """Write the tables and figures of a sweep or an ablation.

    Args:
        out: the folder of the study.
        unit: of training time in figures: frames or seconds; that of the budget if None.
        log: whether the axis of training time is logarithmic.

    Returns:
        The folder of the report: `report.md`, `report.html`, `methods.md`, `table.csv` and figures.

    Raises:
        ValueError: neither a sweep nor an ablation in `out`, or none of its runs has results.
    """
    return write_study(read_study(out), out / "report", unit, log)


def report_several(
    folders: Sequence[Path], out: Path, unit: str | None = None, log: bool = False
) -> Path:
    """Write one report of several runs, sweeps or ablations.

    Args:
        folders: of the runs and studies.
        out: the folder of the report.
        unit, log: as in `report_on`.

    Raises:
        ValueError: a folder contains no complete run, or runs have different measures.
    """
    study = read_several(folders)
    study.hints.title = SEVERAL + study.hints.title
    return write_study(study, out, unit, log)


def is_of_several(folder: Path) -> bool:
    """Whether `report_several` wrote this folder."""
    return begins_with(folder / "report.md", f"# {SEVERAL}")


def write_study(study: FinishedStudy, folder: Path, unit: str | None, log: bool) -> Path:
    """Write the report of a study into a folder."""
    with only_one(folder, "report"):
        make = sweep_report
        if study.hints.control is not None:
            self_play = study.rows[0]["kind"] == SELF_PLAY
            make = self_play_ablation_report if self_play else ablation_report
        table, paragraphs, figures = make(study, folder, unit, log)
        parts = [table.markdown(), ran_on(study.rows), *paragraphs, METHODS_LINE]
        missing = [row for row in study.everything if row["status"] != "complete"]
        if missing:
            text = (f"{row['run']}: {row['status']} {row['error'] or ''}" for row in missing)
            parts.append(f"Not complete: {len(missing)} runs.")
            parts.append("\n".join(f"- {in_markdown(line)}" for line in text))
        parts += [f"![{name}]({name})" for name in figures]
        table.write(folder)
        write_text(folder / METHODS, methods(study.folders))
        write_markdown(folder / "report.md", study.hints.title, parts)
    return folder


def ran_on(rows: list[dict[str, Any]]) -> str:
    """A sentence with the number of runs, their seeds and their machines."""
    seeds = ", ".join(map(str, sorted({row["seed"] for row in rows})))
    machines = "; ".join(sorted({str(row["machine"]) for row in rows}))
    return f"{len(rows)} runs, seeds {seeds}, on {in_markdown(machines)}."
