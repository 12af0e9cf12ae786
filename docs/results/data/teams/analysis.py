"""Tables of docs/results/teams.md and of README.md: critics and layers (cells.csv), and team
learners under three rules of capture (runs.csv).

The random unit is a maze with its seed, of 5x5-open a seed; units with a missing run are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from math import exp, log
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

from train.experiments.committed import grouped, read_table
from train.experiments.statistics import (
    LEVEL,
    holm,
    mean_interval,
    ratio_with_interval,
    sign_flip_p,
)
from train.reports.figures import BLUE, ORANGE, PlottedEstimate, draw_intervals
from train.reports.tables import plain_table

LEARNERS = ("separate", "ippo", "mappo", "joint", "vdn")
RULES = ("cell", "n_catch", "surround")
HARD = RULES[1:]
"""The rules for which several chasers are needed."""
LEAST_GAP, RATIO, SHARE = 0.001, log(1.25), 0.1
"""Smaller gaps count as this one; margins of claims: a ratio of gaps, a difference of shares."""
CRITICS, LAYERS = ("own", "state"), ("shared", "separate")
CELLS = ("own, shared", "own, separate", "state, shared", "state, separate")
VALUES = ("iql", "vdn")
LAST = ("no number, own observation, shared layers", "vdn against iql")
NO_NUMBER = "own, shared, no number"
BUDGETS = {"steps": (*CELLS, NO_NUMBER, *VALUES), "seconds": CELLS[:1]}
"""The learners of critics and layers that have runs, by what is equal. At equal seconds the first
has the seconds that the other cells take for their steps, with whose runs it is compared."""
TWO = RULES[:2]
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


def decided(every: Sequence[Claim]) -> list[Row]:
    """Every claim with its effect and verdict."""
    found = list[Row]()
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


# -- critics and layers ----------------------------------------------------------------------------

Part = Callable[[Row], float]


def cells_in(data: Path) -> dict[str, list[Unit]]:
    """The units of critics and layers with all their runs, by what is equal; in their order."""
    found: dict[str, list[Unit]] = {budget: [] for budget in BUDGETS}
    for rows in grouped(read_table(data / "cells.csv"), "maze").values():
        own = grouped(rows, "budget")
        runs = {b: {(row["learner"], row["rule"]): row for row in own.get(b, [])} for b in BUDGETS}
        if all(len(runs[b]) == len(BUDGETS[b]) * len(TWO) for b in BUDGETS):
            found["steps"].append(runs["steps"])
            found["seconds"].append(runs["steps"] | runs["seconds"])
    return found


def team_part(row: Row) -> float:
    """The gap of the team."""
    return float(row["optimality_gap"])


def own_part(row: Row) -> float:
    """The part of the gap that members can remove alone, their mean gap."""
    return float(row["members_gap"])


def joint_part(row: Row) -> float:
    """The rest, coordination."""
    return team_part(row) - own_part(row)


def level(unit: Unit, learner: str, rules: Sequence[str] = TWO, part: Part = team_part) -> float:
    """The mean over rules of the logarithm of a part of the gap."""
    return fmean(log(max(part(unit[learner, rule]), LEAST_GAP)) for rule in rules)


def contrasts(unit: Unit, rules: Sequence[str] = TWO, part: Part = team_part) -> dict[str, float]:
    """The differences of logarithms of a unit: main effects, their interaction, IQL and VDN."""
    at = {name: level(unit, name, rules, part) for name in CELLS}
    own, state = (at[f"{critic}, separate"] - at[f"{critic}, shared"] for critic in CRITICS)
    shared, separate = (at[f"state, {layers}"] - at[f"own, {layers}"] for layers in LAYERS)
    found = {
        "separate layers": (own + state) / 2.0,
        "critic of the state": (shared + separate) / 2.0,
        "separate layers, critic of the own observation": own,
        "separate layers, critic of the state": state,
        "critic of the state, shared layers": shared,
        "critic of the state, separate layers": separate,
        "interaction": state - own,
    }
    iql, vdn = (level(unit, name, rules, part) for name in VALUES)
    found["no number, own observation, shared layers"] = (
        level(unit, NO_NUMBER, rules, part) - at["own, shared"]
    )
    return found | {"vdn against iql": vdn - iql}


def cell_claims(units: dict[str, list[Unit]]) -> list[Claim]:
    """The claims on critics and layers, in order."""
    names = ("separate layers", "critic of the state")
    tested = [(name, budget) for budget in BUDGETS for name in names]
    return [
        Claim(
            f"{name}, equal {budget}", -1, RATIO, [contrasts(unit)[name] for unit in units[budget]]
        )
        for name, budget in [*tested, *((name, "steps") for name in LAST)]
    ]


def effects(units: dict[str, list[Unit]]) -> list[Row]:
    """Every contrast as a ratio: of gaps by budget and rule, and at equal steps of both parts."""
    columns: dict[str, tuple[str, Sequence[str], Part]] = {
        "both rules": ("steps", TWO, team_part),
        "cell": ("steps", TWO[:1], team_part),
        "n_catch": ("steps", TWO[1:], team_part),
        "members alone": ("steps", TWO, own_part),
        "coordination": ("steps", TWO, joint_part),
        "equal seconds": ("seconds", TWO, team_part),
    }
    found = []
    for name in contrasts(units["steps"][0]):
        line: Row = {"ratio of gaps [95 %]": name}
        for column, (budget, rules, part) in columns.items():
            logs = [contrasts(unit, rules, part)[name] for unit in units[budget]]
            line[column] = "{:.2f} [{:.2f}, {:.2f}]".format(*ratio_with_interval(logs))
        found.append(line)
    return found


def cells(units: dict[str, list[Unit]]) -> list[Row]:
    """By learner and budget the geometric mean of the gaps, the share of coordination in the sum of
    the gaps, and the medians of steps of games and of seconds."""
    found = []
    for budget, learners in BUDGETS.items():
        for name in learners:
            line: Row = {"equal": budget, "learner": name}
            for rule in TWO:
                runs = [unit[name, rule] for unit in units[budget]]
                gap = exp(fmean(level(unit, name, [rule]) for unit in units[budget]))
                joint = sum(map(joint_part, runs)) / sum(map(team_part, runs))
                line |= {f"{rule}: gap": f"{100.0 * gap:.1f} %", f"{rule}: share": f"{joint:.2f}"}
                steps = median(row["frames"] for row in runs) / 2000.0  # a frame is of one agent
                line[f"{rule}: thousand steps"] = f"{steps:.0f}"
                line[f"{rule}: seconds"] = f"{median(row['seconds'] for row in runs):.1f}"
            found.append(line)
    return found


def cell_gaps(units: dict[str, list[Unit]]) -> list[Row]:
    """At equal steps the gaps of every maze, and in brackets those of members."""
    found = []
    for unit, rule in product(units["steps"], TWO):
        runs = {name: unit[name, rule] for name in BUDGETS["steps"]}
        best = runs["iql"]["optimal_steps"]
        line: Row = {"maze": runs["iql"]["maze"][-3:], "rule": rule, "best steps": f"{best:.2f}"}
        for name, row in runs.items():
            line[name] = f"{100.0 * team_part(row):.1f} ({100.0 * own_part(row):.1f})"
        found.append(line)
    return found


# -- figures ---------------------------------------------------------------------------------------


def mappo_against_ippo(unit: Unit) -> float:
    """The logarithm of the ratio of their gaps."""
    return level(unit, CELLS[-1]) - level(unit, CELLS[0])


def draw_ratios(path: Path, units: dict[str, list[Unit]]) -> None:
    """The claims on critics and layers as ratios, and MAPPO against IPPO, which differs in both."""
    found = []
    for budget, color in (("steps", BLUE), ("seconds", ORANGE)):
        lines = {"mappo against ippo": [mappo_against_ippo(unit) for unit in units[budget]]}
        for claim in cell_claims(units):
            name, _, own = claim.text.partition(", equal ")
            if own == budget:
                lines[name.partition(",")[0]] = claim.values
        for name, logs in lines.items():
            points = [exp(value) for value in logs]
            label = "vdn against iql" if name == LAST[1] else name
            label = "without the agent's number" if label == "no number" else label
            ends = ratio_with_interval(logs)
            found.append(PlottedEstimate(label, *ends, points, color, f"equal {budget}"))
    label = "ratio of gaps, below 1: the named learner is nearer"
    title = "Gaps to the best team response:\nmeans of nine mazes, 95 % intervals"
    draw_intervals(path, {label: ("ratio", found)}, title, also="png")


def draw_gaps(path: Path, units: Sequence[Unit]) -> None:
    """The gaps of five learners under three rules."""
    panels = {}
    for rule in RULES:
        found = []
        parts = (("optimality_gap", "team", BLUE), ("members_gap", "members alone", ORANGE))
        for name, (column, group, color) in product(LEARNERS, parts):
            gaps = [100.0 * max(unit[name, rule][column], LEAST_GAP) for unit in units]
            ends = ratio_with_interval([log(gap) for gap in gaps])
            found.append(PlottedEstimate(name, *ends, gaps, color, group))
        panels[f"{rule}: gap (%)"] = ("log", found)
    title = "Gaps to the best team response, geometric means and 95 % intervals over 14 units"
    draw_intervals(path, panels, title, also="png")


def figures(data: Path, out: Path) -> None:
    """Both figures: of the page, and of the former study."""
    draw_ratios(out / "ratios.png", cells_in(data))
    draw_gaps(out / "gaps.png", [unit for own in units_in(data).values() for unit in own])


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    units = units_in(data)
    every = [unit for own in units.values() for unit in own]
    spent = budgets(every)
    heads = {name: name.partition(": ")[2] for name in spent[0] if name.endswith(HARD)}
    both = cells_in(data)
    return {
        "critics and layers": plain_table(decided(cell_claims(both))).markdown(),
        "learners": plain_table(cells(both)).markdown(),
        "effects": plain_table(effects(both)).markdown(),
        "gaps of every maze": plain_table(cell_gaps(both)).markdown(),
        "gaps": plain_table(gaps(units)).markdown(),
        "claims": plain_table(decided(claims(every))).markdown(),
        "budgets": plain_table(spent, heads).markdown(),
    }
