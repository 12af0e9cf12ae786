"""Tables of docs/results/teams.md: team learners under three rules of capture.

The random unit is a maze with its seed, of 5x5-open a seed; units with a missing run are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import exp, log
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

from train.experiments.committed import grouped, read_table
from train.experiments.statistics import LEVEL, holm, mean_interval, sign_flip_p
from train.reports.tables import plain_table

LEARNERS = ("separate", "ippo", "mappo", "joint", "vdn")
RULES = ("cell", "n_catch", "surround")
HARD = RULES[1:]
"""The rules for which several chasers are needed."""
LEAST_GAP, RATIO, SHARE = 0.001, log(1.25), 0.1
"""Smaller gaps count as this one; margins of claims: a ratio of gaps, a difference of shares."""
Row = dict[str, Any]
Unit = dict[tuple[str, str], Row]
"""The runs of a unit by learner and rule."""


class Claim(NamedTuple):
    """A claim of the page: that the values of the units are above 0 (sign 1) or below it (-1)."""

    text: str
    sign: int
    margin: float
    values: list[float]

    @property
    def is_ratio(self) -> bool:
        """Whether the values are logarithms of ratios."""
        return self.margin == RATIO


def units_in(data: Path) -> dict[str, list[Unit]]:
    """The units by their kind of maze."""
    found: dict[str, list[Unit]] = {}
    for (kind, _), rows in grouped(read_table(data / "runs.csv"), "kind", "seed").items():
        unit = {(row["learner"], row["rule"]): row for row in rows}
        if len(unit) == len(LEARNERS) * len(RULES):
            found.setdefault(kind, []).append(unit)
    return found


def gap(unit: Unit, learner: str) -> float:
    """The mean over rules of the logarithm of a learner's gap."""
    gaps = (unit[learner, rule]["optimality_gap"] for rule in RULES)
    return fmean(log(max(gap, LEAST_GAP)) for gap in gaps)


def share(unit: Unit, *rules: str) -> float:
    """The share of the team's gap that no member can remove alone."""
    own = [unit[key] for key in product(LEARNERS, rules)]
    team, members = (sum(row[name] for row in own) for name in ("optimality_gap", "members_gap"))
    return 1.0 - members / team


def claims(units: Sequence[Unit]) -> list[Claim]:
    """The claims of the page, in order."""

    def ratio(text: str, sign: int, learner: str) -> Claim:
        return Claim(text, sign, RATIO, [gap(unit, learner) - gap(unit, "ippo") for unit in units])

    shares = [(share(unit, *HARD), share(unit, "cell")) for unit in units]
    half = "share of coordination above one half under n_catch and surround (share − 0.5)"
    larger = "this share is larger than under cell (difference of shares)"
    return [
        ratio("the team as one player is nearer than ippo (ratio of gaps)", -1, "joint"),
        ratio("mappo is nearer than ippo (ratio)", -1, "mappo"),
        ratio("separate is farther than ippo (ratio)", 1, "separate"),
        ratio("vdn is nearer than ippo (ratio)", -1, "vdn"),
        Claim(half, 1, SHARE, [hard - 0.5 for hard, _ in shares]),
        Claim(larger, 1, SHARE, [hard - cell for hard, cell in shares]),
    ]


def verdict(claim: Claim, p: float) -> str:
    """The verdict on a claim, with its corrected p."""
    signed = claim.sign * fmean(claim.values)
    if p < LEVEL and signed < 0.0:
        return "refuted"
    if p < LEVEL:
        return "confirmed" if signed >= claim.margin else "confirmed, within the margin"
    low, high = mean_interval([claim.values], 0.9)
    inside = -claim.margin < low <= high < claim.margin
    return "equal within the margin" if inside else "undecided"


def decided(units: Sequence[Unit]) -> list[Row]:
    """Every claim with its effect and verdict."""
    found, every = list[Row](), claims(units)
    ps = holm([sign_flip_p(claim.values) for claim in every])
    for number, (claim, p) in enumerate(zip(every, ps, strict=True), start=1):
        effect = [fmean(claim.values), *mean_interval([claim.values])]
        shown = [exp(value) if claim.is_ratio else value for value in effect]
        favour = sum(claim.sign * value > 0.0 for value in claim.values)
        line: Row = {"claim": f"{number}. {claim.text}"}
        line["effect [95 %]"] = "{:.2f} [{:.2f}, {:.2f}]".format(*shown)
        line["units in favour"] = f"{favour} of {len(claim.values)}"
        found.append(line | {"p (Holm)": f"{p:.1g}", "verdict": verdict(claim, p)})
    return found


def gaps(units: dict[str, list[Unit]]) -> list[Row]:
    """Mean gaps of teams and, in brackets, of members, by maze and rule."""
    found = []
    for (kind, own), rule in product(units.items(), RULES):
        best = fmean(unit["ippo", rule]["optimal_steps"] for unit in own)
        line: Row = {"mazes": kind, "rule": rule, "units": len(own), "best steps": f"{best:.2f}"}
        for name in LEARNERS:
            runs = [unit[name, rule] for unit in own]
            team, members = (
                100.0 * fmean(row[column] for row in runs)
                for column in ("optimality_gap", "members_gap")
            )
            line[name] = f"{team:.1f} ({members:.1f})"
        found.append(line)
    return found


def budgets(units: Sequence[Unit]) -> list[Row]:
    """Of every learner by rule the median seconds, and the median share of the last third of the
    evaluations in the fall of steps; and its time-outs."""
    found = []
    for name in LEARNERS:
        runs = {rule: [unit[name, rule] for unit in units] for rule in RULES}
        line: Row = {"learner": name}
        for rule, own in runs.items():
            line[f"seconds: {rule}"] = f"{median(row['seconds'] for row in own):.1f}"
        for rule, own in runs.items():
            last = median(row["last_share"] or 0.0 for row in own)
            line[f"last third: {rule}"] = f"{100.0 * last:.1f} %"
        unsolved = fmean(row["unsolved_share"] for own in runs.values() for row in own)
        found.append(line | {"time-outs": f"{100.0 * unsolved:.1f} %"})
    return found


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    units = units_in(data)
    every = [unit for own in units.values() for unit in own]
    spent = budgets(every)
    heads = {name: name.partition(": ")[2] for name in spent[0] if name.endswith(HARD)}
    return {
        "gaps": plain_table(gaps(units)).markdown(),
        "claims": plain_table(decided(every)).markdown(),
        "budgets": plain_table(spent, heads).markdown(),
    }
