"""The tests that decide claims: one for each cell, corrected over all cells of a page.

A cell is one task in one size. Its verdict is that of a test whose p, corrected for the number of
cells (Holm), is below `LEVEL`; otherwise it is undecided. There is no verdict over several cells.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import binomtest

from pursuit.mazes.suite_files import is_suite
from train.experiments.statistics import LEVEL, holm, improvement, least_p, permutation_p
from train.experiments.tables import longer_is_better
from train.settings.checks import check

CONFIRMED, REFUTED, UNDECIDED = "confirmed", "refuted", "undecided"
FALL = 0.01
"""Episode lengths fall if they decrease by more than this share of the time limit."""
TO = {"optimal": "optimal_steps", "scripted": "scripted_steps", "limit": "max_steps"}
"""Columns of references in the table of runs."""

PARTS = ("objective", "learning", "loops")
"""Parts of a gap, see `part_of`."""

Cell = dict[str, Any]


@dataclass(frozen=True)
class Ran:
    """A complete run.

    Attributes:
        row: of the table of runs.
        lengths: the mean episode length at every evaluation, in order.
        label: the varying settings of its experiment, as in the file.
    """

    row: Mapping[str, Any]
    lengths: tuple[float, ...] = ()
    label: Mapping[str, Any] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        """Its seed."""
        return int(self.row["seed"])

    def number(self, column: str) -> float:
        """A value of the table of runs; ValueError if this run has none."""
        value = self.row.get(column)
        check(
            value is not None,
            f"run {self.row.get('run')}: {column} is not known in this task, but the rule of a "
            "claim needs it; use another rule",
        )
        return float(value)  # type: ignore[arg-type]

    @property
    def distance(self) -> float:
        """The absolute gap to the optimum in per cent; NashConv for self-play."""
        gap = self.row.get("optimality_gap")
        return 100.0 * abs(gap) if gap is not None else self.number("nash_conv")


def diverged(run: Ran) -> bool:
    """Whether most starts are unsolved, and episode lengths do not fall in the last third.

    They fall if the mean of the second half of the last third of the evaluations is below that of
    the first half by more than `FALL` of the time limit.
    """
    if not run.number("unsolved_share") > 0.5:
        return False
    last = np.asarray(run.lengths)[-max(len(run.lengths) // 3, 2) :]
    if len(last) < 2:
        return True
    half = len(last) // 2
    return bool(last[:half].mean() - last[half:].mean() <= FALL * run.number("max_steps"))


def worse_by(run: Ran, to: str) -> float:
    """By how many per cent a run is worse than a reference; negative if it is better.

    Evaders maximise episode length, so shorter episodes are worse.
    """
    steps, reference = run.number("mean_steps"), run.number(TO[to])
    sign = -1.0 if longer_is_better(run.row) else 1.0
    return 100.0 * sign * (steps - reference) / reference


def part_of(run: Ran, part: str) -> float:
    """The share of one part (`PARTS`) in the gap of a run, in per cent.

    "objective" is the objective gap, "loops" the gap added by unsolved starts, "learning" the rest.
    0 if there is no gap.
    """
    gap, solved = run.number("optimality_gap"), run.number("solved_gap")
    floor = run.number("objective_gap")
    parts = {"objective": floor, "loops": gap - solved, "learning": solved - floor}
    return 100.0 * parts[part] / gap if gap > 0.0 else 0.0


# -- values of runs --------------------------------------------------------------------------------


THRESHOLDS: dict[str, Callable[[Ran, Any], bool]] = {
    "diverges": lambda run, claim: diverged(run),
    "learns": lambda run, claim: not diverged(run),
    "within": lambda run, claim: worse_by(run, claim.to) <= claim.percent + 1e-9,
    "beyond": lambda run, claim: worse_by(run, claim.to) > claim.percent + 1e-9,
    "part_above": lambda run, claim: part_of(run, claim.part) >= claim.percent,
    "part_below": lambda run, claim: part_of(run, claim.part) < claim.percent,
}
"""Rules that compare each run with a threshold: whether a run meets the rule."""
COMPARISONS = ("lower", "higher")
"""Rules that compare the distances of two settings."""
RULES = (*THRESHOLDS, *COMPARISONS)


def value_of(run: Ran, claim: Any) -> float:
    """The value of a run that a claim is about, in per cent; NashConv for self-play."""
    if claim.rule in ("diverges", "learns"):
        return 100.0 * run.number("unsolved_share")
    if claim.rule in ("part_above", "part_below"):
        return part_of(run, claim.part)
    return worse_by(run, claim.to) if claim.rule in ("within", "beyond") else run.distance


# -- tests -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CellTest:
    """A test of one cell.

    Attributes:
        p: two-sided; nan if nothing was tested.
        supports: whether the direction is that of the claim.
        least: the smallest p that is possible with so many runs.
    """

    p: float = float("nan")
    supports: bool = False
    least: float = 1.0


def threshold_test(meets: Sequence[bool]) -> CellTest:
    """The sign test: whether more than half of all runs of a setting would meet a rule.

    Exact (binomial), without assumptions on the distribution, so it is robust to a few failed runs.

    Args:
        meets: whether each run meets the rule; at least one.
    """
    count, runs = sum(meets), len(meets)
    p = float(binomtest(count, runs).pvalue)
    return CellTest(p, 2 * count > runs, min(1.0, 2.0 ** (1 - runs)))


def comparison_test(
    ours: Sequence[Sequence[float]], rivals: Sequence[Sequence[Sequence[float]]]
) -> CellTest:
    """Permutation tests of the claim that `ours` end lower than every rival.

    Runs are permuted within a maze. If `ours` are lower than all rivals, p is the largest of the
    tests (intersection-union test). Otherwise one better rival refutes the claim: p is the smallest
    of the tests against rivals that are not higher, times the number of rivals (Bonferroni).

    Args:
        ours: the values of all runs, by maze.
        rivals: likewise, for each rival.
    """
    ps = [permutation_p(ours, other) for other in rivals]
    ahead = [
        float(np.mean([improvement(*maze) for maze in zip(ours, other, strict=True)])) > 0.5
        for other in rivals
    ]
    leasts = [
        least_p([(len(a), len(b)) for a, b in zip(ours, other, strict=True)]) for other in rivals
    ]
    least = min(1.0, max(leasts), len(rivals) * min(leasts))
    if all(ahead):
        return CellTest(max(ps), True, least)
    behind = min(p for p, before in zip(ps, ahead, strict=True) if not before)
    return CellTest(min(1.0, len(rivals) * behind), False, least)


# -- cells -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Group:
    """The runs of one setting in one cell.

    Attributes:
        cell: the setting.
        mazes: the runs in each maze; one maze, or several of one suite.
    """

    cell: Cell
    mazes: tuple[tuple[Ran, ...], ...]

    @property
    def runs(self) -> list[Ran]:
        """In all mazes."""
        return list(itertools.chain(*self.mazes))

    def values(self, claim: Any) -> list[list[float]]:
        """`value_of` its runs, by maze."""
        return [[value_of(run, claim) for run in maze] for maze in self.mazes]


@dataclass(frozen=True)
class Decision:
    """A cell of a claim, and its test.

    Attributes:
        groups: the runs that the claim is about, then those of every rival.
        test: of these.
        corrected: p corrected for the number of cells of the page (`correct`); nan before that,
            and if no result could have given a verdict.
        meets: the number of runs that meet a rule with a threshold.
        note: the reason if there is no test.
    """

    groups: tuple[Group, ...] = ()
    test: CellTest = CellTest()
    corrected: float = float("nan")
    meets: int | None = None
    note: str = ""

    @property
    def verdict(self) -> str:
        """`CONFIRMED`, `REFUTED` or `UNDECIDED`."""
        if not self.corrected < LEVEL:
            return UNDECIDED
        return CONFIRMED if self.test.supports else REFUTED


def correct(decisions: Sequence[Decision]) -> list[Decision]:
    """Correct the p of all cells of a page together (Holm, 1979).

    Cells whose smallest attainable p is `LEVEL` or more are not counted: no result could have given
    them a verdict, so they add no error.
    """
    able = [d.test.p if d.test.least < LEVEL else float("nan") for d in decisions]
    return [replace(d, corrected=p) for d, p in zip(decisions, holm(able), strict=True)]


def headline(verdicts: Sequence[str]) -> str:
    """The verdicts of a claim's cells: "confirmed", or "confirmed in 2 of 3 cells, ..."."""
    if len(set(verdicts)) == 1:
        number = len(verdicts)
        every = "both" if number == 2 else f"all {number}"
        return verdicts[0] + (f" in {every} cells" if number > 1 else "")
    count = Counter(verdicts)
    found = [(name, count[name]) for name in (CONFIRMED, REFUTED, UNDECIDED) if count[name]]
    first, *others = [f"{name} in {number}" for name, number in found]
    return ", ".join([f"{first} of {len(verdicts)} cells", *others])


