"""What the commands do: studies that are executed one after the other, each with its report.

A study file is one study, after the rungs of its search if it has [tuning]. A replication has
several studies after a common search.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from pursuit.validation import check
from train.experiments.expansion import StudyChange, check_kind, load_study
from train.experiments.recorded import lock_of, read_recorded
from train.experiments.report import report_on
from train.experiments.runs import TUNING, Study
from train.experiments.shards import Shard
from train.experiments.study import StudyFile, choose_version, content_of, read_file
from train.experiments.tuning import TuningSearch, tuning_search_of

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
        search: whose settings the study has; it is left out if something has no complete trial.
        reported: whether the study has a report of its own; a search has none.
    """

    name: str
    expand: Callable[[], Study]
    folder: Path
    search: TuningSearch | None = None
    reported: bool = True

    def in_shard(self, shard: Shard) -> Stage:
        """The part of this stage that is the shard's."""
        return replace(self, expand=lambda: replace(self.expand(), shard=shard))


def stages_of(
    name: str,
    kind: str,
    version: str | None,
    out: Path,
    change: StudyChange = lambda file: file,
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
        file = change(choose_version(content, version))
        check_kind(file, kind)
        search = tuning_search_of(content.tuning, version, out / TUNING, file, known[TUNING])
        first = search.study(0)  # refuses what cannot run before anything is executed

    def tuned() -> Study:
        study = load_study(name, kind, version, change, search.chosen())
        return replace(study, rows=known[RUN_ROWS])

    return [*stages_of_search(search, first), Stage(path.stem, tuned, out, search)]


def stages_of_search(search: TuningSearch, first: Study) -> list[Stage]:
    """The rungs of a search; `first` is the first one."""
    stages = list[Stage]()
    for rung in search.rungs:
        name = f"rung {rung}" if search.has_rungs else "search"
        expand = partial(search.study, rung) if rung else lambda: first
        stages.append(Stage(name, expand, search.folder(rung), reported=False))
    return stages


def carry_out(
    stages: Iterable[Stage], execute: Execute, tell: Callable[[str], None], merge: str = ""
) -> list[tuple[Path, Statuses]]:
    """Execute all stages, and write the reports of their studies.

    A shard goes on to the next stage, or to the report, if there are rows of all runs; so the last
    one writes the report.

    Args:
        stages: in order.
        execute: see `Execute`.
        tell: called with a line before each stage, and if a shard has to wait for others.
        merge: the command that makes the report of all shards.

    Returns:
        The folder of each executed stage with the status of every run.

    Raises:
        ValueError: a folder with other contents.
        KeyboardInterrupt: once the runs have saved.
    """
    done: list[tuple[Path, Statuses]] = []
    for stage in stages:
        if stage.search is not None and (lacking := stage.search.lacking()):
            tell(
                f"{stage.name}: skipped, as no trial of the search for the settings of "
                f"{', '.join(lacking)} is complete; see the error.txt files in {stage.search.out}"
            )
            continue
        study = stage.expand()
        part = ":" if study.shard is None else f", shard {study.shard}: {len(study.own)} of"
        tell(f"{study.layout.title}{part} {len(study.runs)} runs into {stage.folder}")
        statuses = execute(study, stage.folder)
        done.append((stage.folder, statuses))
        with contextlib.ExitStack() as waiting:
            if study.rows is not None:
                waiting.enter_context(lock_of(study.rows))  # one shard at a time
                rows = read_recorded(study.rows, study.planned)
                statuses = {name: str(rows[name]["status"]) for name in study.planned.keys() & rows}
            if missing := len(study.runs) - len(statuses):
                then = f"make the report by: {merge}" if stage.reported else "start all again"
                tell(f"{missing} runs are missing; when the other shards have ended, {then}")
                break
            if stage.reported and "complete" in statuses.values():
                report_on(stage.folder)
    return done
