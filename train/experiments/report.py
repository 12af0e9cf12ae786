"""The report of a study, or of several folders of runs, from its rows."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pursuit.validation import check
from train.experiments import figures
from train.experiments.expansion import fitting_analyses
from train.experiments.libraries import libraries_content
from train.experiments.measures import note
from train.experiments.rows import Content, StudyRows, read_several, read_study
from train.experiments.study import LIBRARIES, PAIRED, SUMMARY, VARIANTS
from train.experiments.summary import summary_content
from train.experiments.tuning import last_trials
from train.experiments.variants import distance_of, paired_content, variants_content
from train.files import only_one, write_csv
from train.reports.pages import write_markdown
from train.reports.tables import Row, in_markdown, plain_table, short

Analyse = Callable[[StudyRows, Path, figures.Drawing], Content]
"""Makes the content of a report of the rows of a study, and draws its figures into a folder."""
ANALYSES: dict[str, Analyse] = {
    SUMMARY: summary_content,
    VARIANTS: variants_content,
    PAIRED: paired_content,
    LIBRARIES: libraries_content,
}
SEVERAL = "Runs of "
"""Start of the usual titles of reports on several folders; else of their first paragraph."""


def report_on(out: Path, **drawing: Any) -> Path:
    """Write the tables and figures of a study.

    Args:
        out: the folder of the study.
        **drawing: see `Drawing`; the unit is that of the budget if it is not given.

    Returns:
        The folder of the report: `report.md`, `report.html`, `table.csv`, `runs.csv` (a row per
        run), with a search `trials.csv`, and figures.

    Raises:
        ValueError: no study in `out`, or none of its runs has results.
    """
    return write_study(read_study(out), out / "report", drawing, last_trials(out))


def report_several(
    folders: Sequence[Path], out: Path, names: Sequence[str] = (), **drawing: Any
) -> Path:
    """Write one report of several runs and studies.

    Args:
        folders: of the runs and studies.
        out: the folder of the report.
        names: of the folders in tables and figures; by default the shortest unique ones.
        **drawing: as in `report_on`.

    Raises:
        ValueError: a folder contains no complete run, or runs have different measures.
    """
    study = read_several(folders, names)
    study.layout.title = SEVERAL + study.layout.title
    return write_study(study, out, drawing)


def is_of_several(folder: Path) -> bool:
    """Whether `report_several` wrote this folder."""
    path = folder / "report.md"
    found = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    return re.match(rf"(# .*\n\n|# ){SEVERAL}", found) is not None


def write_study(
    study: StudyRows, folder: Path, drawing: Mapping[str, Any], trials: Sequence[Row] = ()
) -> Path:
    """Write the report of a study into a folder."""
    with only_one(folder, "report"):
        how = figures.Drawing(**{"unit": figures.unit_of(study), **drawing})
        usual, study.layout.title = study.layout.title, how.title or study.layout.title
        about = f"{usual}." if how.title and usual.startswith(SEVERAL) else ""
        layout, row = study.layout, study.rows[0]
        games = any(each.get("game") is not None for each in study.rows)
        fitting = fitting_analyses(layout.control, row["kind"], games, study.x)
        analysis = layout.analysis or fitting[0]
        if layout.analysis is None and layout.control is not None:  # of an earlier version
            analysis = VARIANTS if distance_of(study) is None else PAIRED
        check(
            analysis in fitting,
            f"analysis={analysis!r} of {layout.title!r}; such runs need {' or '.join(fitting)}",
        )
        table, paragraphs, pictures = ANALYSES[analysis](study, folder, how)
        parts = [in_markdown(about), table.markdown(), ran_on(study.rows), *paragraphs]
        if trials:
            parts += settings_parts(trials)
            write_csv(folder / "trials.csv", [row for row in trials])
        missing = [row for row in study.everything if row["status"] != "complete"]
        if missing:
            text = (f"{row['run']}: {row['status']} {row['error'] or ''}" for row in missing)
            parts.append(f"Not complete: {len(missing)} runs.")
            parts.append("\n".join(f"- {in_markdown(line)}" for line in text))
        parts += [f"![{name}]({name})" for name in pictures]
        table.write(folder)
        study.write(folder)
        write_markdown(folder / "report.md", study.layout.title, parts)
    return folder


def settings_parts(trials: Sequence[Row]) -> list[str]:
    """The chosen trials of a search, with the number of complete ones."""
    own = ("task", "trial", "gaps", "score", "chosen")
    rows: list[Row] = []
    for row in trials:
        of, name = next(iter(row.items()))
        same = [r for r in trials if (r[of], r["task"]) == (name, row["task"])]
        known = sum(r["score"] is not None for r in same)
        if row["chosen"] or (not known and row["trial"] == 0):
            values = {n: v for n, v in row.items() if n not in (of, *own)} if known else {}
            text = ", ".join(f"{n} {short(v)}" for n, v in values.items())
            task: Row = {} if of == "variant" else {"task": row["task"]}
            line: Row = {of: name, **task, "settings": text or "the defaults"}
            rows.append(line | {"trial": row["trial"] if known else "none", "complete": known})
    choice = note("search.choice")
    return ["## Settings", choice, plain_table(rows).markdown()]


def ran_on(rows: list[Row]) -> str:
    """A sentence with the number of runs, their seeds, machines and commits."""
    seeds = ", ".join(map(str, sorted({row["seed"] for row in rows})))
    machines = "; ".join(sorted({str(row["machine"]) for row in rows}))
    commits = ", ".join(sorted({str(row["commit"] or "unknown")[:7] for row in rows}))
    return f"{len(rows)} runs, seeds {seeds}, on {in_markdown(machines)} (commit {commits})."
