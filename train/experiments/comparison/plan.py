"""The definition of a comparison: libraries, tasks, the search for settings, and its file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import msgspec

from pursuit.mazes.maze import load_maze
from pursuit.mazes.suite_files import is_suite
from pursuit.mazes.suites import least_copy, load_suite
from pursuit.validation import one_of
from train.experiments.comparison.contestants import OBEYED, contestant, settings_of
from train.experiments.comparison.library_run import CLOCKS, LibraryRun, world_and_contest
from train.experiments.forms import check_seeds
from train.experiments.search import draw_samples
from train.experiments.study import Call
from train.experiments.sweep import read_file
from train.runs.worlds import GridWorld
from train.schemas import read_as
from train.settings.algorithms import PPOSettings
from train.settings.checks import check
from train.settings.task import TaskSettings
from train.teaching.mazes import as_text

FILES = Path(__file__).with_name("files")
REMEDY = "correct that line; docs/results/libraries.md shows the form"
FIRST_TRIAL_SEED = 10**6
"""The first seed of trials; final runs have seeds below it."""
PERFORM = "train.experiments.comparison.library_run:perform"

Table = dict[str, Any]


def check_once(name: str, values: Sequence[Any]) -> None:
    """ValueError for an empty list or repeated values."""
    check(len(set(values)) == len(values) > 0, f"{name}={values}; give one or more, each once")


class Budgets(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The budget of each run."""

    seconds: float | None = None
    frames: int | None = None

    def __post_init__(self) -> None:
        check(
            (self.seconds is None) != (self.frames is None),
            f"seconds={self.seconds} and frames={self.frames}; give one of the two",
        )
        budget = self.seconds if self.frames is None else self.frames
        check(budget is not None and 0 < budget < 1e9, f"budget {budget}; give one above 0")


class Tuning(Budgets, forbid_unknown_fields=True, kw_only=True):
    """[tuning]: the search for settings and its number of trials."""

    trials: int

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self.trials > 0, f"trials={self.trials} in [tuning]; give at least 1")


class Final(Budgets, forbid_unknown_fields=True, kw_only=True):
    """[final]: the runs that are compared."""

    seeds: list[int]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_seeds(self.seeds)
        check_once("seeds", self.seeds)
        below = max(self.seeds) < FIRST_TRIAL_SEED
        check(
            below,
            f"seeds={self.seeds}; give seeds below {FIRST_TRIAL_SEED}, the first seed of trials",
        )


class TaskEntry(msgspec.Struct, forbid_unknown_fields=True):
    """[[tasks]]: a task, and the held-out mazes for the search for settings."""

    name: str
    settings: Table
    held_out: list[str]


class Version(msgspec.Struct, forbid_unknown_fields=True):
    """[short] or [full]: values that override the rest of the file."""

    tuning: Tuning
    final: Final
    episodes: int = 500
    tasks: list[str] | None = None
    contestants: list[str] | None = None
    held_out: int | None = None

    def __post_init__(self) -> None:
        check(self.episodes >= 2, f"episodes={self.episodes}; give at least 2")
        check(
            self.held_out is None or self.held_out > 0,
            f"held_out={self.held_out}; give at least 1, or leave it out to use all",
        )


class ComparisonFile(msgspec.Struct, forbid_unknown_fields=True):
    """The contents of a comparison file."""

    title: str
    contestants: list[str]
    tasks: list[TaskEntry]
    space: Table
    short: Version
    full: Version
    search_seed: int = 0
    clock: str = "wall"


@dataclass(frozen=True)
class ComparedTask:
    """A task of a comparison.

    Attributes:
        name: in reports.
        task: the task to learn.
        held_out: the same task in other mazes, for the search.
    """

    name: str
    task: TaskSettings
    held_out: tuple[TaskSettings, ...]


@dataclass(frozen=True)
class Comparison:
    """A validated comparison.

    Attributes:
        title: of the report.
        contestants: their names.
        tasks: the tasks.
        space: the search space, as in the file.
        trials: the drawn settings by number, the same for every contestant.
        tuning, final: the budgets; of `final` also the seeds.
        episodes: per evaluation.
        clock: the clock of seconds, "wall" or "processor".
    """

    title: str
    contestants: tuple[str, ...]
    tasks: tuple[ComparedTask, ...]
    space: Table
    trials: tuple[Table, ...]
    tuning: Tuning
    final: Final
    episodes: int
    clock: str

    def trial_jobs(self) -> dict[tuple[str, str, int, int], Call]:
        """By task, contestant, trial and maze. Contestants alternate in the innermost loop."""
        return {
            (on.name, name, number, place): self._job(
                {"contestant": name, "task": on.name, "trial": number, "maze": place},
                task,
                drawn,
                FIRST_TRIAL_SEED + 1000 * number + place,
                self.tuning,
            )
            for number, drawn in enumerate(self.trials)
            for on in self.tasks
            for place, task in enumerate(on.held_out)
            for name in turned(self.contestants, number)
        }

    def final_jobs(self, chosen: dict[tuple[str, str], int]) -> dict[tuple[str, str, int], Call]:
        """By task, contestant and seed. Contestants alternate in the innermost loop.

        Args:
            chosen: the number of the trial whose settings are used, by task and contestant.
        """
        return {
            (on.name, name, seed): self._job(
                {"contestant": name, "task": on.name},
                on.task,
                self.trials[chosen[on.name, name]],
                seed,
                self.final,
            )
            for turn, (seed, on) in enumerate(product(self.final.seeds, self.tasks))
            for name in turned(self.contestants, turn)
        }

    def _job(self, label: Table, task: TaskSettings, drawn: Table, seed: int, of: Budgets) -> Call:
        run = LibraryRun(
            label["contestant"],
            replace(task, maze=as_text(task.maze)),
            drawn,
            seed,
            of.seconds,
            of.frames,
            self.episodes,
            watched=of is self.final,
            clock=self.clock,
        )
        return Call(PERFORM, asdict(run), label, seed, of.seconds)

    def count(self) -> tuple[int, int]:
        """The numbers of runs of the search and of final runs."""
        each, mazes = len(self.contestants), sum(len(on.held_out) for on in self.tasks)
        return (
            len(self.trials) * mazes * each,
            len(self.final.seeds) * len(self.tasks) * each,
        )

    def seconds(self) -> float | None:
        """The duration of all runs, without evaluations; None for budgets in frames."""
        tuning, final = self.count()
        if self.tuning.seconds is None or self.final.seconds is None:
            return None
        return tuning * self.tuning.seconds + final * self.final.seconds


