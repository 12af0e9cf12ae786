"""`pursuit report`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from pursuit.validation import check, choice, rule
from train.commands.parse import parse
from train.commands.progress import ProgressLine
from train.experiments.analysis import ANALYSIS, is_of_analysis, report_analysis
from train.files import Plain, check_folder, check_output_folder
from train.reports.figures import UNITS
from train.settings.checks import Settings, check_default

TIME_UNIT = rule(lambda value: value in (None, *UNITS), "give frames or seconds")


@dataclass(frozen=True)
class ReportCommand(Settings):
    """Write figures and tables of a sweep or an ablation, or of several folders together.

    For one sweep or ablation, the tables of its runs and its report are written to its
    folder. For several runs, sweeps and ablations, one report on all of them is written to --out.
    Every report has table.csv and runs.csv, a row per run. A run that was interrupted before its
    last evaluation is evaluated first.

    Of a folder with analysis.py, such as docs/results/data/curricula, the tables and figures of the
    results page are written: its functions tables(data) and figures(data, out) are called, which
    --allow analysis permits.
    """

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Folders of runs, sweeps and ablations, or one with analysis.py."""
    x: Annotated[str | None, TIME_UNIT] = None
    """The axis of training time: frames or seconds; by default that of the budget."""
    log: bool = False
    """Make that axis logarithmic."""
    y: Annotated[str | None, choice("linear", "log")] = None
    """The vertical axis of learning curves: linear or log; by default that of the measure (gaps:
    logarithmic above 0.1 %). Values that are not above 0 are outside a logarithmic axis."""
    title: str | None = None
    """Title of the report and its figures."""
    names: tuple[str, ...] = ()
    """Names of several folders in figures and tables, in their order; by default the shortest
    unique ends of their paths."""
    format: Annotated[str, choice("svg", "pdf", "png")] = "svg"
    """The format of figures beside .png, which pages show: svg or pdf; png for none."""
    out: Path | None = None
    """The folder of a report on several folders; by default comparison, for a single run the
    subfolder report, and for an analysis the folder report here."""
    overwrite: bool = False
    """Write to --out even if it has other files, and replace those with the same names."""


def report(arguments: Sequence[str]) -> None:
    """`pursuit report`."""
    options = parse(ReportCommand, arguments, "report")
    check(bool(options.folders), "nothing to report; give folders of runs, sweeps or ablations")
    for folder in options.folders:
        check_folder(folder)
    from train.experiments.report import (  # torch is slow to import
        is_of_several,
        report_on,
        report_several,
    )
    from train.experiments.runs import LAYOUT
    from train.kinds import evaluate_runs
    from train.runs.folder import CONFIG

    drawing: Plain = {"log": options.log, "y": options.y, "also": options.format}
    drawing |= {"title": options.title} | ({"unit": options.x} if options.x else {})
    only = options.folders[0] if len(options.folders) == 1 else None
    kept = only is not None and any((only / name).exists() for name in (CONFIG, LAYOUT))
    if only is not None and not kept and (only / ANALYSIS).is_file():
        names = ("x", "log", "y", "title", "names", "format")
        check_default(options, ReportCommand, names, f"{ANALYSIS} makes tables and figures")
        out = options.out or Path("report")
        check_output_folder(out, is_of_analysis, options.overwrite)
        written = report_analysis(only, out)
    elif only is not None and not (only / CONFIG).exists() and options.out is None:
        check_default(options, ReportCommand, ["names"], "a study has the names of its file")
        written = report_on(only, **drawing)
    else:
        out = options.out or (Path("comparison") if only is None else only / "report")
        check_output_folder(out, is_of_several, options.overwrite)
        with closing(ProgressLine()) as tell:
            evaluate_runs([run for run in options.folders if (run / CONFIG).exists()], tell)
        written = report_several(options.folders, out, options.names, **drawing)
    print((written / "report.md").read_text(encoding="utf-8"))
    print(f"figures and tables: {written}")
