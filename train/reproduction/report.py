"""The replication report: claim, conditions, rule, verdict, evidence and cause, on one page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from train.experiments.page import page_of
from train.files import begins_with, write_bytes, write_csv, write_text
from train.reproduction.exact import states_table, tours_table
from train.reproduction.plan import SHIPPED, Claim, Replication, Study, Tuning
from train.reproduction.rules import (
    CONFIRMED,
    REFUTED,
    UNDECIDED,
    Cell,
    Ran,
    Verdict,
    decide,
    part_of,
    worse_by,
)
from train.reproduction.run import (
    RULES_KEPT,
    TUNING,
    changed_rules,
    complete_runs,
    folder_of,
    planned_sweep,
    trial_scores,
    tuned_settings,
)
from train.result_table import in_markdown

PAGE = "replication.md"
PICTURES = ("final.png", "learning_curves_frames.png")
"""Of a study's report, the first that there is."""
PART_WORDS = {"floor": "the objective's floor", "learning": "not learned", "loops": "loops"}
REFERENCES = {
    "optimal": "the optimum",
    "scripted": "the scripted reference",
    "limit": "the time limit",
}


@dataclass(frozen=True)
class Decided:
    """A study with what came of it."""

    study: Study
    runs: list[Ran]
    planned: int
    verdicts: list[tuple[Claim, Verdict, list[str]]]
    warning: str


def write_replication(plan: Replication, out: Path) -> Path:
    """Decide every claim by the runs that are complete, and write the page.

    Returns:
        `report/replication.md` in `out`; beside it `replication.html`, `claims.csv` and a figure
        for each study.
    """
    folder = out / "report"
    folder.mkdir(parents=True, exist_ok=True)
    studies = [decided(study, plan, out) for study in plan.studies]
    for each in studies:
        drawn = [folder_of(each.study, out) / "report" / name for name in PICTURES]
        for picture in [path for path in drawn if path.exists()][:1]:
            write_bytes(folder / f"{each.study.id}.png", picture.read_bytes())
    write_csv(folder / "claims.csv", claim_rows(studies))
    write_text(folder / PAGE, page(plan, studies, out))
    page_of(folder / PAGE)
    return folder / PAGE


def is_folder_of(plan: Replication, out: Path) -> bool:
    """Whether `out` was begun for these claims, and has no page of others."""
    page = out / "report" / PAGE
    own = not page.exists() or begins_with(page, f"# {plan.title}\n")
    return own and (out / RULES_KEPT).exists()


def decided(study: Study, plan: Replication, out: Path) -> Decided:
    """One study."""
    if study.exact:
        exact = [
            (claim, *(states_table() if claim.rule == "states" else tours_table(plan.mazes)))
            for claim in study.claims
        ]
        return Decided(study, [], 0, exact, "")
    runs = complete_runs(folder_of(study, out), plan.mazes)
    verdicts = []
    for claim in study.claims:
        verdict = decide(claim, runs, study.least_frames)
        verdicts.append((claim, verdict, evidence(claim, verdict)))
    planned = len(planned_sweep(study, plan, out).runs)
    return Decided(study, runs, planned, verdicts, changed_rules(study, out))


def claim_rows(studies: Sequence[Decided]) -> list[dict[str, object]]:
    """A row for each claim."""
    return [
        {
            "study": each.study.id,
            "claim": claim.text,
            "rule": claim.rule,
            "verdict": verdict.verdict,
            "seeds_that_say_so": sum(verdict.says.values()),
            "seeds": len(verdict.says),
            "note": verdict.note,
        }
        for each in studies
        for claim, verdict, _ in each.verdicts
    ]


# -- words -----------------------------------------------------------------------------------------


def named(cell: Cell) -> str:
    """A cell in words."""
    counts = {"joints": "joint", "num_goals": "goal"}
    return ", ".join(
        f"{value} {counts[name]}{'s' * (value != 1)}"
        if name in counts and isinstance(value, int)
        else str(value)
        if isinstance(value, str)
        else f"{name} {value}"
        for name, value in cell.items()
    )


def rule_words(claim: Claim) -> str:
    """How a seed says so, in a sentence."""
    others = " and than that of ".join(named(other) for other in claim.than)
    reference = f"{claim.percent:g} % worse than {REFERENCES[claim.to]}"
    return {
        "diverges": "A seed says so where more than half of the starts stay unsolved and nothing "
        "falls in the last third of the run.",
        "learns": "A seed says so unless more than half of the starts stay unsolved and nothing "
        "falls in the last third of the run.",
        "lower": "A seed says so where its distance to the optimum is smaller than that of "
        f"{others}.",
        "higher": "A seed says so where its distance to the optimum is larger than that of "
        f"{others}.",
        "within": f"A seed says so where it ends no more than {reference}.",
        "beyond": f"A seed says so where it ends more than {reference}.",
        "part_above": f"A seed says so where at least {claim.percent:g} % of its gap is "
        f"{PART_WORDS[claim.part]}.",
        "part_below": f"A seed says so where less than {claim.percent:g} % of its gap is "
        f"{PART_WORDS[claim.part]}.",
        "states": "Confirmed where all numbers are the same.",
        "tours": "Confirmed where all lie within 5 % (the table's are means over 1000 episodes).",
    }[claim.rule]