def turned(names: Sequence[str], by: int) -> list[str]:
    """The names, rotated, so that none is always the first."""
    by %= len(names)
    return [*names[by:], *names[:by]]


# -- reading ---------------------------------------------------------------------------------------


def load_comparison(name: str, version: str | None = None, clock: str | None = None) -> Comparison:
    """Read and validate a comparison file, without running it.

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full"; short by default.
        clock: "wall" or "processor"; by default that of the file.

    Raises:
        ValueError: no such file, an unknown key, a value of a wrong type, an unknown contestant,
            task or setting, or a held-out maze that is also the maze of a task.
        ImportError: the library of a contestant is not installed.
    """
    check(version in (None, "short", "full"), f"unknown version {version!r}; short or full")
    path, content = read_file(name, FILES, "comparison")
    file = read_as(ComparisonFile, content, path, REMEDY)
    try:
        file.clock = clock or file.clock
        return comparison_of(file, file.full if version == "full" else file.short)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def comparison_of(file: ComparisonFile, version: Version) -> Comparison:
    """The validated comparison of one version of a file."""
    one_of("clock", file.clock, CLOCKS)
    names = version.contestants or file.contestants
    check_once("contestants", names)
    known = {task.name: task for task in file.tasks}
    check_once("tasks", [task.name for task in file.tasks])
    wanted = version.tasks or list(known)
    check_once("tasks", wanted)
    for name in wanted:
        one_of("task", name, known)
    tasks = tuple(compared_task(known[name], version.held_out) for name in wanted)
    for one, other in combinations(tasks, 2):
        same = f"tasks {one.name!r} and {other.name!r} are the same; leave one out"
        check(one.task != other.task, same)
    tuning = version.tuning
    for name in file.space:
        check(name in OBEYED, f"unknown setting {name!r} in [space]; give some of {OBEYED}")
    search = {**file.space, "samples": tuning.trials, "seed": file.search_seed}
    drawn = draw_samples(search, 10_000)
    for name in names:
        check_contestant(name, tasks, drawn)
    return Comparison(
        file.title,
        tuple(names),
        tasks,
        file.space,
        tuple(drawn),
        tuning,
        version.final,
        version.episodes,
        file.clock,
    )


def compared_task(task: TaskEntry, most: int | None) -> ComparedTask:
    """A task with at most `most` of its held-out mazes."""
    check("maze" in task.settings, f"task {task.name!r} has no maze; give one in its settings")
    learned = read_as(TaskSettings, task.settings, f"task {task.name!r}", REMEDY)
    mazes = task.held_out[:most]
    check(bool(mazes), f"task {task.name!r}: held_out is empty; give mazes for the search")
    copies = {copy_of(learned.maze): learned.maze}
    for maze in mazes:
        where = f"task {task.name!r}: held-out maze {maze!r}"
        before = copies.get(copy_of(maze))
        check(before != learned.maze, f"{where} is the maze of the comparison; give another")
        same = "is given twice" if before == maze else f"is a copy of {before!r}"
        check(before is None, f"{where} {same}; give each once")
        copies[copy_of(maze)] = maze
    others = tuple(TaskSettings(**{**task.settings, "maze": maze}) for maze in mazes)
    for each in (learned, *others):
        world_and_contest(each, 2)
    return ComparedTask(task.name, learned, others)


def copy_of(maze: str) -> bytes:
    """A key that is equal for a maze and its rotated and mirrored copies."""
    found = load_suite(maze) if is_suite(maze) else (load_maze(maze),)
    check(len(found) == 1, f"maze={maze!r} is several mazes; give one of them, as {maze}/0")
    return least_copy(found[0])


def check_contestant(name: str, tasks: Sequence[ComparedTask], trials: Sequence[Table]) -> None:
    """ValueError for an unknown contestant or for drawn settings that it refuses."""
    contestant(name)
    worlds = [GridWorld(on.task) for on in tasks]
    for world, drawn in product(worlds, trials):
        try:
            found = asdict(settings_of(name, world, drawn))
        except TypeError as error:  # a string instead of a number
            raise ValueError(f"[space]: a value of a wrong type ({error}); {REMEDY}") from None
        read_as(PPOSettings, found, "[space]", REMEDY)
