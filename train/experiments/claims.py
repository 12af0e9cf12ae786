"""The tests that decide claims from rows of runs: one for each cell, corrected over all cells.

A cell is one task in one size. Its verdict is that of a test whose p, corrected for the number of
cells (Holm), is below `LEVEL`; otherwise it is undecided. There is no verdict over several cells.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import NamedTuple

from scipy.stats import binomtest

from pursuit.mazes.suite_files import is_suite
from pursuit.validation import check
from train.experiments.rows import longer_is_better
from train.experiments.statistics import LEVEL, NAN, holm, improvement, least_p, permutation_p
from train.experiments.study import COMPARED_TO, Claim, Table
from train.reports.tables import Row

CONFIRMED, REFUTED, UNDECIDED = "confirmed", "refuted", "undecided"
FALL = 0.01
"""Episode lengths fall if they decrease by more than this share of the time limit."""


# -- values of runs --------------------------------------------------------------------------------


def number(row: Row, column: str) -> float:
    """A value of a row; ValueError if this run has none."""
    value = row.get(column)
    check(
        value is not None,
        f"run {row.get('run')}: {column} is not known in this task, but the rule of a claim needs "
        "it; use another rule",
    )
    return float(value)  # type: ignore[arg-type]


def distance(row: Row) -> float:
    """The absolute gap to the optimum in per cent; NashConv for self-play."""
    gap = row.get("optimality_gap")
    return 100.0 * abs(gap) if gap is not None else number(row, "nash_conv")


def diverged(row: Row) -> bool:
    """Whether most starts are unsolved, and episode lengths do not fall in the last third.

    They fall if "last_fall" is more than `FALL` of the time limit.
    """
    fall = row.get("last_fall")
    unsolved = number(row, "unsolved_share") > 0.5
    return unsolved and (fall is None or fall <= FALL * number(row, "max_steps"))


def worse_by(row: Row, to: str) -> float:
    """By how many per cent a run is worse than a reference; negative if it is better.

    Evaders maximise episode length, so shorter episodes are worse.
    """
    steps, reference = number(row, "mean_steps"), number(row, COMPARED_TO[to])
    sign = -1.0 if longer_is_better(row) else 1.0
    return 100.0 * sign * (steps - reference) / reference


def part_of(row: Row, part: str) -> float:
    """The share of one part (`PARTS`) in the gap of a run, in per cent.

    "objective" is the objective gap, "loops" the gap added by unsolved starts, "learning" the rest.
    0 if there is no gap.
    """
    gap, solved = number(row, "optimality_gap"), number(row, "solved_gap")
    floor = number(row, "objective_gap")
    parts = {"objective": floor, "loops": gap - solved, "learning": solved - floor}
    return 100.0 * parts[part] / gap if gap > 0.0 else 0.0


RUN_RULES: dict[str, Callable[[Row, Claim], bool]] = {
    "diverges": lambda row, claim: diverged(row),
    "learns": lambda row, claim: not diverged(row),
    "within": lambda row, claim: worse_by(row, claim.to) <= claim.percent + 1e-9,
    "beyond": lambda row, claim: worse_by(row, claim.to) > claim.percent + 1e-9,
    "part_above": lambda row, claim: part_of(row, claim.part) >= claim.percent,
    "part_below": lambda row, claim: part_of(row, claim.part) < claim.percent,
}
"""Rules that compare each run with a threshold: whether a run meets the rule."""


def value_of(row: Row, claim: Claim) -> float:
    """The value of a run that a claim is about, in per cent; NashConv for self-play."""
    if claim.rule in ("diverges", "learns"):
        return 100.0 * number(row, "unsolved_share")
    if claim.rule in ("part_above", "part_below"):
        return part_of(row, claim.part)
    return worse_by(row, claim.to) if claim.rule in ("within", "beyond") else distance(row)


# -- tests -----------------------------------------------------------------------------------------


class CellTest(NamedTuple):
    """A test of one cell: its two-sided p (nan if nothing was tested), whether the direction is
    that of the claim, and the smallest p that is possible with so many runs."""

    p: float = NAN
    supports: bool = False
    least: float = 1.0


UNTESTED = CellTest()


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
        fmean(float(improvement(*maze)) for maze in zip(ours, other, strict=True)) > 0.5
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


class Group(NamedTuple):
    """The runs of one setting in one cell: the setting, and the rows of runs in each maze (one, or
    several of one suite)."""

    cell: Table
    mazes: tuple[tuple[Row, ...], ...]

    def values(self, claim: Claim) -> list[list[float]]:
        """`value_of` its runs, by maze."""
        return [[value_of(row, claim) for row in maze] for maze in self.mazes]


@dataclass(frozen=True)
class Decision:
    """A cell of a claim, and its test.

    Attributes:
        groups: the runs that the claim is about, then those of every rival.
        test: of these.
        corrected: p corrected for the number of cells of the page (`corrected`); nan before that,
            and if no result could have given a verdict.
        meets: the number of runs that meet a rule with a threshold.
        note: the reason if there is no test.
    """

    groups: tuple[Group, ...] = ()
    test: CellTest = UNTESTED
    corrected: float = NAN
    meets: int | None = None
    note: str = ""

    @property
    def verdict(self) -> str:
        """`CONFIRMED`, `REFUTED` or `UNDECIDED`."""
        if not self.corrected < LEVEL:
            return UNDECIDED
        return CONFIRMED if self.test.supports else REFUTED


def corrected(decisions: Sequence[Decision]) -> list[Decision]:
    """Correct the p of all cells of a page together (Holm, 1979).

    Cells whose smallest attainable p is `LEVEL` or more are not counted: no result could have given
    them a verdict, so they add no error.
    """
    able = [d.test.p if d.test.least < LEVEL else NAN for d in decisions]
    return [replace(d, corrected=p) for d, p in zip(decisions, holm(able), strict=True)]


def decide(
    claim: Claim, rows: Sequence[Row], varying: Sequence[str], least_frames: int
) -> list[Decision]:
    """Test every cell of a claim; p is not corrected yet (`corrected`).

    If a run lacks a value that the rule needs, there is one decision without a test and with a
    note.

    Args:
        claim: with a rule that needs runs.
        rows: the complete runs of its study.
        varying: the settings that differ in it.
        least_frames: a cell with a run of fewer frames is not tested.
    """
    try:
        ours = groups_of(rows, varying, claim.of)
        others = [groups_of(rows, varying, table) for table in claim.than]
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


def _decide(claim: Claim, groups: tuple[Group, ...], least_frames: int) -> Decision:
    """The decision on one cell."""
    if not all(maze for group in groups for maze in group.mazes):
        return Decision(groups, note="no complete runs")
    fewest = min(row["frames"] for group in groups for maze in group.mazes for row in maze)
    if fewest < least_frames:
        return Decision(groups, note=f"runs of {fewest:,} frames; {least_frames:,} are needed")
    if claim.rule in RUN_RULES:
        meets = [RUN_RULES[claim.rule](row, claim) for maze in groups[0].mazes for row in maze]
        return Decision(groups, threshold_test(meets), meets=sum(meets))
    mazes = [[maze[0].get("maze") for maze in group.mazes] for group in groups]
    check(
        len(mazes[0]) == 1 == max(map(len, mazes)) or all(each == mazes[0] for each in mazes),
        f"runs in {mazes[0]} are compared with runs in {mazes[1:]}; compare the same mazes",
    )
    sign = 1.0 if claim.rule == "lower" else -1.0
    values = [[[sign * v for v in maze] for maze in group.values(claim)] for group in groups]
    return Decision(groups, comparison_test(values[0], values[1:]))


def cells_of_table(table: Table) -> list[Table]:
    """Every combination of the values of a table: {"maze": ["5x5", "7x7"]} are two cells."""
    lists = [value if isinstance(value, list) else [value] for value in table.values()]
    return [dict(zip(table, values, strict=True)) for values in itertools.product(*lists)]


def in_cell(rows: Sequence[Row], cell: Table) -> tuple[Row, ...]:
    """The rows of a cell."""
    return tuple(row for row in rows if all(row.get(name) == value for name, value in cell.items()))


def groups_of(rows: Sequence[Row], varying: Sequence[str], table: Table) -> list[Group]:
    """The cells of a table with their runs.

    There is a cell for each combination of settings that the study varies and the table does not
    fix: {"algorithm": "ppo"} is a cell per maze size. Mazes of one suite are one cell.
    """
    cells: list[Table] = []
    for cell in cells_of_table(table):
        own = in_cell(rows, cell)
        names = [name for name in varying if name not in cell]
        apart = [name for name in names if len({str(row.get(name)) for row in own}) > 1]
        more = {str(m): m for m in ({name: row.get(name) for name in apart} for row in own)}
        cells += [{**cell, **more[key]} for key in sorted(more)] or [cell]
    by_suite: dict[str, list[Table]] = {}
    for cell in cells:
        by_suite.setdefault(str({**cell, "maze": _suite_of(cell)}), []).append(cell)
    return [
        Group(
            same[0] if len(same) == 1 else {**same[0], "maze": _suite_of(same[0])},
            tuple(in_cell(rows, cell) for cell in same),
        )
        for same in by_suite.values()
    ]


def _suite_of(cell: Table) -> object:
    """The suite of a cell's maze, or the maze if it is not from a suite."""
    maze = cell.get("maze")
    return maze.partition("/")[0] if isinstance(maze, str) and is_suite(maze) else maze


# -- rows ------------------------------------------------------------------------------------------


def cell_row(cell: Decision) -> Row:
    """The test and the verdict of a cell."""
    sizes = [str(sum(map(len, group.mazes))) for group in cell.groups]
    return {
        "cell": cell_in_words(cell.groups[0].cell) if cell.groups else "",
        "supports": "" if cell.test.p != cell.test.p else cell.test.supports,
        "p": _known(cell.test.p),
        "p_holm": _known(cell.corrected),
        "least_p": _known(cell.test.least),
        "runs": " against ".join(sizes),
        "verdict": cell.verdict,
        "note": cell.note,
    }


def _known(value: float) -> object:
    return "" if value != value else value


def cell_in_words(cell: Table) -> str:
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
