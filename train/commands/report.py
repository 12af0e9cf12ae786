"""`pursuit report`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from train.commands.parse import heard, parse
from train.experiments.report import report as make_report
from train.experiments.sweep import status_of
from train.settings.checks import check


@dataclass(frozen=True)
class ReportCommand:
    """Collect the runs of a sweep into Parquet tables, draw its figures, write its report."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The folder of the sweep."""


def report(arguments: Sequence[str]) -> None:
    """`pursuit report`."""
    given = parse(ReportCommand, arguments, "report")
    check(given.folder.is_dir(), f"{given.folder}: no such folder")
    with heard():
        folder = make_report(given.folder)
    print((folder / "report.md").read_text(encoding="utf-8"))
    states = [status_of(path.parent) for path in given.folder.glob("runs/*/config.json")]
    print(f"{states.count('complete')} of {len(states)} runs; figures and tables: {folder}")
