"""The report of a replication: claims with conditions, rule, verdict, evidence and cause."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from train.experiments.replication.decisions import (
    DecidedExperiment,
    cells_of_page,
    claim_rows,
    corrected,
    decided,
    named,
    value_rows,
)
from train.experiments.replication.plan import SHIPPED, Claim, Replication, Tuning
from train.experiments.replication.rules import (
    COMPARISONS,
    CONFIRMED,
    REFUTED,
    UNDECIDED,
    Decision,
    headline,
)
from train.experiments.replication.run import (
    RULES_KEPT,
    TUNING,
    complete_runs,
    folder_of,
    trial_scores,
    tuned_settings,
)
from train.experiments.statistics import (
    LEVEL,
    difference_interval,
    distance_interval,
    mean_interval,
)
from train.files import begins_with, write_bytes, write_csv
from train.reports.pages import write_markdown
from train.reports.tables import Column, ResultTable, Row, in_markdown, plain_table, words

PAGE = "replication.md"
PICTURES = ("final.png", "learning_curves.png")
"""Figures of a study's report; the first one that exists is shown."""
PART_WORDS = {"objective": "objective gap", "learning": "not learned", "loops": "loops"}
SIDES = {True: "for", False: "against"}
HOW = f"""## How claims are decided

Each claim has one verdict for each cell, which is one task in one size. Settings are compared by a
two-sided permutation test (of Mann and Whitney's U; runs are permuted within a maze). A claim about
several rivals is confirmed by the largest of their p, and refuted by the smallest, times their
number. A claim about a threshold is decided by the sign test: whether more than half of all runs
meet it. All p are corrected together by Holm's method. **Confirmed** and **refuted** mean a
corrected p below {LEVEL:g}. Otherwise a cell is **undecided**, which does not mean that there is no
effect. 95 % intervals are Student's for means and Welch's for differences, and not corrected."""
REFERENCES = {
    "optimal": "the optimum",
    "scripted": "the scripted reference",
    "limit": "the time limit",
}


def write_replication(plan: Replication, out: Path) -> Path:
    """Decide every claim with the complete runs, and write the report.

    Returns:
        The path of `report/replication.md` in `out`. Also written: `replication.html`, `claims.csv`
        (a row per cell of a claim), `values.csv` (a row per run) and a figure per study.
    """
    folder = out / "report"
    folder.mkdir(parents=True, exist_ok=True)
    studies = corrected([decided(study, plan, out) for study in plan.studies])
    for each in studies:
        drawn = [folder_of(each.study, out) / "report" / name for name in PICTURES]
        for picture in [path for path in drawn if path.exists()][:1]:
            write_bytes(folder / f"{each.study.id}.png", picture.read_bytes())
    write_csv(folder / "claims.csv", claim_rows(studies))
    write_csv(folder / "values.csv", value_rows(studies))
    return write_markdown(folder / PAGE, plan.title, page(plan, studies, out))


def is_folder_of(plan: Replication, out: Path) -> bool:
    """Whether `out` is the folder of this replication, or of one with the same title."""
    page = out / "report" / PAGE
    own = not page.exists() or begins_with(page, f"# {in_markdown(plan.title)}\n")
    return own and (out / RULES_KEPT).exists()


# -- text ------------------------------------------------------------------------------------------


def rule_words(claim: Claim) -> str:
    """The decision rule of a claim, as text."""
    others = " and of ".join(named(other) for other in claim.than)
    reference = f"{claim.percent:g} % worse than {REFERENCES[claim.to]}"
    stuck = "most starts are unsolved and episode lengths do not fall in its last third"
    part = f"{claim.percent:g} % of the gap in the part: {PART_WORDS[claim.part]}"
    more = "The claim holds if more than half of all runs"
    nearer = "The claim holds if the distance to the optimum"
    return {
        "diverges": f"{more} diverge. A run diverges if {stuck}.",
        "learns": f"{more} learn. A run does not learn if {stuck}.",
        "lower": f"{nearer} is smaller than that of {others}.",
        "higher": f"{nearer} is larger than that of {others}.",
        "within": f"{more} end no more than {reference}.",
        "beyond": f"{more} end more than {reference}.",
        "part_above": f"{more} end with at least {part}.",
        "part_below": f"{more} end with less than {part}.",
        "states": "Confirmed if all numbers are equal.",
        "tours": "Confirmed if all differ by at most 5 %, as the table has means of 1000 episodes.",
    }[claim.rule]


