"""Does a race: the search, the choice of settings, the race; what is done is not done again."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from train.files import only_one, read_json, write_json
from train.race.bout import Bout, error_of, perform, perform_alone, plain_bout
from train.race.plan import Race, Table, bout_name, score_of
from train.schemas import read_as
from train.settings.checks import check

TRIALS, FINALS = "trials", "finals"
"""Folders of the two kinds of bouts."""
RACE = "race.json"
ANEW = "remove that file; the next `pursuit race` does that bout again"

WAYS_AND_SHARES = ("greedy", "greedy_success", "sampled", "sampled_success")

Told = Callable[[str], None]
"""Called with a line whenever a bout begins or ends."""


class Result(msgspec.Struct):
    """What a bout left behind; see `bout.learn`."""

    bout: Table
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


Scores = dict[tuple[str, str, int], list[float | None]]
"""By task, contestant and number of the trial; see `Standing`."""


@dataclass
class Standing:
    """How far a race is.

    Attributes:
        scores: of every trial by task, contestant and number: its values on the held-out mazes
            that it was run on, None where it failed there.
        chosen: the number of the best trial by task and contestant.
        finals: the results of the race by task, contestant and seed; None where a bout failed.
    """

    scores: Scores = field(default_factory=dict)
    chosen: dict[tuple[str, str], int] = field(default_factory=dict)
    finals: dict[tuple[str, str, int], Result | None] = field(default_factory=dict)


def run_race(race: Race, out: Path, told: Told, workers: int = 1) -> Standing:
    """Do all bouts that have not been done, and say how they went.

    Args:
        race: what is to be done.
        out: the folder of the race.
        told: hears of it.
        workers: bouts at a time, each in a process and on a core of its own; 0 does them one after
            the other in this process.

    Raises:
        ValueError: somebody else works on the folder, or every trial of a contestant failed.
        KeyboardInterrupt: bouts that were under way are lost, and done anew the next time.
    """
    check(not out.is_file(), f"{out}: a file; give a folder")
    with only_one(out, "race"):
        write_json(out / RACE, plain_race(race))
        first = race.trial_bouts()
        do_all((bout for *_, bout in first), out / TRIALS, told, workers, "search")
        more = list(race.trial_bouts(finalists_of(race, scores_of(race, out))))
        if more:
            do_all((bout for *_, bout in more), out / TRIALS, told, workers, "search, finalists")
        choice = {key: race.trials[n] for key, n in standing_of(race, out, False).chosen.items()}
        finals = list(race.final_bouts(choice))
        do_all((bout for *_, bout in finals), out / FINALS, told, workers, "race")
    return standing_of(race, out)


def is_folder_of(race: Race, out: Path) -> bool:
    """Whether `out` was begun for this race, or for one of the same title."""
    path = out / RACE
    kept = read_json(path) if path.exists() else None
    return isinstance(kept, dict) and kept.get("title") == race.title


def plain_race(race: Race) -> Table:
    """What a race is, for whoever opens its folder."""
    plain: Table = msgspec.to_builtins(race)
    return plain


def standing_of(race: Race, out: Path, raced: bool = True) -> Standing:
    """What is in the folder of a race, whose search is over.

    Args:
        race: whose folder it is.
        out: the folder.
        raced: read the bouts of the race as well.

    Raises:
        ValueError: bouts are missing, damaged, or all of a contestant's trials failed.
    """
    standing = Standing(scores_of(race, out))
    kept = finalists_of(race, standing.scores)
    for task, name, number, bout in race.trial_bouts(kept):
        standing.scores[task, name, number].append(score_in(out, bout))
    for key, numbers in kept.items():
        means = {
            number: sum(each) / len(each)  # type: ignore[arg-type]
            for number in sorted(numbers)
            if None not in (each := standing.scores[*key, number])
        }
        where = f"in every trial on {key[0]!r}"
        if numbers:
            where = f"on further held-out mazes of {key[0]!r} with every finalist"
        check(bool(means), f"{key[1]} failed {where}; see the .error.txt files in {out / TRIALS}")
        standing.chosen[key] = min(means, key=lambda number: means[number])
    if raced:
        choice = {key: race.trials[number] for key, number in standing.chosen.items()}
        for task, name, seed, bout in race.final_bouts(choice):
            standing.finals[task, name, seed] = result_of(bout, out / FINALS)
    return standing


def scores_of(race: Race, out: Path) -> Scores:
    """Of every trial on the first held-out maze of its task.

    Raises:
        ValueError: as `standing_of`.
    """
    return {
        (task, name, number): [score_in(out, bout)]
        for task, name, number, bout in race.trial_bouts()
    }


def score_in(out: Path, bout: Bout) -> float | None:
    """Of a bout of the search; None where it failed."""
    found = result_of(bout, out / TRIALS)
    return None if found is None else score_of(found.points)


def finalists_of(race: Race, scores: Scores) -> dict[tuple[str, str], set[int]]:
    """The numbers of the best trials on the first held-out maze, by task and contestant."""
    kept = {}
    for on in race.tasks:
        for name in race.contestants:
            found = [(scores[on.name, name, n][0], n) for n in range(len(race.trials))]
            best = sorted((score, number) for score, number in found if score is not None)
            kept[on.name, name] = {number for _, number in best[: race.finalists]}
    return kept


def result_of(bout: Bout, folder: Path) -> Result | None:
    """What a bout left behind; None where it failed.

    Raises:
        ValueError: it was not done, or its file is damaged.
    """
    path = result_path(bout, folder)
    if not path.exists() and error_of(path).exists():
        return None
    return read_as(Result, read_json(path), path, ANEW)


def result_path(bout: Bout, folder: Path) -> Path:
    """Where a bout leaves its result."""
    return folder / f"{bout_name(bout)}.json"


# -- doing them ------------------------------------------------------------------------------------


def do_all(bouts: Iterable[Bout], folder: Path, told: Told, workers: int, what: str) -> None:
    """Do the bouts that have no result yet; those that failed are tried again."""
    check(workers >= 0, f"workers={workers}; at least 0")
    wanted = {result_path(bout, folder): bout for bout in bouts}
    waiting = [(path, bout) for path, bout in wanted.items() if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    done = len(wanted) - len(waiting)
    if done:
        told(f"{what}: {done} of {len(wanted)} already")
    began = time.monotonic()
    for number, (path, ok) in enumerate(performed(waiting, workers), start=1):
        left = (time.monotonic() - began) / number * (len(waiting) - number)
        how = "" if ok else f"  FAILED, see {error_of(path)}"
        told(
            f"{what}: {done + number} of {len(wanted)}, about {left / 60:.0f} min left of it  "
            f"{last_words(path)}{wanted[path].contestant} on {wanted[path].task.label}{how}"
        )


def last_words(path: Path) -> str:
    """The gap that a bout ended with, in words; nothing of one that failed."""
    if not path.exists():
        return ""
    last = read_as(Result, read_json(path), path, ANEW).points[-1]
    return f"{100 * last['greedy']:7.2f} %  "


def performed(waiting: list[tuple[Path, Bout]], workers: int) -> Iterator[tuple[Path, bool]]:
    """Do these bouts; each as soon as it has ended, and whether it has a result."""
    if workers == 0:
        for path, bout in waiting:
            perform(requested(path, bout), path)
            yield path, ended(path, 0)
        return
    # One process that has imported everything, and a fork of it for every bout: imports take many
    # seconds where bouts take ten.
    context: Any = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["train.race.bout"])
    todo, running = list(waiting), dict[int, tuple[Path, Any]]()
    try:
        while todo or running:
            for lane in set(range(workers)) - set(running):
                if todo:
                    path, bout = todo.pop(0)
                    request = requested(path, bout)
                    child = context.Process(
                        target=perform_alone, args=(request, path, lane), daemon=True
                    )
                    child.start()
                    running[lane] = (path, child)
            for lane, (path, child) in list(running.items()):
                child.join(0.1)
                if not child.is_alive():
                    del running[lane]
                    yield path, ended(path, child.exitcode)
    finally:
        for _, child in running.values():
            child.terminate()
            child.join()


def requested(path: Path, bout: Bout) -> Path:
    """The file that says what is to be done; what failed before is forgotten."""
    request = path.with_suffix(".request")
    write_json(request, plain_bout(bout))
    error_of(path).unlink(missing_ok=True)
    return request


def ended(path: Path, code: int) -> bool:
    """Whether a bout that is over has a result; where it does not say why, its exit status does."""
    path.with_suffix(".request").unlink(missing_ok=True)
    if path.exists():
        return True
    if not error_of(path).exists():
        error_of(path).write_text(f"exit status {code}, and no word of why\n", encoding="utf-8")
    return False
