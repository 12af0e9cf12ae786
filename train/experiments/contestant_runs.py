"""The run of a contestant: a library learns a task on one core, with periodic evaluations.

Its folder has the files of every run, but no checkpoint: it is executed whole.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Annotated, Any, ClassVar

import torch
from filelock import FileLock

from pursuit.validation import at_least, check, choice, one_of, unknown
from scripted_agents.exact.limits import MAX_EXACT_GOALS
from train.evaluation.contest import GameContest
from train.evaluation.scores import BY_STEPS, Score, optimality_gap
from train.experiments.contestants import CONTESTANTS, OBEYED, Contestant, Trainer
from train.experiments.study import Table, check_budget
from train.families.maze import GridWorld
from train.files import Plain, write_csv, write_json
from train.kinds import KINDS, Kind
from train.machine import machine, versions
from train.runs.folder import METRICS, RESULTS
from train.runs.forms import RESTORE
from train.runs.loop import Budget
from train.runs.threads import keep_freed_memory
from train.runs.worlds import world_of
from train.schemas import read_as
from train.settings.algorithms import PPOSettings
from train.settings.checks import CLOCKS, SEED, Settings
from train.settings.curricula import CurriculumSettings
from train.settings.reading import plain_settings
from train.settings.task import TaskSettings

CONTESTANT = "contestant"
"""The kind of these runs."""
WARM_UP_SEED = 2**31
"""Seed of the discarded warm-up games that trigger compilation and imports."""


@dataclass(frozen=True)
class ContestantSettings(Settings):
    """The settings of a run.

    Attributes:
        task: the task to learn.
        hyper: of the learner: the defaults of the contestant, overridden by the study file.
        contestant: its name.
        library: the package and its version.
        seed: of games, weights and sampled actions.
        seconds, frames: the budget, one of the two.
        clock: in which seconds are measured: wall, or processor (time of this process; equal on an
            idle machine).
        evaluations: evenly spaced over the budget; with several two more are at 1/4 and 1/2 of the
            first interval.
        curriculum_settings: there is no curriculum.
    """

    curriculum_settings: ClassVar[CurriculumSettings] = CurriculumSettings()

    task: TaskSettings = field(default_factory=TaskSettings)
    hyper: PPOSettings = field(default_factory=PPOSettings)
    contestant: str = "ours"
    library: str = ""
    seed: Annotated[int, SEED] = 0
    seconds: float | None = None
    frames: int | None = None
    clock: Annotated[str, choice(*CLOCKS)] = "wall"
    evaluations: Annotated[int, at_least(1)] = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        check_budget(self.seconds, self.frames)


def settings_of(**flat: Any) -> ContestantSettings:
    """Settings by name: of the run, of the task, and those of `OBEYED`; validated.

    Raises:
        ValueError: an unknown name, a value of a wrong type, or a task whose optimum is not known.
        ImportError: the library of the contestant is not installed.
    """
    flat = plain_settings(flat)
    flat.pop("threads", None)  # always one
    own = {f.name for f in fields(ContestantSettings)} - {"task", "hyper", "library"}
    of_task = [f.name for f in fields(TaskSettings)]
    names = [*sorted(own), *of_task, *OBEYED]
    check(
        "game" not in flat,
        f"game={flat.get('game')!r}: libraries are compared in mazes; use pursuit sweep or ablate",
    )
    for name in flat:
        check(name in names, unknown("setting of a contestant", name, names))
    one_of("contestant", flat.get("contestant"), CONTESTANTS)
    check("maze" in flat, "a task has no maze; give one in its settings")
    task = {name: value for name, value in flat.items() if name in of_task}
    drawn = {name: value for name, value in flat.items() if name in OBEYED}
    entry = CONTESTANTS[flat["contestant"]]
    where, remedy = "settings of a contestant", "correct that line"
    learned = read_as(TaskSettings, task, where, remedy)
    world, _, _ = world_and_contest(learned, 2)
    plain = {name: value for name, value in flat.items() if name in own}
    plain |= {"task": asdict(learned), "library": f"{entry.package} {entry.version}"}
    try:
        plain["hyper"] = asdict(hyper_of(entry, world, drawn))
    except TypeError as error:  # a string instead of a number
        raise ValueError(f"{where}: a value of a wrong type ({error}); {remedy}") from None
    return read_as(ContestantSettings, plain, where, remedy)


def hyper_of(entry: Contestant, world: GridWorld, drawn: Table) -> PPOSettings:
    """The defaults of a contestant, overridden by the drawn settings.

    A minibatch is at most one rollout. A drawn discount is constant.
    """
    values = dict(drawn)
    if "gamma" in values:
        values["gamma_end"] = None
    base = entry.defaults(world)
    frames = values.get("num_games", base.num_games)
    frames *= values.get("rollout_steps", base.rollout_steps)
    values["minibatch_size"] = min(values.get("minibatch_size", base.minibatch_size), frames)
    return replace(base, **values)


def from_plain(plain: Plain, where: str) -> ContestantSettings:
    """Settings from the `config.json` at `where`; ValueError if they are damaged."""
    return read_as(ContestantSettings, plain, where, RESTORE)


# -- a run -----------------------------------------------------------------------------------------


def world_and_contest(task: TaskSettings, episodes: int) -> tuple[GridWorld, GameContest, Score]:
    """The games of a task, its evaluation, and the exact optimum.

    Raises:
        ValueError: the optimum of the task is not known, or longer episodes are better.
    """
    world: Any = world_of(task)
    several = f"maze={task.maze!r} is several mazes; give one of them, such as {task.maze}/0"
    check(len(world.task.mazes) == 1, several)
    contest = world.contest(episodes)
    optimum = contest.optimal()
    if optimum is None or contest.measure != BY_STEPS:
        raise ValueError(
            f"{world.agent} of {task.task} in {task.maze}: a comparison needs a known optimum, and "
            "an agent that minimises episode length; use a runner with up to "
            f"{MAX_EXACT_GOALS} goals, or a chaser of one evader"
        )
    return world, contest, optimum


def evaluate(trainer: Trainer, contest: GameContest, optimum: Score) -> dict[str, float]:
    """The gaps of the current policy, with greedy and with sampled actions, and the better one."""
    row: dict[str, float] = {}
    scores = {}
    with torch.random.fork_rng():
        for name, greedy in (("greedy", True), ("sampled", False)):
            score = contest.score(name, trainer.policy(greedy))
            gap = optimality_gap(score, optimum)
            assert gap is not None
            row |= {name: gap, f"{name}_success": score.success_rate}
            scores[name] = score
    better = min(scores, key=lambda name: row[name])
    row |= {"mean_steps": scores[better].mean_steps, "success_rate": scores[better].success_rate}
    return row | {"optimality_gap": row[better]}


def learn(
    settings: ContestantSettings, contest: GameContest, optimum: Score
) -> list[dict[str, float]]:
    """Train within the budget; returns a row for each evaluation.

    Rollouts and updates are timed; imports, compilation and evaluations are not. The run ends
    before the iteration that would exceed the budget, assuming that it takes as long as the last.
    """
    world: Any = world_of(settings.task)
    build = CONTESTANTS[settings.contestant].build
    torch.set_num_threads(1)
    keep_freed_memory()
    warm = build(world, settings.hyper, WARM_UP_SEED)
    warm.iterate(0.0)
    evaluate(warm, replace(contest, episodes=2), optimum)
    warm.close()
    budget = Budget(settings.seconds, settings.frames)
    number = settings.evaluations
    marks = [n / number for n in range(1, number + 1)]
    marks = [marks[0] / 4, marks[0] / 2, *marks] if number > 1 else marks
    trainer = build(world, settings.hyper, settings.seed)
    torch.manual_seed(settings.seed)
    spent, seconds, rows, over = dict.fromkeys(CLOCKS, 0.0), 0.0, [], False
    while not over:
        before, began, began_processor = trainer.frames, perf_counter(), process_time()
        trainer.iterate(budget.progress(seconds, trainer.frames))
        took = {"wall": perf_counter() - began, "processor": process_time() - began_processor}
        spent = {clock: spent[clock] + took[clock] for clock in CLOCKS}
        seconds, last, frames = spent[settings.clock], took[settings.clock], trainer.frames - before
        over = (
            seconds + last > settings.seconds
            if settings.seconds is not None
            else trainer.frames + frames > (settings.frames or 0)
        )
        if over or budget.progress(seconds, trainer.frames) >= marks[0]:
            while len(marks) > 1 and marks[0] <= budget.progress(seconds, trainer.frames):
                marks.pop(0)
            row: dict[str, float] = {"frames": trainer.frames, "seconds": seconds}
            row |= {f"{clock}_seconds": each for clock, each in spent.items()}
            rows.append(row | evaluate(trainer, contest, optimum))
    trainer.close()
    return rows


@dataclass
class ContestantRun:
    """A run that is executed whole by `results`: as `train.runs.loop.Run` after training."""

    settings: ContestantSettings
    folder: Path
    lock: FileLock | None = None
    is_trained = True

    def results(self, episodes: int, exact_seconds: float | None = None) -> Plain:
        """Learn, and write `metrics.csv` and `results.json`; nothing large is solved here."""
        settings = self.settings
        _, contest, optimum = world_and_contest(settings.task, episodes)
        rows = learn(settings, contest, optimum)
        last = dict(rows[-1])
        frames, seconds = int(last.pop("frames")), last.pop("seconds")
        content = {
            "kind": CONTESTANT,
            "task": settings.task.task,
            "maze": contest.task.mazes[0].name,
            "algorithm": settings.contestant,
            "seed": settings.seed,
            "evaluation": {**last, "optimal_steps": optimum.mean_steps},
            "objective": {"column": "mean_steps", "unit": "steps", "less_is_better": True},
            "frames": frames,
            "seconds": seconds,
            "clock": settings.clock,
            "frames_per_second": frames / max(seconds, 1e-9),
            "interrupted": False,
            "versions": versions(),
            "machine": machine(),
        }
        write_csv(self.folder / METRICS, rows)
        write_json(self.folder / RESULTS, content)
        return content


def parts_of(settings: ContestantSettings) -> ContestantSettings:
    """The settings themselves; ValueError if their task cannot be compared."""
    world_and_contest(settings.task, 2)
    return settings


KINDS[CONTESTANT] = Kind(
    ContestantSettings,
    settings_of,
    from_plain,
    parts_of,
    lambda settings, folder, _: ContestantRun(settings, folder),
    "pursuit compare",
    (),
)