def evidence(claim: Claim, verdict: Verdict) -> list[str]:
    """The table of what the verdict rests on: every cell, a number a seed."""
    runs = [run for _, found in verdict.cells for run in found.values()]
    if not runs:
        return []
    of_play = runs[0].row.get("optimality_gap") is None
    what = "NashConv" if of_play else "distance to the optimum, %"

    def value(run: Ran) -> float:
        if claim.rule in ("diverges", "learns"):
            return 100.0 * run.number("unsolved_share")
        if claim.rule in ("part_above", "part_below"):
            return part_of(run, claim.part)
        return worse_by(run, claim.to) if claim.rule in ("within", "beyond") else run.distance

    if claim.rule in ("diverges", "learns"):
        what = "starts unsolved, %"
    elif claim.rule in ("part_above", "part_below"):
        what = f"share of the gap: {PART_WORDS[claim.part]}, %"
    elif claim.rule in ("within", "beyond"):
        what = f"worse than {REFERENCES[claim.to]} by, %"
    lines = [f"| runs | {what}, by seed | median | frames, M |", "|---|---|---|---|"]
    for cell, found in verdict.cells:
        values = [value(found[seed]) for seed in sorted(found)]
        frames = [run.row["frames"] / 1e6 for run in found.values()]
        if values:
            lines.append(
                f"| {in_markdown(named(cell))} | {', '.join(map(figure, values))} "
                f"| {figure(median(values))} | {min(frames):.2g} to {max(frames):.2g} |"
            )
    if verdict.ps:
        told = ", ".join(f"{p:.3f}" if p >= 0.001 else "below 0.001" for p in verdict.ps)
        lines += ["", f"p of the permutation test against each of the others, by Holm: {told}."]
    return lines


def figure(value: float) -> str:
    """A number with as many digits as matter."""
    if abs(value) < 1e-9:  # sums in another order
        return "0"
    return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.3g}"


def page(plan: Replication, studies: Sequence[Decided], out: Path) -> str:
    """All of it as Markdown."""
    parts = [
        f"# {in_markdown(plan.title)}",
        *head(plan, studies, out),
        "## Verdicts",
        *summary(studies),
    ]
    if plan.tuning is not None:
        parts += ["## Settings", *settings_part(plan, plan.tuning, out)]
    for each in studies:
        parts += study_part(each, out, "The thesis" if plan.name == "thesis" else "The claim")
    return "\n\n".join(parts) + "\n"


def head(plan: Replication, studies: Sequence[Decided], out: Path) -> list[str]:
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
        f"(commit {', '.join(commits) or 'none'}), on {mazes}. A claim is **confirmed** where at "
        "least four fifths of its seeds say so (five seeds at least), **refuted** where at most a "
        "fifth do, else **undecided**; the rules were written down before the runs. Distances are "
        "those of the greedy policy to the exact optimum. Again: "
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


def summary(studies: Sequence[Decided]) -> list[str]:
    """All verdicts in one table."""
    count = Counter(verdict.verdict for each in studies for _, verdict, _ in each.verdicts)
    told = ", ".join(f"{count[name]} {name}" for name in (CONFIRMED, REFUTED, UNDECIDED))
    lines = ["| study | claim | verdict | seeds that say so |", "|---|---|---|---|"]
    for each in studies:
        for claim, verdict, _ in each.verdicts:
            seeds = f"{sum(verdict.says.values())} of {len(verdict.says)}" if verdict.says else "–"
            cells = (in_markdown(each.study.id), in_markdown(claim.text))
            lines.append(f"| {' | '.join(cells)} | **{verdict.verdict}** | {seeds} |")
    return [f"{told}.", "\n".join(lines)]


def settings_part(plan: Replication, tuning: Tuning, out: Path) -> list[str]:
    """What the search of settings found."""
    found, scores = tuned_settings(plan, out), trial_scores(plan, out)
    trials = getattr(tuning, plan.version)
    lines = ["| algorithm | settings, where not as shipped | trials complete |", "|---|---|---|"]
    for algorithm in tuning.space:
        own = ", ".join(f"{name} {value:g}" for name, value in found.get(algorithm, {}).items())
        lines.append(f"| {algorithm} | {own or SHIPPED} | {len(scores.get(algorithm, {}))} |")
    return [
        f"For every algorithm {trials.samples} settings, {trials.seconds:g} s each on each of "
        f"{in_markdown(', '.join(tuning.mazes))}: those shipped and draws around them; the least "
        "mean logarithm of the gap was taken. Settings as shipped had been searched before, PPO's "
        "for longer than the others'.",
        "\n".join(lines),
    ]


def study_part(each: Decided, out: Path, who: str) -> list[str]:
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
    for claim, verdict, lines in each.verdicts:
        said = f", {sum(verdict.says.values())} of {len(verdict.says)}" if verdict.says else ""
        note = f" ({in_markdown(verdict.note)})" if verdict.note else ""
        parts.append(f"### {in_markdown(claim.text)}")
        parts.append(f"{rule_words(claim)} **{verdict.verdict.capitalize()}{said}**{note}.")
        if lines:
            parts.append("\n".join(lines))
        if verdict.verdict in claim.cause:
            parts.append(f"Our reading: {in_markdown(claim.cause[verdict.verdict])}")
    if (out / "report" / f"{study.id}.png").exists():
        parts.append(f"![{in_markdown(study.title)}: all runs]({study.id}.png)")
    return parts
