"""The search for settings before the runs of a study: [tuning] of its file.

Every algorithm or contestant gets the same number of trials with the same budget, on mazes that the
study does not use. The trial with the smallest mean logarithm of the gap to the optimum is chosen.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from pursuit.mazes.maze import load_maze
from pursuit.mazes.suite_files import is_suite
from pursuit.mazes.suites import least_copy, load_suite
from pursuit.validation import check
from train.experiments.contestant_runs import CONTESTANT
from train.experiments.expansion import Tuned, alternating, runs_of
from train.experiments.rows import read_all
from train.experiments.runs import TUNING, Study, TrainingRun, read_label
from train.experiments.search import draw_samples
from train.experiments.study import Layout, StudyFile, Table, Trials, Tuning, check_once, judged
from train.reports.tables import Row
from train.runs.folder import RUN

FIRST_TRIAL_SEED = 10**6
"""The first seed of trials; runs of studies have seeds below it."""
LEAST_GAP = 1e-3
"""Gaps below this count as equal in the selection of settings."""
MOST_TRIALS = 10_000


def search_of(tuning: Tuning, version: str | None, file: StudyFile | None = None) -> Study:
    """The trials of every algorithm or contestant.

    Args:
        tuning: the search.
        version: "short" or "full"; short by default.
        file: the comparison whose tasks (its variants) are searched one by one; None: algorithms
            are searched on the task in the settings of `tuning`.

    Raises:
        ValueError: a maze of the search that is also one of the study, or settings that cannot run.
    """
    trials = tuning.trials(version)
    common, tasks, names, episodes = tuning.settings, [Table()], list(tuning.space), 1000
    kind, of = RUN, "algorithm"
    if file is not None:
        kind, of, names = CONTESTANT, "contestant", (file.grid or {}).get("contestant", [])
        common = {**(file.settings or {}), **tuning.settings, "evaluations": 1}
        tasks, episodes = file.variants or tasks, file.episodes or episodes
        check(
            max(file.seeds or [0]) < FIRST_TRIAL_SEED,
            f"seeds={file.seeds}; give seeds below {FIRST_TRIAL_SEED}, the first seed of trials",
        )
    check_once(f"{of} in [tuning]" if file is None else f"{of} in [grid]", names)
    common = {**common, "seconds": trials.seconds, "frames": trials.frames}
    drawn = {name: draws_of(tuning, trials, name) for name in names}
    runs: list[TrainingRun] = []
    studied = [] if file is None else judged(file, "maze")
    for number, task in itertools.product(range(trials.samples), tasks):
        for place, maze in enumerate(mazes_of(tuning, trials, {**common, **task}, studied)):
            seed = FIRST_TRIAL_SEED + 1000 * number + place
            own = {**common, **{key: value for key, value in task.items() if key != "name"}}
            for name in names:
                label = {of: name, "maze": maze, **drawn[name][number], "trial": number}
                label |= {"name": task["name"]} if "name" in task else {}
                runs += runs_of(kind, own, label, [seed], episodes)
    layout = Layout(f"Search for the settings of each {of}", x="trial", group=[of])
    return Study(layout, alternating(runs), pinned=file is not None)


def draws_of(tuning: Tuning, trials: Trials, name: str) -> list[Table]:
    """The settings of every trial of an algorithm, contestant or variant. Those of "all" are equal
    for every one, and so are those of equal spaces."""
    spaces = [tuning.space[each] for each in ("all", name) if each in tuning.space]
    check(bool(spaces), f"no space of {name!r} in [tuning]; give it, or [tuning.space.all]")
    for setting in ("samples", "seed"):
        named = any(setting in space for space in spaces)
        check(not named, f"{setting!r} in [tuning.space]; give it in [tuning]")
    defaults: list[Table] = [{}] if tuning.shipped else []
    drawn: list[Table] = [{} for _ in range(trials.samples - len(defaults))]
    for place, space in enumerate(spaces if drawn else ()):
        search = {**space, "samples": len(drawn), "seed": tuning.search_seed + place}
        new = draw_samples(search, MOST_TRIALS)
        drawn = [{**old, **more} for old, more in zip(drawn, new, strict=True)]
    return defaults + drawn


def mazes_of(tuning: Tuning, trials: Trials, task: Table, others: Sequence[str] = ()) -> list[str]:
    """The mazes on which the settings of a task are searched.

    Args:
        tuning, trials: the search.
        task: the settings of its runs.
        others: further mazes of the study.

    Raises:
        ValueError: none, one given twice (also rotated or mirrored), or a maze of the study.
    """
    name, mazes = str(task.get("name", "")), tuning.mazes
    if isinstance(mazes, dict):
        mazes = mazes.get(name, [])
    own = [maze for maze in (task.get("maze"), *others) if isinstance(maze, str)]
    where = f"mazes of {name!r} in [tuning]" if name else "mazes in [tuning]"
    chosen = mazes[: trials.mazes]
    check(bool(chosen), f"{where}: none; give mazes for the search")
    studied = {key for maze in own for key in copies_in(maze)}
    copies: dict[bytes, str] = {}
    for maze in chosen:
        key = least_copy_of(maze)
        check(key not in studied, f"{where}: {maze!r} is a maze of the study; give another")
        before = copies.get(key)
        same = "is given twice" if before == maze else f"is a copy of {before!r}"
        check(before is None, f"{where}: {maze!r} {same}; give each once")
        copies[key] = maze
    return chosen


@lru_cache(maxsize=64)
def copies_in(name: str) -> list[bytes]:
    """By maze of a name, a key that is equal for its rotated and mirrored copies."""
    return [
        least_copy(maze) for maze in (load_suite(name) if is_suite(name) else [load_maze(name)])
    ]


def least_copy_of(maze: str) -> bytes:
    """The key of a name of one maze."""
    found = copies_in(maze)
    check(len(found) == 1, f"maze={maze!r} is several mazes; give one of them, as {maze}/0")
    return found[0]


# -- the choice ------------------------------------------------------------------------------------


def best_trials(out: Path) -> tuple[list[Row], Tuned]:
    """The trials of the search of a study as rows, and the settings of the best ones.

    Args:
        out: the folder of the study.

    Returns:
        A row for each trial of each algorithm or contestant (and task): its settings, its gaps on
        all mazes, their mean logarithm "score" (None while a run is missing), and whether it is
        "chosen": the first one with the lowest score. Nothing without a search.
    """
    folder = out / TUNING
    if not (folder / "runs").is_dir():
        return [], {}
    search = read_all(folder)
    of = search.layout.group[0]
    trials: dict[tuple[str, str, int], Row] = {}
    settings: dict[tuple[str, str, int], Table] = {}
    for row in sorted(search.everything, key=lambda row: (row["trial"], row["seed"])):
        key = (row[of], row["variant"] or "", row["trial"])
        label = read_label(folder / "runs" / row["run"])
        own = {n: v for n, v in label.items() if n not in (of, "maze", "variant", "trial")}
        settings[key] = own
        first: Row = {of: key[0], "task": key[1], "trial": key[2], **own, "gaps": []}
        gap = row.get("optimality_gap") if row["status"] == "complete" else None
        trials.setdefault(key, first)["gaps"].append(gap)
    for row in trials.values():
        # Absolute, as evaders have negative gaps.
        logs = [math.log(max(abs(gap), LEAST_GAP)) for gap in row["gaps"] if gap is not None]
        row["score"] = sum(logs) / len(logs) if len(logs) == len(row["gaps"]) else None
    scored = [key for key, row in trials.items() if row["score"] is not None]
    best: dict[tuple[str, str], tuple[str, str, int]] = {}
    for key in sorted(scored, key=lambda key: trials[key]["score"]):
        best.setdefault(key[:2], key)
    for key, row in trials.items():
        row["chosen"] = best.get(key[:2]) == key
    return list(trials.values()), {group: settings[key] for group, key in best.items()}
