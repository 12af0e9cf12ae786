"""Reports on several mazes: by maze, by kind of maze, and generalisation to unseen mazes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.mazes.suite_files import suite_names, suite_rows
from train.evaluation.suite_contest import InMazes, SuiteContest
from train.files import Plain
from train.reports.tables import ResultTable, numeric, words

SOLVED = 1.0 - 1e-9
"""Success rate from which a maze counts as solved from all starts."""


def measures_of(maze: Maze) -> Plain:
    """The properties of a maze: kind (in a suite), size and path lengths."""
    suite, _, number = maze.name.partition("/")
    of_suite = suite in suite_names() and number.isdigit()
    kind = suite_rows(maze.name)[0].kind if of_suite else ""
    known: Plain = {"kind": kind, "cells": maze.num_cells, "loops": maze.num_loops}
    if maze.num_cells <= MAX_TABLE_CELLS:
        known["longest_path"] = maze.longest_distance
        known["mean_path"] = float(maze.distances[maze.distances > 0].mean())
    return known


def gaps_of(found: InMazes, best: InMazes) -> NDArray[np.float64]:
    """[mazes] steps / optimum of that maze - 1."""
    return found.steps / best.steps - 1.0


def maze_rows(contest: SuiteContest, policies: Sequence[InMazes]) -> list[Plain]:
    """A row for each of the mazes `played`: properties of the maze, and steps, success, gap and the
    measure of each policy.

    Args:
        contest: the evaluation.
        policies: their results; the names of columns start with the names of policies.
    """
    rows = []
    for number, maze in enumerate(contest.part.mazes):
        row = {"maze": maze.name, **measures_of(maze)}
        if contest.best is not None:
            row["optimal_steps"] = float(contest.best.steps[number])
        for found in policies:
            name = found.name.replace(", ", " ").replace(" ", "_")
            row[f"{name}_steps"] = float(found.steps[number])
            row[f"{name}_success"] = float(found.success[number])
            measured = found.values(contest.measure)
            if not contest.measure.by_steps and measured is not None:
                row[f"{name}_{contest.measure.name}"] = float(measured[number])
            if contest.best is not None:
                row[f"{name}_gap"] = float(gaps_of(found, contest.best)[number])
        rows.append(row)
    return rows


def summary_of(contest: SuiteContest, found: InMazes) -> Plain:
    """The figures of a policy over all mazes, as plain values.

    "optimality_gap" is that of the mean steps, "mean_gap" the mean of the gaps of the mazes, and
    "solved_mazes" the share of mazes solved from all starts.
    """
    summary: Plain = {
        **{name: contest.describe()[name] for name in ("task", "maze")},
        "mazes": len(contest.played),
        "exact": found.exact,
        "mean_steps": float(found.steps.mean()),
        "success_rate": float(found.success.mean()),
        "solved_mazes": float((found.success >= SOLVED).mean()),
    }
    measured = found.values(contest.measure)
    if not contest.measure.by_steps and measured is not None:
        summary[contest.measure.column] = float(measured.mean())
    if contest.best is not None:
        gaps = gaps_of(found, contest.best)
        summary |= {
            "optimal_steps": float(contest.best.steps.mean()),
            "optimality_gap": float(found.steps.mean() / contest.best.steps.mean() - 1.0),
            "mean_gap": float(gaps.mean()),
            "worst_gap": float(gaps.max() if contest.measure.less_is_better else gaps.min()),
        }
    return summary


def generalisation(seen: Plain, unseen: Plain) -> Plain:
    """The generalisation gap from training mazes to others; arguments as from `summary_of`."""
    lost = {"success_rate": seen["success_rate"] - unseen["success_rate"]}
    if "optimality_gap" in seen and "optimality_gap" in unseen:
        lost["optimality_gap"] = unseen["optimality_gap"] - seen["optimality_gap"]
    return {"seen": seen, "unseen": unseen, "lost": lost}


def kind_table(rows: Sequence[Plain]) -> ResultTable:
    """Means over the mazes of each kind."""
    kinds: dict[str, list[Plain]] = {}
    for row in rows:
        kinds.setdefault(row["kind"], []).append(row)
    found = []
    for kind, mazes in kinds.items():
        numbers = [key for key in mazes[0] if key not in ("maze", "kind")]
        means = {key: float(np.mean([row[key] for row in mazes])) for key in numbers}
        found.append({"kind": kind, "mazes": len(mazes), **means})
    columns = [
        words("kind"),
        numeric("mazes", "mazes"),
        numeric("loops", "loops", ".1f"),
        numeric("optimum", "optimal_steps", ".2f"),
        numeric("steps", "learned_steps", ".2f"),
        numeric("success", "learned_success", ".2f", 100, " %"),
        numeric("gap", "learned_gap", "+.2f", 100, " %"),
    ]
    return ResultTable(found, columns)
