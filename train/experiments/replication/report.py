"""The replication report: claim, conditions, rule, verdict, evidence and cause, on one page."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from statistics import fmean

from train.experiments.replication.decisions import (
    DecidedStudy,
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
    LEVEL,
    REFUTED,
    UNDECIDED,
    Decision,
    correct,
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
    difference_interval,
    distance_interval,
    least_p,
    mean_interval,
)
from train.files import begins_with, write_bytes, write_csv, write_text
from train.reports.pages import page_of
from train.reports.tables import Row, in_markdown, plain_table

PAGE = "replication.md"
PICTURES = ("final.png", "learning_curves_frames.png")
"""Of a study's report, the first that there is."""
PART_WORDS = {"floor": "the objective's floor", "learning": "not learned", "loops": "loops"}
SIDES = {True: "for", False: "against"}
REFERENCES = {
    "optimal": "the optimum",
    "scripted": "the scripted reference",
    "limit": "the time limit",
}


def write_replication(plan: Replication, out: Path) -> Path:
    """Decide every claim by the runs that are complete, and write the page.

    Returns:
        `report/replication.md` in `out`; beside it `replication.html`, `claims.csv` (a row for each
        cell of a claim), `values.csv` (a row for each of its runs) and a figure for each study.
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
    write_text(folder / PAGE, page(plan, studies, out))
    page_of(folder / PAGE)
    return folder / PAGE


def is_folder_of(plan: Replication, out: Path) -> bool:
    """Whether `out` was begun for these claims, and has no page of others."""
    page = out / "report" / PAGE
    own = not page.exists() or begins_with(page, f"# {in_markdown(plan.title)}\n")
    return own and (out / RULES_KEPT).exists()


# -- words -----------------------------------------------------------------------------------------


def rule_words(claim: Claim) -> str:
    """What is tested, in a sentence."""
    others = " and of ".join(named(other) for other in claim.than)
    reference = f"{claim.percent:g} % worse than {REFERENCES[claim.to]}"
    stuck = "more than half of the starts stay unsolved and nothing falls in the last third of it"
    part = f"{claim.percent:g} % of the gap is {PART_WORDS[claim.part]}"
    more = "The claim holds if more than half of all runs"
    nearer = "The claim holds if the distance to the optimum"
    return {
        "diverges": f"{more} diverge. A run diverges where {stuck}.",
        "learns": f"{more} learn. A run does not learn where {stuck}.",
        "lower": f"{nearer} is smaller than that of {others}.",
        "higher": f"{nearer} is larger than that of {others}.",
        "within": f"{more} end no more than {reference}.",
        "beyond": f"{more} end more than {reference}.",
        "part_above": f"{more} end so that at least {part}.",
        "part_below": f"{more} end so that less than {part}.",
        "states": "Confirmed where all numbers are the same.",
        "tours": "Confirmed where all lie within 5 % (the table's are means over 1000 episodes).",
    }[claim.rule]


def evidence(claim: Claim, cells: Sequence[Decision]) -> str:
    """The table of what the verdicts rest on: a row for each setting of each cell."""
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


def p_words(p: float) -> str:
    """A p with two digits."""
    if math.isnan(p):
        return "–"
    return f"{p:.2g}" if p >= 0.001 else "below 0.001"


def figure(value: float) -> str:
    """A number with as many digits as matter."""
    if abs(value) < 1e-9:  # sums in another order
        return "0"
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.3g}"


def page(plan: Replication, studies: Sequence[DecidedStudy], out: Path) -> str:
    """All of it as Markdown."""
    parts = [f"# {in_markdown(plan.title)}", *head(plan, studies, out)]
    parts += ["## Verdicts", *summary(studies)]
    parts += ["## How claims are decided", *how(studies)]
    if plan.tuning is not None:
        parts += ["## Settings", *settings_part(plan, plan.tuning, out)]
    for each in studies:
        parts += study_part(each, out, "The thesis" if plan.name == "thesis" else "The claim")
    return "\n\n".join(filter(None, parts)) + "\n"


def head(plan: Replication, studies: Sequence[DecidedStudy], out: Path) -> list[str]:
    """What was run, where and for how long."""
    runs = [run for each in studies for run in each.runs] + complete_runs(out / TUNING, {})
    planned = sum(each.planned for each in studies)
    done = sum(len(each.runs) for each in studies)
    hours = sum(float(run.row["seconds"]) for run in runs) / 3600.0
    machines = sorted({str(run.row["machine"]) for run in runs})
    commits = sorted({str(run.row["commit"])[:7] for run in runs})
    ours = "our mazes, as the thesis' have no licence" if plan.name == "thesis" else "our mazes"
    mazes = "the user's mazes" if plan.mazes else ours
    search = " with the search of settings" if plan.tuning is not None else ""
    lines = [
        f"The **{plan.version}** version: {done} of {planned} runs are complete, {hours:.1f} core "
        f"hours of learning{search}, on {in_markdown(', '.join(machines) or 'no machine')} "
        f"(commit {', '.join(commits) or 'none'}), on {mazes}. Distances are those of the greedy "
        "policy to the exact optimum. Again: "
        f"`pursuit reproduce all --claims {plan.name} --version {plan.version}`."
    ]
    if plan.left_out:
        left_out = in_markdown(", ".join(plan.left_out))
        lines.append(f"Part of the other version alone, and not run here: {left_out}.")
    if plan.version == "short" and plan.name == "thesis":
        lines.append(
            "Minutes, or seconds, stand here for the half hours of the thesis. A verdict is one "
            "about our learners with these budgets: what has not been reached may be with more, "
            "and what the thesis' own code would do is not asked."
        )
    return lines


def summary(studies: Sequence[DecidedStudy]) -> list[str]:
    """All verdicts in one table: a row for each cell."""
    cells = Counter(cell.verdict for cell in cells_of_page(studies))
    told = ", ".join(f"{cells[name]} {name}" for name in (CONFIRMED, REFUTED, UNDECIDED))
    rows = []
    for each in studies:
        for found in each.claims:
            start = {"study": each.study.id, "claim": found.claim.text}
            none = dict.fromkeys(("side", "p", "p by Holm"), "–")
            if not found.cells:
                rows.append(start | {"cell": "no runs needed", "verdict": found.exact} | none)
            for cell in found.cells:
                name = named(cell.groups[0].cell) if cell.groups else "–"
                row = start | {"cell": name, "verdict": cell.verdict} | none
                if not math.isnan(cell.test.p):
                    row |= {"side": SIDES[cell.test.supports], "p": p_words(cell.test.p)}
                    row |= {"p by Holm": p_words(cell.corrected)}
                rows.append(row)
    return [
        f"Of {cells.total()} cells of claims about runs: {told}. {attainable(studies)}".rstrip(),
        plain_table(rows).markdown(),
        "Side: whether the runs lie on that of the claim. –: not tested, or not counted by Holm's "
        "correction because no result could decide the cell.",
    ]


def attainable(studies: Sequence[DecidedStudy]) -> str:
    """How many cells have too few runs for a verdict, in words."""
    cells = [cell for cell in cells_of_page(studies) if not math.isnan(cell.test.p)]
    late = sum(not best < LEVEL for best in at_best(cells))
    return f"No result of so few runs could have decided {late} of them." if late else ""


def at_best(cells: Sequence[Decision]) -> list[float]:
    """The corrected p of cells if all had their smallest attainable p; nan where not counted."""
    least = [replace(cell, test=replace(cell.test, p=cell.test.least)) for cell in cells]
    return [cell.corrected for cell in correct(least)]


def how(studies: Sequence[DecidedStudy]) -> list[str]:
    """The tests, and what they can decide with the runs that there are."""
    cells = [cell for cell in cells_of_page(studies) if not math.isnan(cell.test.p)]
    family = sum(cell.test.least < LEVEL for cell in cells)
    paragraphs = [
        "Each claim has one verdict for each cell, which is one task in one size. Settings are "
        "compared by a two-sided permutation test (of Mann and Whitney's U; runs are permuted "
        "within a maze). A claim about several rivals is confirmed by the largest of their p, and "
        "refuted by the smallest, times their number. A claim about a threshold is decided by the "
        "sign test: whether more than half of all runs meet it. All p are corrected together by "
        f"Holm's method for the {family} cells of this page that some result could decide. "
        f"**Confirmed** and **refuted** mean a corrected p below {LEVEL:g}; otherwise a cell is "
        "**undecided**, which does not mean that there is no effect. Intervals are Student's, and "
        "Welch's of a difference; they cover 95 % each and are not corrected."
    ]
    kinds: dict[tuple[bool, float, str], list[float]] = {}
    for cell, best in zip(cells, at_best(cells), strict=True):
        compared = len(cell.groups) > 1
        sizes = dict.fromkeys(str(len(group.runs)) for group in cell.groups)
        told = " against ".join(sizes if len(sizes) > 1 else [*sizes] * (1 + compared)) + " runs"
        rivals = len(cell.groups) - 1
        told += f", {rivals} rival{'s' * (rivals > 1)}" if compared else " against a threshold"
        kinds.setdefault((compared, cell.test.least, told), []).append(best)
    if not kinds:
        return paragraphs
    rows = [
        {
            "runs of a cell": told,
            "cells": len(bests),
            "smallest attainable p": p_words(least),
            "by Holm, if all cells had theirs": p_words(max(bests))
            if least < LEVEL
            else "not counted",
            f"to decide with all {len(cells)} cells counted": runs_needed(compared, len(cells)),
        }
        for (compared, least, told), bests in sorted(kinds.items(), key=lambda item: item[0][1])
    ]
    return [*paragraphs, "What so many runs can decide:", plain_table(rows).markdown()]


def runs_needed(compared: bool, cells: int) -> str:
    """The fewest runs of a setting whose smallest attainable p is below `LEVEL` when corrected."""

    def least(runs: int) -> float:
        return least_p([(runs, runs)]) if compared else 2.0 ** (1 - runs)

    enough = next(n for n in count(1) if cells * least(n) < LEVEL)
    return f"{enough} against {enough} runs" if compared else f"{enough} runs"


def settings_part(plan: Replication, tuning: Tuning, out: Path) -> list[str]:
    """What the search of settings found."""
    found, scores = tuned_settings(plan, out), trial_scores(plan, out)
    trials = getattr(tuning, plan.version)
    rows = []
    for algorithm in tuning.space:
        own = ", ".join(f"{name} {value:g}" for name, value in found.get(algorithm, {}).items())
        row: Row = {"algorithm": algorithm, "settings, where not as shipped": own or SHIPPED}
        rows.append(row | {"trials complete": len(scores.get(algorithm, {}))})
    return [
        f"For every algorithm {trials.samples} settings, {trials.seconds:g} s each on each of "
        f"{in_markdown(', '.join(tuning.mazes))}: those shipped and draws around them; the least "
        "mean logarithm of the gap was taken. Settings as shipped had been searched before, PPO's "
        "for longer than the others'.",
        plain_table(rows).markdown(),
    ]


def study_part(each: DecidedStudy, out: Path, who: str) -> list[str]:
    """One study, and who claims it."""
    study = each.study
    parts = [
        f"## {in_markdown(f'{study.id}: {study.title}')}",
        f"**{who}**: {in_markdown(study.thesis)} **Here**: {in_markdown(study.differs)}",
    ]
    if each.planned and len(each.runs) < each.planned:
        parts.append(f"**{len(each.runs)} of {each.planned} runs are complete.**")
    if each.warning:
        parts.append(f"**{in_markdown(each.warning)}**")
    for found in each.claims:
        claim, verdicts = found.claim, found.verdicts
        parts.append(f"### {in_markdown(claim.text)}")
        notes = dict.fromkeys(note for note in (found.note, *(c.note for c in found.cells)) if note)
        note = f" ({in_markdown('; '.join(notes))})" if notes else ""
        parts.append(f"{rule_words(claim)} **{headline(verdicts).capitalize()}**{note}.")
        tested = [cell for cell in found.cells if not math.isnan(cell.test.p)]
        parts.append(found.table or evidence(claim, found.cells))
        if tested:
            bullet = "- " if len(tested) > 1 else ""
            parts.append("\n".join(bullet + cell_words(cell, bool(bullet)) for cell in tested))
        parts += [
            f"Our reading: {in_markdown(claim.cause[verdict])}"
            for verdict in dict.fromkeys(verdicts)
            if verdict in claim.cause
        ]
    if (out / "report" / f"{study.id}.png").exists():
        parts.append(f"![{in_markdown(study.title)}: all runs]({study.id}.png)")
    return parts


def cell_words(cell: Decision, several: bool) -> str:
    """Verdict and p of a cell, in words."""
    start = f"{in_markdown(named(cell.groups[0].cell))}: **{cell.verdict}**, p" if several else "p"
    words = f"{start} = {p_words(cell.test.p)}, {SIDES[cell.test.supports]} the claim"
    if math.isnan(cell.corrected):
        return f"{words}; so many runs cannot give less than {p_words(cell.test.least)}."
    return f"{words}; by Holm {p_words(cell.corrected)}.".replace("= below", "below")
