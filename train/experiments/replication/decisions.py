"""Decisions on the claims of a replication, and their tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from train.experiments.replication.exact import states_table, tours_table
from train.experiments.replication.plan import Claim, Experiment, Replication
from train.experiments.replication.rules import (
    THRESHOLDS,
    Cell,
    Decision,
    Ran,
    correct,
    decide,
    value_of,
)
from train.experiments.replication.run import changed_rules, complete_runs, folder_of, planned_sweep


@dataclass(frozen=True)
class Decided:
    """A claim with its decisions.

    Attributes:
        claim: see `Claim`.
        cells: the decision of each cell; empty for a claim that needs no runs.
        exact: the verdict of a claim that needs no runs.
        note: the reason if `exact` is undecided.
        table: the evidence for `exact`, as Markdown.
    """

    claim: Claim
    cells: tuple[Decision, ...] = ()
    exact: str = ""
    note: str = ""
    table: str = ""

    @property
    def verdicts(self) -> list[str]:
        """The verdict of every cell."""
        return [cell.verdict for cell in self.cells] or [self.exact]


@dataclass(frozen=True)
class DecidedExperiment:
    """A study with its decided claims and complete runs."""

    study: Experiment
    claims: list[Decided]
    runs: list[Ran] = field(default_factory=list)
    planned: int = 0
    warning: str = ""


def decided(study: Experiment, plan: Replication, out: Path) -> DecidedExperiment:
    """Decide the claims of one study; p are not corrected yet."""
    if study.exact:
        tables = [
            states_table() if c.rule == "states" else tours_table(plan.mazes) for c in study.claims
        ]
        exact = [
            Decided(claim, (), verdict, note, table)
            for claim, (verdict, note, table) in zip(study.claims, tables, strict=True)
        ]
        return DecidedExperiment(study, exact)
    runs = complete_runs(folder_of(study, out), plan.mazes)
    claims = [Decided(c, tuple(decide(c, runs, study.least_frames))) for c in study.claims]
    planned = len(planned_sweep(study, plan, out).runs)
    return DecidedExperiment(study, claims, runs, planned, changed_rules(study, out))


def corrected(studies: Sequence[DecidedExperiment]) -> list[DecidedExperiment]:
    """The same studies, with the p of all cells corrected together."""
    found = iter(correct(cells_of_page(studies)))
    return [
        replace(
            each,
            claims=[replace(c, cells=tuple(next(found) for _ in c.cells)) for c in each.claims],
        )
        for each in studies
    ]


def cells_of_page(studies: Sequence[DecidedExperiment]) -> list[Decision]:
    """Every cell of every claim, in the order of the page."""
    return [cell for each in studies for claim in each.claims for cell in claim.cells]


def claim_rows(studies: Sequence[DecidedExperiment]) -> list[dict[str, object]]:
    """A row for each cell of each claim."""
    return [
        {
            "study": each.study.id,
            "claim": found.claim.text,
            "rule": found.claim.rule,
            **dict.fromkeys(("cell", "supports", "p", "p_holm", "least_p", "runs"), ""),
            **row,
        }
        for each in studies
        for found in each.claims
        for row in [cell_row(cell) for cell in found.cells]
        or [{"verdict": found.exact, "note": found.note}]
    ]


def cell_row(cell: Decision) -> dict[str, object]:
    """The test and the verdict of a cell."""
    return {
        "cell": named(cell.groups[0].cell) if cell.groups else "",
        "supports": "" if math.isnan(cell.test.p) else cell.test.supports,
        "p": _number(cell.test.p),
        "p_holm": _number(cell.corrected),
        "least_p": _number(cell.test.least),
        "runs": " against ".join(str(len(group.runs)) for group in cell.groups),
        "verdict": cell.verdict,
        "note": cell.note,
    }


def _number(value: float) -> object:
    return "" if math.isnan(value) else value


def value_rows(studies: Sequence[DecidedExperiment]) -> list[dict[str, object]]:
    """A row for each run of each cell of each claim: the data of the tests."""
    return [
        {
            "study": each.study.id,
            "claim": found.claim.text,
            "cell": number,
            "setting": named(group.cell),
            "rival": rival,
            "maze": run.row.get("maze"),
            "seed": run.seed,
            "value": value_of(run, found.claim),
            "meets": THRESHOLDS[found.claim.rule](run, found.claim)
            if found.claim.rule in THRESHOLDS
            else "",
            "frames": run.row["frames"],
        }
        for each in studies
        for found in each.claims
        for number, cell in enumerate(found.cells)
        for rival, group in enumerate(cell.groups)
        for run in group.runs
    ]


def named(cell: Cell) -> str:
    """A cell in words."""
    counts = {"joints": "joint", "num_goals": "goal"}
    words = []
    for name, value in cell.items():
        values = value if isinstance(value, list) else [value]
        shown = " and ".join(map(str, values))
        if name in counts:
            words.append(f"{shown} {counts[name]}{'s' * (values != [1])}")
        else:
            words.append(shown if isinstance(values[0], str) else f"{name} {shown}")
    return ", ".join(words)
