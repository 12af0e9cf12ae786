"""Runs a comparison: the search, the choice of settings, the comparison itself."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from train.experiments.comparison.plan import Race, Table
from train.experiments.executors import run_locally
from train.experiments.search import best_of, log_gap
from train.experiments.study import OUTCOME, Call, Study, Told, folder_of
from train.files import only_one, read_json, write_json
from train.schemas import read_as
from train.settings.checks import check

TRIALS, FINALS = "trials", "finals"
"""Folders of the studies: the search, and the comparison."""
RACE = "race.json"
ANEW = "remove that folder; the next `pursuit race` does that run again"
WAYS_AND_SHARES = ("greedy", "greedy_success", "sampled", "sampled_success")

Watched = Callable[[Study], Told]
"""Makes what is told how far a study is."""

Key = TypeVar("Key", bound=Hashable)


class Result(msgspec.Struct):
    """What a run left behind; see `library_run.learn`."""

    points: list[dict[str, float]]
    optimal_steps: float
    settings: Table
    library: str
    processor: str
    torch: str
    commit: str | None = None

    def __post_init__(self) -> None:
        check(bool(self.points), "points is an empty list")
        wanted = {"seconds", "wall_seconds", "cpu_seconds", "frames", *WAYS_AND_SHARES}
        check(all(wanted <= set(point) for point in self.points), f"points have {sorted(wanted)}")

    @property
    def score(self) -> float:
        """What settings are chosen by: the last gap, the better of the two ways to play."""
        last = self.points[-1]
        return log_gap(min(last["greedy"], last["sampled"]))


@dataclass
class Standing:
    """What came of a comparison.

    Attributes:
        scores: of every trial by task, contestant and number: its values on the held-out mazes,
            None where it failed there.
        chosen: the number of the best trial by task and contestant.
        finals: the results by task, contestant and seed; None where a run failed.
    """

    scores: dict[tuple[str, str, int], list[float | None]] = field(default_factory=dict)
    chosen: dict[tuple[str, str], int] = field(default_factory=dict)
    finals: dict[tuple[str, str, int], Result | None] = field(default_factory=dict)


def run_race(race: Race, out: Path, watched: Watched, workers: int = 1) -> Standing:
    """Do all runs that have not been done, and say how they went.

    Args:
        race: what is to be done.
        out: the folder of the comparison.
        watched: makes the watch of a study.
        workers: processes at a time, each on a core of its own; 0 does all in this process.

    Raises:
        ValueError: the folder is something else, a result is damaged, or all of a contestant's
            trials failed.
        KeyboardInterrupt: what is done is kept; runs that were going on begin again the next time.
    """
    check(not out.is_file(), f"{out}: a file; give a folder")
    check(workers >= 0, f"workers={workers}; at least 0")

    def do(what: str, jobs: Mapping[Key, Call], folder: str) -> dict[Key, Result | None]:
        runs = tuple(jobs.values())
        study = Study(f"{race.title}: {what}", runs, pinned=True)
        run_locally(study, out / folder, workers, watched(study))
        return {key: result_of(folder_of(out / folder, job.name)) for key, job in jobs.items()}

    standing = Standing()
    with only_one(out, "race"):
        write_json(out / RACE, msgspec.to_builtins(race))
        searched = do("search", race.trial_jobs(), TRIALS)
        for (task, name, number, _), result in searched.items():
            scores = standing.scores.setdefault((task, name, number), [])
            scores.append(None if result is None else result.score)
        for on, name in product(race.tasks, race.contestants):
            best = best_of({n: standing.scores[on.name, name, n] for n in range(len(race.trials))})
            check(
                best is not None,
                f"{name} failed in every trial on {on.name!r}; see the error.txt files in "
                f"{out / TRIALS}",
            )
            standing.chosen[on.name, name] = best  # type: ignore[assignment]
        standing.finals = do("comparison", race.final_jobs(standing.chosen), FINALS)
    return standing


def is_folder_of(race: Race, out: Path) -> bool:
    """Whether `out` was begun for this comparison, or for one of the same title."""
    path = out / RACE
    kept: Any = read_json(path) if path.exists() else None
    return isinstance(kept, dict) and kept.get("title") == race.title


def result_of(folder: Path) -> Result | None:
    """What a run left behind; None where it failed.

    Raises:
        ValueError: its file is damaged.
    """
    path = folder / OUTCOME
    return read_as(Result, read_json(path), path, ANEW) if path.exists() else None
