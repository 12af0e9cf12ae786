"""A comparison of libraries: who learns which tasks, and how their settings are searched."""

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
from train.experiments.comparison.contestants import OBEYED, contestant, settings_of
from train.experiments.comparison.library_run import CLOCKS, LibraryRun, world_and_contest
from train.experiments.forms import check_seeds
from train.experiments.search import draw_samples
from train.experiments.study import Call
from train.experiments.sweep import read_file
from train.runs.worlds import GridWorld
from train.schemas import read_as
from train.settings.algorithms import PPOSettings
from train.settings.checks import check, check_choice
from train.settings.task import TaskSettings
from train.teaching.mazes import as_text

FILES = Path(__file__).with_name("files")
REMEDY = "mend that line; docs/results/libraries.md shows the form"
FIRST_TRIAL_SEED = 10**6
"""Seeds of trials begin here: none of them is a seed of the comparison itself."""
PERFORM = "train.experiments.comparison.library_run:perform"

Table = dict[str, Any]


def check_once(name: str, values: Sequence[Any]) -> None:
    """ValueError for an empty list, or one with a value twice."""
    check(len(set(values)) == len(values) > 0, f"{name}={values}; give each once, one at least")


class Budgets(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """How long each run is."""

    seconds: float | None = None
    frames: int | None = None

    def __post_init__(self) -> None:
        check(
            (self.seconds is None) != (self.frames is None),
            f"seconds={self.seconds} and frames={self.frames}; give one of the two",
        )
        budget = self.seconds if self.frames is None else self.frames
        check(budget is not None and 0 < budget < 1e9, f"a budget of {budget}; it is above 0")


class Tuning(Budgets, forbid_unknown_fields=True, kw_only=True):
    """[tuning]: the search, and how many trials it has."""

    trials: int

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self.trials > 0, f"trials={self.trials} in [tuning]; at least 1")


class Final(Budgets, forbid_unknown_fields=True, kw_only=True):
    """[final]: the comparison itself."""

    seeds: list[int]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_seeds(self.seeds)
        check_once("seeds", self.seeds)
        below = max(self.seeds) < FIRST_TRIAL_SEED
        check(
            below,
            f"seeds={self.seeds}; below {FIRST_TRIAL_SEED}: those from there on are of trials",
        )


class RaceTask(msgspec.Struct, forbid_unknown_fields=True):
    """[[tasks]]: what is learned, and the mazes that settings are searched on instead."""

    name: str
    settings: Table
    held_out: list[str]


class Version(msgspec.Struct, forbid_unknown_fields=True):
    """[short] or [full]: what lies over the rest of the file."""

    tuning: Tuning
    final: Final
    episodes: int = 500
    tasks: list[str] | None = None
    contestants: list[str] | None = None
    held_out: int | None = None

    def __post_init__(self) -> None:
        check(self.episodes >= 2, f"episodes={self.episodes}; at least 2")
        check(
            self.held_out is None or self.held_out > 0,
            f"held_out={self.held_out}; at least 1, or leave it out to take all",
        )


class RaceFile(msgspec.Struct, forbid_unknown_fields=True):
    """A file of a comparison as it is written."""

    title: str
    contestants: list[str]
    tasks: list[RaceTask]
    space: Table
    short: Version
    full: Version
    search_seed: int = 0
    clock: str = "wall"


@dataclass(frozen=True)
class RaceOn:
    """A task of a comparison.

    Attributes:
        name: in reports.
        task: what is learned.
        held_out: the same in other mazes, for the search.
    """

    name: str
    task: TaskSettings
    held_out: tuple[TaskSettings, ...]


