"""`pursuit report`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from train.commands.parse import Formats, heard, parse
from train.files import check_folder, check_output_folder
from train.reports.figures import Look
from train.runs.folder import CONFIG
from train.settings.checks import check


@dataclass(frozen=True)
class ReportCommand:
    """Figures and tables of a sweep or an ablation; or curves of anything laid over each other.

    One sweep or ablation: its runs as Parquet tables, its figures and its report, in its folder.
    Several folders, of runs, sweeps and ablations: their learning curves over one axis, and a table
    beside them, in --out. Every report has table.csv, table.tex and methods.md.
    """

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Folders of runs, sweeps and ablations."""
    x: str | None = None
    """The axis of training time: frames or seconds; if left out, frames of curves that are laid
    over each other, and what each figure of a sweep has."""
    log: bool = False
    """Make that axis logarithmic."""
    format: Formats = ()
    """pdf, svg, or both: figures are saved so, too, beside their .png."""
    out: Path | None = None
    """Where curves that are laid over each other go; comparison if left out, or the folder report
    of a single run."""
    overwrite: bool = False
    """Write into --out though it holds files of others, and replace those of the same names."""


def report(arguments: Sequence[str]) -> None:
    """`pursuit report`."""
    given = parse(ReportCommand, arguments, "report")
    check(bool(given.folders), "nothing to report; give folders of runs, sweeps or ablations")
    for given_folder in given.folders:
        check_folder(given_folder)
    look = Look(given.format, given.x, given.log)
    from train.experiments.overlay import is_overlay, overlay  # torch is slow to import
    from train.experiments.report import report as make_report
    from train.experiments.study import status_of

    only = given.folders[0] if len(given.folders) == 1 else None
    if only is not None and not (only / CONFIG).exists() and given.out is None:
        with heard():
            folder = make_report(only, look)
        states = [status_of(path.parent) for path in only.glob("runs/*/config.json")]
        told = f"{states.count('complete')} of {len(states)} runs; "
    else:
        out = given.out or (Path("comparison") if only is None else only / "report")
        check_output_folder(out, is_overlay, given.overwrite)
        with heard():
            folder = overlay(given.folders, out, look)
        told = ""
    print((folder / "report.md").read_text(encoding="utf-8"))
    print(f"{told}figures and tables: {folder}")