def evidence(claim: Claim, cells: Sequence[Decision]) -> str:
    """The table of evidence: a row for each setting of each cell."""
    runs = [run for cell in cells for group in cell.groups for run in group.runs]
    if not runs:
        return ""
    what = "distance to the optimum, %"
    if claim.rule in COMPARISONS and runs[0].row.get("optimality_gap") is None:
        what = "NashConv"
    elif claim.rule in ("diverges", "learns"):
        what = "starts unsolved, %"
    elif claim.rule in ("part_above", "part_below"):
        what = f"share of the gap: {PART_WORDS[claim.part]}, %"
    elif claim.rule in ("within", "beyond"):
        what = f"worse than {REFERENCES[claim.to]} by, %"
    compared = claim.rule in COMPARISONS
    interval_of = mean_interval if claim.rule in ("within", "beyond") else distance_interval
    rows: list[Row] = []
    for cell in cells:
        for number, group in enumerate(cell.groups):
            values = group.values(claim)
            if not all(values):
                continue
            frames = sorted({f"{run.row['frames'] / 1e6:.2g}" for run in group.runs}, key=float)
            last = "" if compared else f"{cell.meets} of {len(group.runs)}"
            if compared and number:
                ours = cell.groups[0].values(claim)
                change = fmean(map(fmean, ours)) - fmean(map(fmean, values))
                last = bounded(change, difference_interval(ours, values))
            rows.append(
                {
                    "setting": named(group.cell),
                    f"{what}, each run": ", ".join(figure(v) for maze in values for v in maze),
                    "mean [95 %]": bounded(fmean(map(fmean, values)), interval_of(values)),
                    "difference [95 %]" if compared else "meet the rule": last,
                    "frames, M": " to ".join(dict.fromkeys((frames[0], frames[-1]))),
                }
            )
    return plain_table(rows).markdown() if rows else ""


def bounded(value: float, interval: tuple[float, float]) -> str:
    """A number with its interval."""
    return f"{figure(value)} [{figure(interval[0])}, {figure(interval[1])}]"


def p_words(p: Any) -> str:
    """A p with two digits; empty without a test."""
    if p == "":
        return ""
    return f"{p:.2g}" if p >= 0.001 else "below 0.001"


def figure(value: float) -> str:
    """A number with three significant digits."""
    if abs(value) < 1e-9:  # rounding errors of sums
        return "0"
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.3g}"


def page(plan: Replication, studies: Sequence[DecidedExperiment], out: Path) -> list[str]:
    """The paragraphs and tables of the report, as Markdown."""
    parts = [*head(plan, studies, out), "## Verdicts", *summary(studies), HOW]
    if plan.tuning is not None:
        parts += ["## Settings", *settings_part(plan, plan.tuning, out)]
    for each in studies:
        parts += study_part(each, out)
    return parts


def head(plan: Replication, studies: Sequence[DecidedExperiment], out: Path) -> list[str]:
    """The number of runs, their duration and their machines."""
    runs = [run for each in studies for run in each.runs] + complete_runs(out / TUNING, {})
    planned = sum(each.planned for each in studies)
    done = sum(len(each.runs) for each in studies)
    hours = sum(float(run.row["seconds"]) for run in runs) / 3600.0
    machines = sorted({str(run.row["machine"]) for run in runs})
    commits = sorted({str(run.row["commit"])[:7] for run in runs})
    mazes = "the user's mazes" if plan.mazes else "our mazes"
    left_out = in_markdown(", ".join(plan.left_out) or "none")
    return [
        f"The **{plan.version}** version: {done} of {planned} runs are complete, {hours:.1f} core "
        f"hours of learning, on {in_markdown(', '.join(machines) or 'no machine')} (commit "
        f"{', '.join(commits) or 'none'}), on {mazes}. Distances are those of the greedy policy to "
        "the exact optimum. Verdicts hold for these learners and budgets. Command: "
        f"`pursuit reproduce all --claims {plan.name} --version {plan.version}`.",
        f"Studies that only the other version includes: {left_out}.",
    ]


