"""Do different lessons leave different errors? Chasers of equal gap, compared state by state.

    python -m train.recipes.equal_gap --maze 5x5 --out equal_gap

Chasers learn by other curricula, each until its exact gap first falls under one threshold. Then the
maps of what they lose are laid beside each other: how alike are runs of one lesson, and how alike
those of two?
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import permutation_test, spearmanr

from pursuit.policy import Policy
from scripted_agents import (
    action_values,
    best_response,
    duel_regret,
    evaluate_exactly,
    mean_over_starts,
)
from train.commands.parse import fail, parse
from train.evaluation.contest import GameContest
from train.evaluation.games import table_in
from train.experiments.kinds import start
from train.files import write_csv, write_text
from train.result_table import Column, ResultTable, words
from train.runs.by_name import settings_of
from train.runs.folder import RUN, check_new
from train.runs.loop import Run
from train.settings.checks import check

LESSONS: dict[str, dict[str, Any]] = {
    "none": {"curriculum": "none"},
    "near first": {"curriculum": "start-distance"},
    "annealed": {"curriculum": "opponent-epsilon"},
}
"""The arms: the task itself; starts close together first; an evader that moves at random first."""
RESAMPLES = 9999
"""Permutations of the labels, drawn at random."""


@dataclass(frozen=True)
class Recipe:
    """Train chasers by other lessons to an equal gap, and compare what they lose where."""

    maze: str = "5x5"
    """A shipped maze, or the path of a maze file."""
    seeds: int = 4
    """Runs of each lesson; no two runs of all share a seed, and so the first weights."""
    first_seed: int = 0
    """Of the first run; the others follow."""
    threshold: float = 0.05
    """The exact gap of the sampled policy, as a share of the optimum, at which a run ends."""
    frames: int = 600_000
    """Frames at most; lessons last for the first half of them."""
    out: Path = Path("equal_gap")
    """A new folder for the runs, runs.csv, pairs.csv and report.md."""

    def __post_init__(self) -> None:
        check(self.seeds >= 2, f"seeds={self.seeds}; at least 2, or no two runs share a lesson")
        check(self.threshold > 0.0, f"threshold={self.threshold}; it is above 0")
        check(self.frames >= 1, f"frames={self.frames}; at least 1")


@dataclass(frozen=True, eq=False)
class Errors:
    """A run that has ended, and what its policy loses where.

    Attributes:
        lesson, seed, frames: of the run.
        gap: exact, of the sampled policy, as a share of the optimum.
        loss: [starts] float64, by how many steps its action is worse than the best on average, in
            every pair of distinct cells: uniform over starts.
        visited: [starts] float64, the same times how often an optimal chaser is there.
    """

    lesson: str
    seed: int
    frames: int
    gap: float
    loss: NDArray[np.float64]
    visited: NDArray[np.float64]


def exact_gap(contest: GameContest, policy: Policy, optimum: float) -> float:
    """What the policy needs above the optimum, exactly, as a share of it."""
    task, maze = contest.task, contest.task.mazes[0]
    tables = table_in(task, policy), contest.opponent_table()
    order: Any = task.move_order
    values = evaluate_exactly(maze, *tables, task.max_steps, 1.0, order)
    return mean_over_starts(values, maze, task.min_start_distance) / optimum - 1.0


def errors_of(contest: GameContest, policy: Policy) -> tuple[NDArray[np.float64], ...]:
    """`Errors.loss` and `Errors.visited` of a chaser's policy."""
    task, maze = contest.task, contest.task.mazes[0]
    order: Any = task.move_order
    rest = (task.max_steps, task.stay_action, order)
    table, other = table_in(task, policy), contest.opponent_table()
    worth = action_values("chaser", maze, other, *rest)
    loss = ((worth.steps - worth.values[:, :, None]) * table).sum(axis=2)
    best = best_response("chaser", maze, other, task.max_steps, 1.0, *rest[1:]).policy
    visits = duel_regret("chaser", maze, best, other, task.max_steps, order).visits
    starts = ~np.eye(maze.num_cells, dtype=bool)
    return loss[starts], (loss * visits)[starts]


def learn(recipe: Recipe, lesson: str, seed: int) -> Errors:
    """Train a chaser until its gap is small enough, or its frames are spent."""
    flat = {"task": "chase", "role": "chaser", "maze": recipe.maze, "evaluate": "sampled"}
    rest: dict[str, Any] = {"frames": recipe.frames, "seed": seed, "threads": 1}
    settings = settings_of(**flat, **rest, **LESSONS[lesson])
    run = start(RUN, settings, recipe.out / f"{lesson.replace(' ', '-')}-seed{seed}")
    contest, policy = run.trainee.contest, run.trainee.learner.policy(greedy=False)
    optimum = run.trainee.optimum.mean_steps
    gaps: list[float] = []

    def look(run: Run, row: dict[str, float]) -> None:
        """After every rollout: is it good enough?"""
        if not row:
            gaps.append(exact_gap(contest, policy, optimum))
            run.stopped = run.stopped or gaps[-1] <= recipe.threshold

    run.train(look)
    run.lock.release()
    return Errors(lesson, seed, run.trainee.frames, gaps[-1], *errors_of(contest, policy))


