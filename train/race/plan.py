"""A race file: who races, on which tasks, and how their settings are searched."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, product
from math import log
from pathlib import Path
from typing import Any

import msgspec

import pursuit
from pursuit.maze import load_maze
from pursuit.suite_files import is_suite
from pursuit.suites import least_copy, load_suite
from train.experiments.forms import VERSIONS, check_keys, check_seeds
from train.experiments.search import draw_samples
from train.experiments.sweep import read_file
from train.race.bout import CLOCKS, Bout, plain_bout, world_and_contest
from train.race.contestants import OBEYED, contestant, settings_of
from train.runs.worlds import GridWorld
from train.schemas import read_as
from train.settings.algorithms import PPOSettings
from train.settings.checks import check, check_choice
from train.settings.task import TaskSettings

FILES = Path(__file__).with_name("files")
REMEDY = "mend that line; docs/race.md shows the form"
FIRST_TRIAL_SEED = 10**6
"""Seeds of trials begin here: no trial is played with the seed of a race."""
LEAST_GAP = 1e-3
"""Gaps below this count alike where settings are chosen."""

Table = dict[str, Any]


class Budgets(msgspec.Struct, forbid_unknown_fields=True):
    """How long each bout is."""

    seconds: float | None = None
    frames: int | None = None

    def __post_init__(self) -> None:
        check(
            (self.seconds is None) != (self.frames is None),
            f"seconds={self.seconds} and frames={self.frames}; give one of the two",
        )
        budget = self.seconds if self.frames is None else self.frames
        check(budget is not None and 0 < budget < 1e9, f"a budget of {budget}; it is above 0")


class Tuning(Budgets, forbid_unknown_fields=True):
    """[tuning]: the search, and how many bouts it has."""

    trials: int | None = None
    finalists: int | None = None


class Final(Budgets, forbid_unknown_fields=True):
    """[final]: the race itself."""

    seeds: list[int] | None = None


class RaceTask(msgspec.Struct, forbid_unknown_fields=True):
    """[[tasks]]: what is raced on, and the mazes that settings are searched on instead."""

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


class RaceFile(msgspec.Struct, forbid_unknown_fields=True):
    """A race file as it is written."""

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
    """A task of a race.

    Attributes:
        name: in reports.
        task: what is raced on.
        held_out: the same in other mazes, for the search.
    """

    name: str
    task: TaskSettings
    held_out: tuple[TaskSettings, ...]


@dataclass(frozen=True)
class Race:
    """A race, checked.

    Attributes:
        title: of the report.
        contestants: their names.
        tasks: what is raced on.
        space: of the search, as the file has it.
        trials: settings by number, the same for every contestant.
        finalists: how many of a contestant's trials, the best on the first held-out maze of a
            task, are run on the other ones too.
        tuning, final: the budgets.
        seeds: of the race itself.
        episodes: of each evaluation.
        clock: what seconds are of, "wall" or "cpu".
    """

    title: str
    contestants: tuple[str, ...]
    tasks: tuple[RaceOn, ...]
    space: Table
    trials: tuple[Table, ...]
    finalists: int
    tuning: Tuning
    final: Final
    seeds: tuple[int, ...]
    episodes: int
    clock: str

    def trial_bouts(
        self, kept: dict[tuple[str, str], set[int]] | None = None
    ) -> Iterator[tuple[str, str, int, Bout]]:
        """(task, contestant, number of the trial, bout): trials outside, contestants inside.

        Args:
            kept: the finalists by task and contestant, to be run on all held-out mazes but the
                first; without it all trials are run on the first.
        """
        places = slice(1) if kept is None else slice(1, None)
        for number, drawn in enumerate(self.trials):
            for on in self.tasks:
                for place, task in list(enumerate(on.held_out))[places]:
                    for name in turned(self.contestants, number):
                        if kept is not None and number not in kept[on.name, name]:
                            continue
                        seed = FIRST_TRIAL_SEED + 1000 * number + place
                        budget = (self.tuning.seconds, self.tuning.frames)
                        bout = Bout(
                            name, task, drawn, seed, *budget, self.episodes, False, self.clock
                        )
                        yield on.name, name, number, bout

    def final_bouts(
        self, chosen: dict[tuple[str, str], Table]
    ) -> Iterator[tuple[str, str, int, Bout]]:
        """(task, contestant, seed, bout): seeds outside, contestants inside, in turned order.

        Args:
            chosen: the settings by task and contestant.
        """
        for turn, (seed, on) in enumerate(product(self.seeds, self.tasks)):
            for name in turned(self.contestants, turn):
                drawn = chosen[on.name, name]
                budget = (self.final.seconds, self.final.frames)
                bout = Bout(name, on.task, drawn, seed, *budget, self.episodes, True, self.clock)
                yield on.name, name, seed, bout

    def count(self) -> tuple[int, int]:
        """Bouts of the search, and of the race."""
        each = len(self.contestants)
        first, more = len(self.tasks), sum(len(on.held_out) - 1 for on in self.tasks)
        trials = len(self.trials) * first + self.finalists * more
        return trials * each, len(self.seeds) * len(self.tasks) * each

    def seconds(self) -> float | None:
        """What all bouts take, without evaluations; None where budgets are frames."""
        tuning, final = self.count()
        if self.tuning.seconds is None or self.final.seconds is None:
            return None
        return tuning * self.tuning.seconds + final * self.final.seconds


def turned(names: Sequence[str], by: int) -> list[str]:
    """The names in turn, so that nobody is always the first."""
    by %= len(names)
    return [*names[by:], *names[:by]]


def bout_name(bout: Bout) -> str:
    """Of its files: readable, with a fingerprint of all that decides it at the end."""
    maze = bout.task.maze  # a file may change, a suite is frozen
    walls = "" if is_suite(maze) else load_maze(maze).to_text()
    plain = json.dumps([pursuit.__version__, walls, plain_bout(bout)], sort_keys=True)
    print_ = hashlib.sha256(plain.encode()).hexdigest()[:10]
    return f"{bout.contestant}-{bout.task.label}-seed{bout.seed}-{print_}"


def score_of(points: Sequence[dict[str, float]]) -> float:
    """What settings are chosen by: the logarithm of the last gap, the better of the two ways."""
    last = points[-1]
    return log(max(min(last["greedy"], last["sampled"]), LEAST_GAP))


# -- reading ---------------------------------------------------------------------------------------


def load_race(name: str, version: str | None = None, clock: str | None = None) -> Race:
    """Read a race file and check it; nothing is run.

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full"; short if left out.
        clock: "wall" or "cpu"; that of the file if left out.

    Raises:
        ValueError: no such file, an unknown key, a value of another type, a contestant, task or
            setting that there is not, or a held-out maze that is raced in.
        ImportError: the library of a contestant is not installed.
    """
    check(version in (None, *VERSIONS), f"unknown version {version!r}; short or full")
    path, content = read_file(name, FILES, "race")
    try:
        check_keys(content, RaceFile, "")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    file = read_as(RaceFile, content, path, REMEDY)
    try:
        file.clock = clock or file.clock
        return race_of(file, file.full if version == "full" else file.short)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def race_of(file: RaceFile, version: Version) -> Race:
    """A version of a race file, checked."""
    check_choice("clock", file.clock, CLOCKS)
    names = version.contestants or file.contestants
    check(len(set(names)) == len(names) > 0, f"contestants={names}; give each once, one at least")
    known = [task.name for task in file.tasks]
    check(len(set(known)) == len(known) > 0, f"tasks {known}; names are different, one at least")
    wanted = version.tasks or known
    for name in wanted:
        check(name in known, f"no task {name!r}; it has {', '.join(known)}")
    check(len(set(wanted)) == len(wanted), f"tasks={wanted}; give each once")
    check(version.episodes >= 2, f"episodes={version.episodes}; at least 2")
    trials, seeds = version.tuning.trials, version.final.seeds
    check(trials is not None and trials > 0, f"trials={trials} in [tuning]; at least 1")
    check(seeds is not None, "no seeds in [final]; give seeds = [0, 1, 2, 3, 4]")
    check_seeds(seeds or [])
    below = all(seed < FIRST_TRIAL_SEED for seed in seeds or [])
    check(below, f"seeds={seeds}; below {FIRST_TRIAL_SEED}: those from there on are of trials")
    check(len(set(seeds or [])) == len(seeds or []), f"seeds={seeds}; give each once")
    most = version.held_out
    check(most is None or most > 0, f"held_out={most}; at least 1, or leave it out to take all")
    tasks = tuple(
        race_on(task, most) for name in wanted for task in file.tasks if task.name == name
    )
    for one, other in combinations(tasks, 2):
        same = f"tasks {one.name!r} and {other.name!r} are the same; leave one out"
        check(one.task != other.task, same)
    check_finalists(version.tuning, tasks)
    for name in file.space:
        known_to_all = f"those that every contestant obeys are {', '.join(OBEYED)}"
        check(name in OBEYED, f"[space] has {name!r}; {known_to_all}")
    drawn = draw_samples({**file.space, "samples": trials, "seed": file.search_seed}, 10_000)
    for name in names:
        check_contestant(name, tasks, drawn)
    return Race(
        file.title,
        tuple(names),
        tasks,
        file.space,
        tuple(drawn),
        version.tuning.finalists or len(drawn),
        version.tuning,
        version.final,
        tuple(seeds or ()),
        version.episodes,
        file.clock,
    )


def check_finalists(tuning: Tuning, tasks: Sequence[RaceOn]) -> None:
    """ValueError for a number of finalists that cannot be, or that changes nothing."""
    finalists, trials = tuning.finalists, tuning.trials or 0
    if finalists is not None:
        check(
            1 <= finalists <= trials, f"finalists={finalists}; 1 to {trials}, as there are trials"
        )
        check(
            any(len(on.held_out) > 1 for on in tasks),
            f"finalists={finalists}, but no task has more than one held-out maze to run them on; "
            "leave it out, or give more mazes",
        )


def race_on(task: RaceTask, most: int | None) -> RaceOn:
    """A task with its held-out mazes, of which `most` are taken."""
    check("maze" in task.settings, f"task {task.name!r} has no maze in its settings")
    raced = read_as(TaskSettings, task.settings, f"task {task.name!r}", REMEDY)
    mazes = task.held_out[:most]
    check(bool(mazes), f"task {task.name!r}: held_out is empty; give mazes to search on")
    others, copies = list[TaskSettings](), dict[bytes, str]()
    for maze in mazes:
        before = copies.setdefault(copy_of(maze), maze)
        same = "stands there twice" if before == maze else f"is a copy of {before!r}"
        check(len(copies) > len(others), f"task {task.name!r}: held-out maze {maze!r} {same}; once")
        check(
            copy_of(maze) != copy_of(raced.maze),
            f"task {task.name!r}: held-out maze {maze!r} is the maze of the race; take another",
        )
        others.append(TaskSettings(**{**task.settings, "maze": maze}))
    for each in (raced, *others):
        world_and_contest(each, 2)
    return RaceOn(task.name, raced, tuple(others))


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