def summary(studies: Sequence[DecidedExperiment]) -> list[str]:
    """All verdicts in one table: a row for each cell."""
    cells = Counter(cell.verdict for cell in cells_of_page(studies))
    text = ", ".join(f"{cells[name]} {name}" for name in (CONFIRMED, REFUTED, UNDECIDED))
    columns = [
        *(words(name) for name in ("study", "claim", "cell", "verdict")),
        Column("side", lambda row: SIDES.get(row["supports"], ""), left=True),
        Column("p", lambda row: p_words(row["p"])),
        Column("p by Holm", lambda row: p_words(row["p_holm"])),
        Column("least p", lambda row: p_words(row["least_p"])),
    ]
    return [
        f"Of {cells.total()} tested claims about runs (a cell is a claim on one maze or "
        f"algorithm): {text}.",
        ResultTable(claim_rows(studies), columns).markdown(),
        "Side: whether the runs are for or against the claim. Least p: the smallest p that is "
        f"possible with so many runs. Cells with a least p of {LEVEL:g} or more are not counted in "
        "Holm's correction.",
    ]


def settings_part(plan: Replication, tuning: Tuning, out: Path) -> list[str]:
    """The results of the search for settings."""
    found, scores = tuned_settings(plan, out), trial_scores(plan, out)
    trials = getattr(tuning, plan.version)
    rows = []
    for algorithm in tuning.space:
        own = ", ".join(f"{name} {value:g}" for name, value in found.get(algorithm, {}).items())
        row: Row = {"algorithm": algorithm, "settings, where not as shipped": own or SHIPPED}
        rows.append(row | {"trials complete": len(scores.get(algorithm, {}))})
    return [
        f"Trials per algorithm: {trials.samples}, the shipped settings and random samples around "
        f"them, {trials.seconds:g} s each on each of {in_markdown(', '.join(tuning.mazes))}. The "
        "trial with the smallest mean logarithm of the gap is selected. The shipped settings were "
        "found by an earlier search, which was longer for PPO than for the others.",
        plain_table(rows).markdown(),
    ]


def study_part(each: DecidedExperiment, out: Path) -> list[str]:
    """One experiment with its claims."""
    study = each.study
    parts = [
        f"## {in_markdown(f'{study.id}: {study.title}')}",
        f"**The claim**: {in_markdown(study.thesis)} **Here**: {in_markdown(study.differs)}",
    ]
    if each.planned and len(each.runs) < each.planned:
        parts.append(f"**{len(each.runs)} of {each.planned} runs are complete.**")
    if each.warning:
        parts.append(f"**{in_markdown(each.warning)}**")
    for found in each.claims:
        claim, verdicts = found.claim, found.verdicts
        notes = dict.fromkeys(note for note in (found.note, *(c.note for c in found.cells)) if note)
        note = f" ({in_markdown('; '.join(notes))})" if notes else ""
        parts += [
            f"### {in_markdown(claim.text)}",
            f"{rule_words(claim)} **{headline(verdicts).capitalize()}**{note}.",
            found.table or evidence(claim, found.cells),
        ]
        parts += [
            f"Our interpretation: {in_markdown(claim.cause[verdict])}"
            for verdict in dict.fromkeys(verdicts)
            if verdict in claim.cause
        ]
    if (out / "report" / f"{study.id}.png").exists():
        parts.append(f"![{in_markdown(study.title)}: all runs]({study.id}.png)")
    return parts