def decide(claim: Any, runs: Sequence[Ran], least_frames: int) -> list[Decision]:
    """Test every cell of a claim; p is not corrected yet (`correct`).

    If a run lacks a value that the rule needs, there is one decision without a test and with a
    note.

    Args:
        claim: with a rule of `RULES`.
        runs: the complete runs of its study.
        least_frames: a cell with a run of fewer frames is not tested.
    """
    try:
        ours = groups_of(runs, claim.of)
        others = [groups_of(runs, table) for table in claim.than]
        for groups in others:
            check(
                len(groups) in (1, len(ours)),
                f"{len(ours)} cells are compared with {len(groups)}; give as many in than, or one",
            )
        # The first cell of ours is compared with the first of each of the others, and so on.
        return [
            _decide(claim, (own, *(groups[n % len(groups)] for groups in others)), least_frames)
            for n, own in enumerate(ours)
        ]
    except ValueError as error:
        return [Decision(note=str(error))]


def _decide(claim: Any, groups: tuple[Group, ...], least_frames: int) -> Decision:
    """The decision on one cell."""
    if not all(maze for group in groups for maze in group.mazes):
        return Decision(groups, note="no complete runs")
    fewest = min(run.row["frames"] for group in groups for run in group.runs)
    if fewest < least_frames:
        return Decision(groups, note=f"runs of {fewest:,} frames; {least_frames:,} are needed")
    if claim.rule in THRESHOLDS:
        meets = [THRESHOLDS[claim.rule](run, claim) for run in groups[0].runs]
        return Decision(groups, threshold_test(meets), meets=sum(meets))
    mazes = [[maze[0].row.get("maze") for maze in group.mazes] for group in groups]
    check(
        len(mazes[0]) == 1 == max(map(len, mazes)) or all(each == mazes[0] for each in mazes),
        f"runs in {mazes[0]} are compared with runs in {mazes[1:]}; compare the same mazes",
    )
    sign = 1.0 if claim.rule == "lower" else -1.0
    values = [[[sign * v for v in maze] for maze in group.values(claim)] for group in groups]
    return Decision(groups, comparison_test(values[0], values[1:]))


