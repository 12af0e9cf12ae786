"""What the commands do: studies that are executed one after the other, each with its report.

A sweep and an ablation are one study. A comparison has a search for settings before it, and a
replication has several studies after a common search.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from pursuit.validation import check
from train.experiments.expansion import Change, load_study
from train.experiments.halving import Halving
from train.experiments.report import report_on
from train.experiments.runs import TUNING, Study
from train.experiments.study import StudyFile, choose_version, content_of, read_file
from train.experiments.tuning import best_trials, search_of

RUN_ROWS = "runs"
"""The file of rows of the runs of a study, but for its search."""
Statuses = dict[str, str]
Execute = Callable[[Study, Path], Statuses]
"""Executes the runs of a study that are not complete in a folder; the status of every run."""


@dataclass(frozen=True)
class Stage:
    """A study of a command.

    Attributes:
        name: in the output.
        expand: makes the study, with the settings that a search has found so far.
        folder: of the study.
        tuned: whether it is left out if trials of the search failed.
    """

    name: str
    expand: Callable[[], Study]
    folder: Path
    tuned: bool = False


def stages_of(
    name: str,
    kind: str,
    version: str | None,
    out: Path,
    change: Change = lambda file: file,
    rows: Path | None = None,
) -> list[Stage]:
    """The stages of a study file: its search if it has one, and its runs.

    Args:
        name, kind, version, change: as in `load_study`.
        out: the folder of the study.
        rows: the folder with the rows of finished runs, "runs.csv" and of a search "tuning.csv".

    Raises:
        ValueError: as `load_study`, or rows could not be written to that folder.
    """
    path, content = read_file(name, kind, StudyFile)
    if rows is not None:  # checked here, as the first row is written after a whole run
        found = next(p for p in (rows.absolute(), *rows.absolute().parents) if p.exists())
        writable = found.is_dir() and os.access(found, os.W_OK)
        check(writable, f"rows={rows}: {found} is no writable folder; give another folder")
    known = {name: None if rows is None else rows / f"{name}.csv" for name in (RUN_ROWS, TUNING)}
    if content.tuning is None:
        study = replace(load_study(name, kind, version, change), rows=known[RUN_ROWS])
        return [Stage(path.stem, lambda: study, out)]
    with content_of(path):
        file, tuning = change(choose_version(content, version)), content.tuning
        check(
            kind != "sweep", "[tuning] is for ablations, comparisons and replications; leave it out"
        )
        if kind == "ablation":
            halving = Halving(tuning, version, file, out / TUNING, known[TUNING])
            stages = [
                Stage(f"rung {n}", partial(halving.study, n), halving.folder(n))
                for n in halving.rungs
            ]
        else:
            search = search_of(tuning, version, file)
            stages = [Stage("search", lambda: search, out / TUNING)]

    def tuned() -> Study:
        found = halving.chosen() if kind == "ablation" else best_trials(out)[1]
        return replace(load_study(name, kind, version, change, found), rows=known[RUN_ROWS])

    return [*stages, Stage(path.stem, tuned, out)]


def carry_out(
    stages: Iterable[Stage], execute: Execute, tell: Callable[[str], None]
) -> list[tuple[Path, Statuses]]:
    """Execute all stages, and write the reports of their studies.

    Args:
        stages: in order.
        execute: see `Execute`.
        tell: called with a line before each stage.

    Returns:
        The folder of each executed stage with the status of every run.

    Raises:
        ValueError: a folder with other contents, or all trials of a contestant failed.
        KeyboardInterrupt: once the runs have saved.
    """
    done: list[tuple[Path, Statuses]] = []
    searched = True
    for stage in stages:
        if stage.tuned and not searched:
            tell(f"{stage.name}: skipped, as trials of the search for its settings have failed")
            continue
        study = stage.expand()
        tell(f"{study.layout.title}: {len(study.runs)} runs into {stage.folder}")
        statuses = execute(study, stage.folder)
        done.append((stage.folder, statuses))
        if stage.folder.name == TUNING:
            searched = {*statuses.values()} == {"complete"}
            trials, tuned = best_trials(stage.folder.parent)
            for row in trials if study.pinned else ():
                check(
                    (row["contestant"], row["task"]) in tuned,
                    f"{row['contestant']} failed in every trial on {row['task']!r}; see the "
                    f"error.txt files in {stage.folder}",
                )
        elif "complete" in statuses.values() and stage.folder.parent.name != TUNING:
            report_on(stage.folder)
    return done