@dataclass(frozen=True)
class Race:
    """A comparison, checked.

    Attributes:
        title: of the report.
        contestants: their names.
        tasks: what is learned.
        space: of the search, as the file has it.
        trials: settings by number, the same for every contestant.
        tuning, final: the budgets, and the seeds of the comparison itself.
        episodes: of each evaluation.
        clock: what seconds are of, "wall" or "cpu".
    """

    title: str
    contestants: tuple[str, ...]
    tasks: tuple[RaceOn, ...]
    space: Table
    trials: tuple[Table, ...]
    tuning: Tuning
    final: Final
    episodes: int
    clock: str

    def trial_jobs(self) -> dict[tuple[str, str, int, int], Call]:
        """By task, contestant, number of the trial and of the maze: trials outside, contestants
        inside."""
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
        """By task, contestant and seed: seeds outside, contestants inside, in turned order.

        Args:
            chosen: the number of the trial whose settings are taken, by task and contestant.
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
        """Runs of the search, and of the comparison."""
        each, mazes = len(self.contestants), sum(len(on.held_out) for on in self.tasks)
        return (
            len(self.trials) * mazes * each,
            len(self.final.seeds) * len(self.tasks) * each,
        )

    def seconds(self) -> float | None:
        """What all runs take, without evaluations; None where budgets are frames."""
        tuning, final = self.count()
        if self.tuning.seconds is None or self.final.seconds is None:
            return None
        return tuning * self.tuning.seconds + final * self.final.seconds


def turned(names: Sequence[str], by: int) -> list[str]:
    """The names in turn, so that none is always the first."""
    by %= len(names)
    return [*names[by:], *names[:by]]


# -- reading ---------------------------------------------------------------------------------------


def load_race(name: str, version: str | None = None, clock: str | None = None) -> Race:
    """Read the file of a comparison and check it; nothing is run.

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full"; short if left out.
        clock: "wall" or "cpu"; that of the file if left out.

    Raises:
        ValueError: no such file, an unknown key, a value of another type, a contestant, task or
            setting that there is not, or a held-out maze that is one of the comparison's.
        ImportError: the library of a contestant is not installed.
    """
    check(version in (None, "short", "full"), f"unknown version {version!r}; short or full")
    path, content = read_file(name, FILES, "race")
    file = read_as(RaceFile, content, path, REMEDY)
    try:
        file.clock = clock or file.clock
        return race_of(file, file.full if version == "full" else file.short)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def race_of(file: RaceFile, version: Version) -> Race:
    """A version of the file of a comparison, checked."""
    check_choice("clock", file.clock, CLOCKS)
    names = version.contestants or file.contestants
    check_once("contestants", names)
    known = {task.name: task for task in file.tasks}
    check_once("tasks", [task.name for task in file.tasks])
    wanted = version.tasks or list(known)
    check_once("tasks", wanted)
    for name in wanted:
        check(name in known, f"no task {name!r}; it has {', '.join(known)}")
    tasks = tuple(race_on(known[name], version.held_out) for name in wanted)
    for one, other in combinations(tasks, 2):
        same = f"tasks {one.name!r} and {other.name!r} are the same; leave one out"
        check(one.task != other.task, same)
    tuning = version.tuning
    for name in file.space:
        known_to_all = f"those that every contestant obeys are {', '.join(OBEYED)}"
        check(name in OBEYED, f"[space] has {name!r}; {known_to_all}")
    search = {**file.space, "samples": tuning.trials, "seed": file.search_seed}
    drawn = draw_samples(search, 10_000)
    for name in names:
        check_contestant(name, tasks, drawn)
    return Race(
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


def race_on(task: RaceTask, most: int | None) -> RaceOn:
    """A task with its held-out mazes, of which `most` are taken."""
    check("maze" in task.settings, f"task {task.name!r} has no maze in its settings")
    learned = read_as(TaskSettings, task.settings, f"task {task.name!r}", REMEDY)
    mazes = task.held_out[:most]
    check(bool(mazes), f"task {task.name!r}: held_out is empty; give mazes to search on")
    copies = {copy_of(learned.maze): learned.maze}
    for maze in mazes:
        where = f"task {task.name!r}: held-out maze {maze!r}"
        before = copies.get(copy_of(maze))
        check(before != learned.maze, f"{where} is the maze of the race; take another")
        same = "stands there twice" if before == maze else f"is a copy of {before!r}"
        check(before is None, f"{where} {same}; once")
        copies[copy_of(maze)] = maze
    others = tuple(TaskSettings(**{**task.settings, "maze": maze}) for maze in mazes)
    for each in (learned, *others):
        world_and_contest(each, 2)
    return RaceOn(task.name, learned, others)


def copy_of(maze: str) -> bytes:
    """The same for a maze and its rotated and mirrored copies."""
    found = load_suite(maze) if is_suite(maze) else (load_maze(maze),)
    check(len(found) == 1, f"maze={maze!r} is several mazes; give one of them, as {maze}/0")
    return least_copy(found[0])


def check_contestant(name: str, tasks: Sequence[RaceOn], trials: Sequence[Table]) -> None:
    """ValueError where a contestant cannot be, or cannot have what was drawn."""
    contestant(name)
    worlds = [GridWorld(on.task) for on in tasks]
    for world, drawn in product(worlds, trials):
        try:
            found = asdict(settings_of(name, world, drawn))
        except TypeError as error:  # a text where a number belongs
            raise ValueError(f"[space]: a value of another type ({error}); {REMEDY}") from None
        read_as(PPOSettings, found, "[space]", REMEDY)
