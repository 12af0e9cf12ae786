"""Execution of a comparison: the search, the choice of settings, the final runs."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from train.experiments.comparison.plan import Comparison, Table
from train.experiments.executors import run_locally
from train.experiments.search import best_of, log_gap
from train.experiments.study import OUTCOME, Call, Study, Watch, folder_of
from train.files import only_one, read_json, write_json
from train.schemas import read_as
from train.settings.checks import check

TRIALS, FINALS = "trials", "finals"
"""Folders of the search and of the final runs."""
COMPARISON = "comparison.json"
ANEW = "remove that folder; the next `pursuit compare` repeats that run"
WAYS_AND_SHARES = ("greedy", "greedy_success", "sampled", "sampled_success")

Watched = Callable[[Study], Watch]
"""Makes the progress callback of a study."""

Key = TypeVar("Key", bound=Hashable)


class Result(msgspec.Struct):
    """The result of a run; see `library_run.learn`."""

    points: list[dict[str, float]]
    optimal_steps: float
    settings: Table
    library: str
    processor: str
    torch: str
    commit: str | None = None

    def __post_init__(self) -> None:
        check(bool(self.points), "points is an empty list")
        wanted = {"seconds", "wall_seconds", "processor_seconds", "frames", *WAYS_AND_SHARES}
        check(all(wanted <= set(point) for point in self.points), f"points need {sorted(wanted)}")

    @property
    def score(self) -> float:
        """The score that selects settings: log of the last gap, greedy or sampled (the better)."""
        last = self.points[-1]
        return log_gap(min(last["greedy"], last["sampled"]))


@dataclass
class Outcome:
    """The results of a comparison.

    Attributes:
        scores: by task, contestant and number of the trial: its scores on the held-out mazes; None
            for a failed run.
        chosen: the number of the best trial by task and contestant.
        finals: the results by task, contestant and seed; None for a failed run.
    """

    scores: dict[tuple[str, str, int], list[float | None]] = field(default_factory=dict)
    chosen: dict[tuple[str, str], int] = field(default_factory=dict)
    finals: dict[tuple[str, str, int], Result | None] = field(default_factory=dict)


def run_comparison(plan: Comparison, out: Path, watched: Watched, workers: int = 1) -> Outcome:
    """Execute all runs that are not complete, and return all results.

    Args:
        plan: the comparison.
        out: its folder.
        watched: makes the progress callback of a study.
        workers: parallel processes, one core each; 0 runs everything in this process.

    Raises:
        ValueError: the folder is used by something else, a result is damaged, or all trials of a
            contestant failed.
        KeyboardInterrupt: completed runs are kept; unfinished runs restart the next time.
    """
    check(not out.is_file(), f"{out}: a file; give a folder")
    check(workers >= 0, f"workers={workers}; give at least 0")

    def do(what: str, jobs: Mapping[Key, Call], folder: str) -> dict[Key, Result | None]:
        runs = tuple(jobs.values())
        study = Study(f"{plan.title}: {what}", runs, pinned=True)
        run_locally(study, out / folder, workers, watched(study))
        return {key: result_of(folder_of(out / folder, job.name)) for key, job in jobs.items()}

    outcome = Outcome()
    with only_one(out, "comparison"):
        write_json(out / COMPARISON, msgspec.to_builtins(plan))
        searched = do("search", plan.trial_jobs(), TRIALS)
        for (task, name, number, _), result in searched.items():
            scores = outcome.scores.setdefault((task, name, number), [])
            scores.append(None if result is None else result.score)
        for on, name in product(plan.tasks, plan.contestants):
            best = best_of({n: outcome.scores[on.name, name, n] for n in range(len(plan.trials))})
            check(
                best is not None,
                f"{name} failed in every trial on {on.name!r}; see the error.txt files in "
                f"{out / TRIALS}",
            )
            outcome.chosen[on.name, name] = best  # type: ignore[assignment]
        outcome.finals = do("comparison", plan.final_jobs(outcome.chosen), FINALS)
    return outcome


def is_folder_of(plan: Comparison, out: Path) -> bool:
    """Whether `out` is the folder of this comparison, or of one with the same title."""
    path = out / COMPARISON
    kept: Any = read_json(path) if path.exists() else None
    return isinstance(kept, dict) and kept.get("title") == plan.title


def result_of(folder: Path) -> Result | None:
    """The result of a run; None if it failed.

    Raises:
        ValueError: its file is damaged.
    """
    path = folder / OUTCOME
    return read_as(Result, read_json(path), path, ANEW) if path.exists() else None
