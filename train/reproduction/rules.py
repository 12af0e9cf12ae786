"""The rules that decide claims: what one seed says, and what all of them do."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from train.experiments.statistics import holm, permutation_p
from train.settings.checks import check

CONFIRMED, REFUTED, UNDECIDED = "confirmed", "refuted", "undecided"
ENOUGH, FEW = 0.8, 0.2
"""Shares of the seeds from which on, and up to which, a claim is confirmed and refuted."""
LEAST_SEEDS = 5
FALL = 0.01
"""Of the time limit: what the episodes must grow shorter by in the last third to be falling."""
TO = {"optimal": "optimal_steps", "scripted": "scripted_steps", "limit": "max_steps"}
"""References by the column of the table of runs that has them."""

PARTS = ("floor", "learning", "loops")
"""Of a gap."""

Cell = dict[str, Any]


@dataclass(frozen=True)
class Ran:
    """A complete run.

    Attributes:
        row: of the table of runs.
        lengths: the mean episode length at every evaluation, in order.
        label: what its experiment varies, as its file says it.
    """

    row: Mapping[str, Any]
    lengths: tuple[float, ...] = ()
    label: Mapping[str, Any] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        """Its seed."""
        return int(self.row["seed"])

    def number(self, column: str) -> float:
        """A figure of the table of runs; ValueError where this run has none."""
        value = self.row.get(column)
        check(
            value is not None,
            f"run {self.row.get('run')}: {column} is not known in this task, and a rule asks for "
            "it; decide the claim by another rule",
        )
        return float(value)  # type: ignore[arg-type]

    @property
    def distance(self) -> float:
        """How far from the optimum: the gap without its sign in per cent; of self-play NashConv."""
        gap = self.row.get("optimality_gap")
        return 100.0 * abs(gap) if gap is not None else self.number("nash_conv")


def diverged(run: Ran) -> bool:
    """Whether more than half of the starts stay unsolved, and nothing falls in the last third.

    Falling: the mean of the second half of the last third of the evaluations lies below that of its
    first half by more than `FALL` of the time limit.
    """
    if not run.number("unsolved_share") > 0.5:
        return False
    last = np.asarray(run.lengths)[-max(len(run.lengths) // 3, 2) :]
    if len(last) < 2:
        return True
    half = len(last) // 2
    return bool(last[:half].mean() - last[half:].mean() <= FALL * run.number("max_steps"))


def worse_by(run: Ran, to: str) -> float:
    """By how many per cent a run is worse than a reference; below 0 where it is better.

    Whoever wants to be long in the game (an evader) is worse where it is short.
    """
    steps, reference = run.number("mean_steps"), run.number(TO[to])
    sign = -1.0 if run.row.get("role") == "evader" else 1.0
    return 100.0 * sign * (steps - reference) / reference


def part_of(run: Ran, part: str) -> float:
    """How many per cent of a run's gap are one of its parts (`PARTS`).

    "floor" is that of the objective, "loops" what the unsolved starts add to the gap of the solved
    ones, "learning" the rest. 0 where there is no gap at all.
    """
    gap, solved = run.number("optimality_gap"), run.number("solved_gap")
    floor = run.number("objective_floor")
    parts = {"floor": floor, "loops": gap - solved, "learning": solved - floor}
    return 100.0 * parts[part] / gap if gap > 0.0 else 0.0


# -- what a seed says ------------------------------------------------------------------------------


RULES: dict[str, Callable[[Ran, Sequence[Ran], Any], bool]] = {
    "diverges": lambda run, others, claim: diverged(run),
    "learns": lambda run, others, claim: not diverged(run),
    "lower": lambda run, others, claim: all(run.distance < o.distance for o in others),
    "higher": lambda run, others, claim: all(run.distance > o.distance for o in others),
    "within": lambda run, others, claim: worse_by(run, claim.to) <= claim.percent + 1e-9,
    "part_above": lambda run, others, claim: part_of(run, claim.part) >= claim.percent,
    "part_below": lambda run, others, claim: part_of(run, claim.part) < claim.percent,
    "beyond": lambda run, others, claim: worse_by(run, claim.to) > claim.percent + 1e-9,
}


def cells_of(table: Cell) -> list[Cell]:
    """Every combination of the values of a table: {"maze": ["5x5", "7x7"]} are two cells."""
    lists = [value if isinstance(value, list) else [value] for value in table.values()]
    return [dict(zip(table, values, strict=True)) for values in itertools.product(*lists)]


def runs_of(runs: Sequence[Ran], cell: Cell) -> dict[int, Ran]:
    """The runs of a cell by their seed."""
    return {
        run.seed: run
        for run in runs
        if all(run.row.get(name) == value for name, value in cell.items())
    }


def places_of(runs: Sequence[Ran], table: Cell) -> list[Cell]:
    """The cells of a table, each with one run a seed.

    What a table leaves open and its experiment varies makes several of one: {"algorithm": "ppo"}
    is a cell for each maze.
    """
    places = []
    for cell in cells_of(table):
        labels = [
            run.label
            for run in runs
            if all(run.row.get(name) == value for name, value in cell.items())
        ]
        names = dict.fromkeys(name for label in labels for name in label if name not in cell)
        open_ = [name for name in names if len({str(label.get(name)) for label in labels}) > 1]
        found = [{name: label.get(name) for name in open_} for label in labels]
        apart = {str(more): {**cell, **more} for more in found}
        places += [apart[told] for told in sorted(apart)] or [cell]
    return places


@dataclass(frozen=True)
class Verdict:
    """What came of a claim.

    Attributes:
        verdict: `CONFIRMED`, `REFUTED` or `UNDECIDED`.
        says: by seed, whether it says so.
        note: why it is undecided, where that is not for the seeds' disagreement.
        cells: what the verdict rests on: every cell with the distances of its runs by seed.
        ps: of a comparison: p of the permutation test against each of the others, in their order,
            corrected for how many they are (Holm).
    """

    verdict: str
    says: dict[int, bool]
    note: str = ""
    cells: tuple[tuple[Cell, dict[int, Ran]], ...] = ()
    ps: tuple[float, ...] = ()


def decide(claim: Any, runs: Sequence[Ran], least_frames: int) -> Verdict:
    """What the runs say of a claim: see `RULES`, `ENOUGH` and `FEW`.

    Undecided, and why, where a run has not what the rule asks for.

    Args:
        claim: with a rule of `RULES`.
        runs: the complete ones of its study.
        least_frames: with fewer a run says nothing.
    """
    try:
        return _decide(claim, runs, least_frames)
    except ValueError as error:
        return Verdict(UNDECIDED, {}, str(error))


def _decide(claim: Any, runs: Sequence[Ran], least_frames: int) -> Verdict:
    places = places_of(runs, claim.of)
    others = [places_of(runs, table) for table in claim.than]
    for cells in others:
        check(
            len(cells) in (1, len(places)),
            f"{len(places)} cells are compared with {len(cells)}; name what is to be compared",
        )
    ours = [runs_of(runs, cell) for cell in places]
    theirs = [[runs_of(runs, cell) for cell in cells] for cells in others]
    everything = [*ours, *itertools.chain.from_iterable(theirs)]
    shown = tuple(zip([*places, *itertools.chain(*others)], everything, strict=True))
    seeds = sorted(set.intersection(*(set(found) for found in everything)))
    few = [
        run.row["frames"]
        for found in everything
        for run in found.values()
        if run.row["frames"] < least_frames
    ]
    if few:
        note = f"runs of {min(few):,} frames say nothing; it takes {least_frames:,}"
        return Verdict(UNDECIDED, {}, note, shown)
    rule = RULES[claim.rule]
    says = {}
    for seed in seeds:
        # Cells in step: the first of ours against the first of each of the others, and so on.
        pairs = [
            (own[seed], [other[number % len(other)][seed] for other in theirs])
            for number, own in enumerate(ours)
        ]
        says[seed] = all(rule(run, like, claim) for run, like in pairs)
    ps: list[float] = []
    if claim.than and len(seeds) > 1:
        for other in theirs:
            mine = [[own[s].distance for s in seeds] for own in ours]
            his = [[other[n % len(other)][s].distance for s in seeds] for n in range(len(ours))]
            ps.append(permutation_p(mine, his))
    return Verdict(*verdict_of(says), shown, tuple(holm(ps)))


def verdict_of(says: Mapping[int, bool]) -> tuple[str, dict[int, bool], str]:
    """The verdict of so many seeds, what they said, and why it is none."""
    said = dict(says)
    if len(said) < LEAST_SEEDS:
        return UNDECIDED, said, f"{len(said)} complete seeds; it takes {LEAST_SEEDS}"
    share = sum(said.values()) / len(said)
    if share >= ENOUGH - 1e-9:
        return CONFIRMED, said, ""
    return (REFUTED if share <= FEW + 1e-9 else UNDECIDED), said, ""
