"""The report of a study, or of several folders of runs, from its rows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from train.experiments import figures, summary
from train.experiments.contestant_runs import CONTESTANT
from train.experiments.rows import StudyRows, read_several, read_study
from train.experiments.tuning import best_trials
from train.experiments.variants import against_control, contestant_rows, distance_of, first_to_gaps
from train.files import begins_with, only_one, write_csv
from train.reports.pages import write_markdown
from train.reports.tables import ResultTable, Row, in_markdown, plain_table, short

SEVERAL = "Runs of "
"""Start of the titles of reports on several folders."""


Content = tuple[ResultTable, list[str], list[str]]
"""The table of a report, sentences and further tables as Markdown, and the names of figures."""


def report_on(out: Path, unit: str | None = None, log: bool = False) -> Path:
    """Write the tables and figures of a study.

    Args:
        out: the folder of the study.
        unit: of training time in figures: frames or seconds; that of the budget if None.
        log: whether the axis of training time is logarithmic.

    Returns:
        The folder of the report: `report.md`, `report.html`, `table.csv`, `runs.csv` (a row per
        run), with a search `trials.csv`, and figures.

    Raises:
        ValueError: no study in `out`, or none of its runs has results.
    """
    trials, _ = best_trials(out)
    return write_study(read_study(out), out / "report", unit, log, trials)


def report_several(
    folders: Sequence[Path], out: Path, unit: str | None = None, log: bool = False
) -> Path:
    """Write one report of several runs and studies.

    Args:
        folders: of the runs and studies.
        out: the folder of the report.
        unit, log: as in `report_on`.

    Raises:
        ValueError: a folder contains no complete run, or runs have different measures.
    """
    study = read_several(folders)
    study.layout.title = SEVERAL + study.layout.title
    return write_study(study, out, unit, log)


def is_of_several(folder: Path) -> bool:
    """Whether `report_several` wrote this folder."""
    return begins_with(folder / "report.md", f"# {SEVERAL}")


def write_study(
    study: StudyRows, folder: Path, unit: str | None, log: bool, trials: Sequence[Row] = ()
) -> Path:
    """Write the report of a study into a folder."""
    with only_one(folder, "report"):
        unit = unit or figures.unit_of(study)
        kind = study.rows[0]["kind"]
        if study.layout.control is not None:
            make = ablation_content if distance_of(study) is None else paired_content
        elif kind == CONTESTANT and study.x == "variant":
            make = contestant_content
        else:
            make = sweep_content
        table, paragraphs, pictures = make(study, folder, unit, log)
        parts = [table.markdown(), ran_on(study.rows), *paragraphs]
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


def sweep_content(study: StudyRows, folder: Path, unit: str, log: bool) -> Content:
    """The report of a sweep, and of several folders."""
    names, measure = ["learning_curves.png"], summary.measure_of(study.rows)
    table = summary.sweep_table(study.rows, study.x)
    if study.x and len({row["_x"] for row in study.rows}) > 1:
        panels = {measure.title: (measure.scale, measure.name, "each_run")}
        figures.draw_final(folder / "final.png", study, table.rows, study.x, panels)
        names.insert(0, "final.png")
    figures.draw_curves(folder / "learning_curves.png", study, [measure], unit, log)
    return table, summary.sweep_notes(study.rows), names


def ablation_content(study: StudyRows, folder: Path, unit: str, log: bool) -> Content:
    """The report of an ablation of single agents, with the runs as units."""
    rows = against_control(study)
    panels = {
        "final gap to the optimum (%)": ("gap", "gap", "each_run"),
        f"P(better than {study.layout.control})": ("share", "improvement", ""),
    }
    figures.draw_final(folder / "final.png", study, rows, "variant", panels)
    names = ["final.png", *figures.draw_stages(folder, study, unit, log)]
    table = ResultTable(rows, summary.variant_columns(study.layout))
    return table, summary.ablation_notes(study), names


def paired_content(study: StudyRows, folder: Path, unit: str, log: bool) -> Content:
    """The report of an ablation by maze or game, without curves over training time."""
    rows, distance = against_control(study), distance_of(study)
    assert distance is not None
    panels = {f"{distance.name} ({distance.scale})": ("log", "distance", "each_run")}
    figures.draw_final(folder / "final.png", study, rows, "variant", panels)
    table = ResultTable(rows, summary.paired_columns(study.layout, distance))
    return table, summary.paired_notes(study, rows, distance), ["final.png"]


def contestant_content(study: StudyRows, folder: Path, unit: str, log: bool) -> Content:
    """The report of a comparison of libraries."""
    rows = contestant_rows(study)
    first = ResultTable(first_to_gaps(study, rows), summary.first_columns())
    figures.draw_curves(folder / "curves.png", study, figures.POLICIES, unit, log=True)
    paragraphs = [*summary.contestant_notes(study), "## First to each gap", first.markdown()]
    paragraphs.append(summary.note("contestants.first"))
    return ResultTable(rows, summary.contestant_columns()), paragraphs, ["curves.png"]


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
            line: Row = {of: name, "task": row["task"], "settings": text or "the defaults"}
            rows.append(line | {"trial": row["trial"] if known else "none", "complete": known})
    choice = summary.note("search.choice")
    return ["## Settings", choice, plain_table(rows).markdown()]


def ran_on(rows: list[Row]) -> str:
    """A sentence with the number of runs, their seeds, machines and commits."""
    seeds = ", ".join(map(str, sorted({row["seed"] for row in rows})))
    machines = "; ".join(sorted({str(row["machine"]) for row in rows}))
    commits = ", ".join(sorted({str(row["commit"] or "unknown")[:7] for row in rows}))
    return f"{len(rows)} runs, seeds {seeds}, on {in_markdown(machines)} (commit {commits})."
