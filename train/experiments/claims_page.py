"""The analysis "claims": the page of a replication, with conditions, rules, verdicts, evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from statistics import fmean

from train.experiments.claims import (
    CONFIRMED,
    REFUTED,
    UNDECIDED,
    Decision,
    cell_in_words,
    cell_row,
    corrected,
    decide,
)
from train.experiments.measures import note
from train.experiments.replication import PAGE, STUDIES, Replication, changed_rules
from train.experiments.report import ran_on, settings_parts
from train.experiments.rows import StudyRows, read_all
from train.experiments.runs import LAYOUT, TUNING
from train.experiments.statistics import (
    LEVEL,
    Interval,
    difference_interval,
    distance_interval,
    mean_interval,
)
from train.experiments.study import COMPARISONS, Claim, ClaimedStudy, Layout
from train.experiments.tuning import last_trials
from train.files import write_bytes, write_csv
from train.reports.pages import write_markdown
from train.reports.tables import Column, ResultTable, Row, in_markdown, plain_table, words

PICTURES = ("final.png", "learning_curves.png")
"""Figures of a study's report; the first one that exists is shown."""
SIDES = {True: "for", False: "against"}


@dataclass(frozen=True)
class Decided:
    """A claim of a study with the decision of each cell."""

    study: ClaimedStudy
    claim: Claim
    cells: tuple[Decision, ...]

    def rows(self) -> list[Row]:
        """A row for each cell: the rows of `claims.csv`."""
        row: Row = {"study": self.study.id, "claim": self.claim.text, "rule": self.claim.rule}
        return [row | cell for cell in map(cell_row, self.cells)]


def rows_of(folder: Path, mazes: Mapping[str, str]) -> StudyRows:
    """The complete runs of a study; user-defined mazes have the names of those they replace."""
    if not (folder / "runs").is_dir():
        return StudyRows(Layout(folder.name))
    study = read_all(folder)
    names = {path: name for name, path in mazes.items()}
    for row in study.rows:
        row["maze"] = names.get(str(row.get("maze")), row.get("maze"))
    return study


def decide_all(plan: Replication, studies: Mapping[str, StudyRows]) -> list[Decided]:
    """All claims, with the p of all their cells corrected together."""
    decided = []
    for study in plan.studies:
        for claim in study.claims:
            rows = studies[study.id]
            cells = decide(claim, rows.rows, rows.varying, study.least_frames)
            decided.append(Decided(study, claim, tuple(cells)))
    tested = iter(corrected([cell for each in decided for cell in each.cells]))
    return [replace(d, cells=tuple(next(tested) for _ in d.cells)) for d in decided]


# -- page ------------------------------------------------------------------------------------------


def write_replication(plan: Replication, out: Path) -> Path:
    """Decide every claim with the complete runs, and write the report.

    Returns:
        The path of `report/replication.md` in `out`. Also written: `replication.html`, `claims.csv`
        (a row per cell of a claim), `runs.csv` (a row per run) and a figure per study.
    """
    folder = out / "report"
    folder.mkdir(parents=True, exist_ok=True)
    studies = {s.id: rows_of(out / STUDIES / s.id, plan.mazes) for s in plan.studies}
    decided = decide_all(plan, studies)
    for study in plan.studies:
        drawn = [out / STUDIES / study.id / "report" / name for name in PICTURES]
        for picture in [path for path in drawn if path.exists()][:1]:
            write_bytes(folder / f"{study.id}.png", picture.read_bytes())
    write_csv(folder / "claims.csv", [row for each in decided for row in each.rows()])
    whole = StudyRows(Layout(""), varying=["study"])
    for name, rows in studies.items():
        whole.everything += [{"study": name, **row} for row in rows.everything]
        whole.varying += [column for column in rows.varying if column not in whole.varying]
        whole.measures += [column for column in rows.measures if column not in whole.measures]
    whole.write(folder)
    parts = [*head(plan, studies, out), "## Verdicts", *verdicts(decided)]
    parts.append(note("claims.method", level=LEVEL))
    trials = last_trials(out)
    parts += settings_parts(trials) if trials else []
    for study in plan.studies:
        parts += study_part(study, [d for d in decided if d.study is study], out, studies)
    return write_markdown(folder / PAGE, plan.title, parts)


def head(plan: Replication, studies: Mapping[str, StudyRows], out: Path) -> list[str]:
    """The number of runs, their duration and their machines."""
    done = [row for study in studies.values() for row in study.rows]
    whole = done + (rows_of(out / TUNING, {}).rows if (out / TUNING / LAYOUT).exists() else [])
    text = note(
        "claims.head",
        version=plan.version,
        done=len(done),
        planned=sum(len(study.everything) for study in studies.values()),
        hours=sum(float(row["seconds"]) for row in whole) / 3600.0,
        whose="the user's" if plan.mazes else "our",
        name=plan.name,
    )
    left_out = in_markdown(", ".join(plan.left_out) or "none")
    more = f"Studies that only the other version includes: {left_out}."
    return [text, ran_on(whole), more] if whole else [text, more]