def alike(maps: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """[runs, runs] float64: Spearman's correlation of every two maps, over their states."""
    count = len(maps)
    found = np.ones((count, count))
    for one in range(count):
        for two in range(one):
            found[one, two] = found[two, one] = spearmanr(maps[one], maps[two]).statistic
    return found


def within_less_between(labels: Any, correlations: NDArray[np.float64]) -> float:
    """The mean correlation of runs of one lesson, less that of runs of two."""
    one, two = np.triu_indices(len(labels), 1)
    same = np.asarray(labels)[one] == np.asarray(labels)[two]
    values = correlations[one, two]
    return float(values[same].mean() - values[~same].mean())


def by_permutation(labels: Sequence[int], correlations: NDArray[np.float64]) -> tuple[float, float]:
    """`within_less_between`, and how often it is as large where labels are dealt out at random.

    A permutation test, one-sided: are runs of one lesson more alike than runs of two?
    """
    statistic = partial(within_less_between, correlations=correlations)
    seed: Any = {"random_state": np.random.default_rng(0)}  # called rng from SciPy 1.15 on
    found = permutation_test(
        (np.asarray(labels),), statistic, permutation_type="pairings", vectorized=False,
        n_resamples=RESAMPLES, alternative="greater", **seed,
    )  # fmt: skip
    return float(found.statistic), float(found.pvalue)


def report(runs: Sequence[Errors], out: Path) -> list[str]:
    """Write the tables; the lines that say what came out."""
    rows = [{"lesson": r.lesson, "seed": r.seed, "frames": r.frames, "gap": r.gap} for r in runs]
    columns = [
        words("lesson"),
        Column("seed", lambda row: str(row["seed"])),
        Column("frames", lambda row: f"{row['frames']:,}"),
        Column("gap", lambda row: f"{100 * row['gap']:.2f} %"),
    ]
    table = ResultTable(rows, columns)
    write_csv(out / "runs.csv", rows)
    lessons = list(dict.fromkeys(run.lesson for run in runs))
    labels = [lessons.index(run.lesson) for run in runs]
    maps = {"uniform over starts": [run.loss for run in runs]}
    maps["by visits of an optimal chaser"] = [run.visited for run in runs]
    lines = [table.markdown(), ""]
    pairs: list[dict[str, Any]] = []
    for name, each in maps.items():
        found = alike(each)
        difference, p = by_permutation(labels, found)
        lines.append(f"{name}: within less between lessons {difference:+.4f}, p = {p:.4f}")
        grid = []
        for i, one in enumerate(lessons):
            row: dict[str, Any] = {"lesson": one}
            for k, two in enumerate(lessons):
                cells = found[np.ix_(np.equal(labels, i), np.equal(labels, k))]
                others = cells[~np.eye(len(cells), dtype=bool)] if i == k else cells
                row[two] = float(others.mean())
            grid.append(row)
        heads = [Column(two, lambda row, two=two: f"{row[two]:.3f}") for two in lessons]  # type: ignore[misc]
        lines += ["", ResultTable(grid, [words("lesson"), *heads]).markdown(), ""]
        for i, k in combinations(range(len(runs)), 2):
            pair = {"map": name, "one": f"{runs[i].lesson} {runs[i].seed}"}
            pair |= {"two": f"{runs[k].lesson} {runs[k].seed}"}
            pairs.append(pair | {"spearman": float(found[i, k])})
    write_csv(out / "pairs.csv", pairs)
    write_text(out / "report.md", "# Errors at an equal gap\n\n" + "\n".join(lines))
    return lines


def run(recipe: Recipe) -> None:
    """Train all, and compare."""
    check_new(recipe.out)
    recipe.out.mkdir(parents=True, exist_ok=True)
    found: list[Errors] = []
    for lesson in LESSONS:
        for _ in range(recipe.seeds):
            began = perf_counter()
            found.append(learn(recipe, lesson, recipe.first_seed + len(found)))
            last, spent = found[-1], perf_counter() - began
            gap = f"{100 * last.gap:.2f} %"
            print(f"{lesson}, seed {last.seed}: {last.frames:,} frames, gap {gap}, {spent:.0f} s")
    print("\n".join(["", *report(found, recipe.out)]))


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line; errors are one line and exit status 2."""
    try:
        run(parse(Recipe, sys.argv[1:] if arguments is None else arguments, "recipe"))
    except (ValueError, OSError, ImportError) as error:
        fail(str(error))


if __name__ == "__main__":
    main()