def cells_of(table: Cell) -> list[Cell]:
    """Every combination of the values of a table: {"maze": ["5x5", "7x7"]} are two cells."""
    lists = [value if isinstance(value, list) else [value] for value in table.values()]
    return [dict(zip(table, values, strict=True)) for values in itertools.product(*lists)]


def runs_of(runs: Sequence[Ran], cell: Cell) -> tuple[Ran, ...]:
    """The runs of a cell."""
    return tuple(
        run for run in runs if all(run.row.get(name) == value for name, value in cell.items())
    )


def groups_of(runs: Sequence[Ran], table: Cell) -> list[Group]:
    """The cells of a table with their runs.

    There is a cell for each combination of settings that the experiment varies and the table does
    not fix: {"algorithm": "ppo"} is a cell per maze size. Mazes of one suite are one cell.
    """
    cells: list[Cell] = []
    for cell in cells_of(table):
        labels = [run.label for run in runs_of(runs, cell)]
        names = dict.fromkeys(name for label in labels for name in label if name not in cell)
        open_ = [name for name in names if len({str(label.get(name)) for label in labels}) > 1]
        found = [{name: label.get(name) for name in open_} for label in labels]
        apart = {str(more): {**cell, **more} for more in found}
        cells += [apart[key] for key in sorted(apart)] or [cell]
    by_suite: dict[str, list[Cell]] = {}
    for cell in cells:
        by_suite.setdefault(str({**cell, "maze": _suite_of(cell)}), []).append(cell)
    return [
        Group(
            same[0] if len(same) == 1 else {**same[0], "maze": _suite_of(same[0])},
            tuple(runs_of(runs, cell) for cell in same),
        )
        for same in by_suite.values()
    ]


def _suite_of(cell: Cell) -> object:
    """The suite of a cell's maze, or the maze if it is not from a suite."""
    maze = cell.get("maze")
    return maze.partition("/")[0] if isinstance(maze, str) and is_suite(maze) else maze