def verdicts(decided: Sequence[Decided]) -> list[str]:
    """All verdicts in one table: a row for each cell."""
    cells = Counter(cell.verdict for each in decided for cell in each.cells)
    text = ", ".join(f"{cells[name]} {name}" for name in (CONFIRMED, REFUTED, UNDECIDED))
    columns = [
        *(words(name) for name in ("study", "claim", "cell", "verdict")),
        Column("side", lambda row: SIDES.get(row["supports"], ""), left=True),
        Column("p", lambda row: _p(row["p"])),
        Column("p by Holm", lambda row: _p(row["p_holm"])),
        Column("least p", lambda row: _p(row["least_p"])),
        words("note"),
    ]
    return [
        f"Of {cells.total()} tested claims about runs (a cell is a claim on one maze or "
        f"algorithm): {text}.",
        ResultTable([row for each in decided for row in each.rows()], columns).markdown(),
        note("claims.columns", level=LEVEL),
    ]


def _p(p: float | str) -> str:
    return p if isinstance(p, str) else f"{p:.2g}" if p >= 0.001 else "below 0.001"


def study_part(
    study: ClaimedStudy, decided: Sequence[Decided], out: Path, studies: Mapping[str, StudyRows]
) -> list[str]:
    """One study: its conditions, its claims with their rules, and the evidence."""
    parts = [
        f"## {in_markdown(f'{study.id}: {study.title}')}",
        f"**The claim**: {in_markdown(study.thesis)} **Here**: {in_markdown(study.differs)}",
    ]
    if warning := changed_rules(study, out):
        parts.append(f"**{in_markdown(warning)}**")
    done, planned = len(studies[study.id].rows), len(studies[study.id].everything)
    if done < planned:
        parts.append(f"**{done} of {planned} runs are complete.**")
    for each in decided:
        names = dict.fromkeys(cell.verdict for cell in each.cells)
        causes = [each.claim.cause[name] for name in names if name in each.claim.cause]
        more = [f"Our interpretation: {in_markdown(cause)}" for cause in causes]
        rule = rule_words(each.claim)
        parts.append(" ".join([f"**{in_markdown(each.claim.text)}**", rule, *more]))
        parts.append(evidence_table(each))
    if (out / "report" / f"{study.id}.png").exists():
        parts.append(f"![{in_markdown(study.title)}: all runs]({study.id}.png)")
    return parts


def rule_words(claim: Claim) -> str:
    """The decision rule of a claim, as text."""
    return note(
        f"rules.{claim.rule}",
        more=note("rules.more"),
        others=" and of ".join(cell_in_words(other) for other in claim.than),
        percent=claim.percent,
        reference=note(f"rules.{claim.to}"),
        part=note(f"rules.{claim.part}"),
    )


def evidence_table(each: Decided) -> str:
    """The runs of each setting of each cell of a claim, as Markdown."""
    claim = each.claim
    compared = claim.rule in COMPARISONS
    interval_of = mean_interval if claim.rule in ("within", "beyond") else distance_interval
    rows: list[Row] = []
    for cell in each.cells:
        for place, group in enumerate(cell.groups):
            values, runs = group.values(claim), list(chain(*group.mazes))
            if not all(values):
                continue
            mean = fmean(map(fmean, values))
            row: Row = {"verdict": cell.verdict, "setting": cell_in_words(group.cell)}
            row["each run"] = ", ".join(map(_three, chain(*values)))
            row["mean [95 %]"] = _bounded(mean, interval_of(values))
            if compared:
                ours = cell.groups[0].values(claim)
                change = fmean(map(fmean, ours)) - mean
                ends = difference_interval(ours, values)
                row["difference [95 %]"] = _bounded(change, ends) if place else ""
            else:
                row["meet the rule"] = f"{cell.meets} of {len(runs)}"
            frames = sorted(run["frames"] / 1e6 for run in runs)
            span = dict.fromkeys(f"{each:.2g}" for each in (frames[0], frames[-1]))
            rows.append(row | {"frames, M": " to ".join(span)})
    return plain_table(rows).markdown() if rows else ""


def _bounded(value: float, interval: Interval) -> str:
    """A number with its interval."""
    return f"{_three(value)} [{_three(interval[0])}, {_three(interval[1])}]"


def _three(value: float) -> str:
    """A number with three significant digits."""
    if abs(value) < 1e-9:  # rounding errors of sums
        return "0"
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.3g}"
