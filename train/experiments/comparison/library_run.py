"""One run of a comparison: a library learns a task on one core, with periodic evaluations."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time
from typing import Any

import torch

from train.evaluation.contest import GameContest
from train.evaluation.scores import BY_STEPS, Score, optimality_gap
from train.experiments.comparison.contestants import Trainer, contestant, settings_of
from train.machine import commit, processor
from train.runs.loop import Budget
from train.runs.threads import keep_freed_memory
from train.runs.worlds import GridWorld
from train.settings.checks import check
from train.settings.task import TaskSettings

EVALUATIONS = 20
"""Evenly spaced over the budget; two more are at 1/4 and 1/2 of the first interval."""
CLOCKS = ("wall", "processor")
"""Wall clock time, or processor time of this process; equal on an idle machine."""
WARM_UP_SEED = 2**31
"""Seed of the discarded warm-up games that trigger compilation and imports."""


@dataclass(frozen=True)
class LibraryRun:
    """The settings of a run.

    Attributes:
        contestant: name of the contestant.
        task: the task to learn.
        drawn: settings that override the defaults of the contestant.
        seed: of games, weights and sampled actions.
        seconds, frames: the budget, one of the two.
        episodes: per evaluation.
        watched: whether to evaluate throughout training, or only at the end.
        clock: one of `CLOCKS`, in which seconds are measured.
    """

    contestant: str
    task: TaskSettings
    drawn: dict[str, Any]
    seed: int
    seconds: float | None
    frames: int | None
    episodes: int
    watched: bool
    clock: str = "wall"


def world_and_contest(task: TaskSettings, episodes: int) -> tuple[GridWorld, GameContest, Score]:
    """The games of a task, its evaluation, and the exact optimum.

    Raises:
        ValueError: the optimum of the task is not known, or longer episodes are better.
    """
    world = GridWorld(task)
    contest = world.contest(episodes)
    one = isinstance(contest, GameContest)
    check(one, f"maze={task.maze!r} is several mazes; give one of them, such as {task.maze}/0")
    assert isinstance(contest, GameContest)
    optimum = contest.optimal()
    check(
        optimum is not None and contest.measure == BY_STEPS,
        f"{world.agent} of {task.task} in {task.maze}: a comparison needs a known optimum, and an "
        "agent that minimises episode length; use a runner with up to 15 goals, or a chaser of one "
        "evader",
    )
    assert optimum is not None
    return world, contest, optimum


def point_of(trainer: Trainer, contest: GameContest, optimum: Score) -> dict[str, float]:
    """The gaps of the current policy, with greedy and with sampled actions."""
    found: dict[str, float] = {}
    with torch.random.fork_rng():
        for name, greedy in (("greedy", True), ("sampled", False)):
            score = contest.score(name, trainer.policy(greedy))
            gap = optimality_gap(score, optimum)
            assert gap is not None
            found |= {name: gap, f"{name}_success": score.success_rate}
    return found


def learn(run: LibraryRun) -> dict[str, Any]:
    """Run and evaluate.

    Rollouts and updates are timed; imports, compilation and evaluations are not. The run ends
    before the iteration that would exceed the budget, assuming that it takes as long as the last.

    Returns:
        "points": a dictionary per evaluation with "seconds" of the run's clock, "wall_seconds",
        "processor_seconds", "frames", "greedy" and "sampled" gaps, and their success rates. The
        other entries are settings, versions and the machine.
    """
    entry = contestant(run.contestant)
    world, contest, optimum = world_and_contest(run.task, run.episodes)
    settings = settings_of(run.contestant, world, run.drawn)
    torch.set_num_threads(1)
    keep_freed_memory()
    warm = entry.build(world, settings, WARM_UP_SEED)
    warm.iterate(0.0)
    point_of(warm, replace(contest, episodes=2), optimum)
    warm.close()
    budget = Budget(run.seconds, run.frames)
    marks = [n / EVALUATIONS for n in range(1, EVALUATIONS + 1)] if run.watched else [1.0]
    marks = [marks[0] / 4, marks[0] / 2, *marks] if run.watched else marks
    trainer = entry.build(world, settings, run.seed)
    torch.manual_seed(run.seed)
    spent, seconds, points, over = dict.fromkeys(CLOCKS, 0.0), 0.0, [], False
    while not over:
        before, began, began_processor = trainer.frames, perf_counter(), process_time()
        trainer.iterate(budget.progress(seconds, trainer.frames))
        took = {"wall": perf_counter() - began, "processor": process_time() - began_processor}
        spent = {clock: spent[clock] + took[clock] for clock in CLOCKS}
        seconds, last, frames = spent[run.clock], took[run.clock], trainer.frames - before
        over = (
            seconds + last > run.seconds
            if run.seconds is not None
            else trainer.frames + frames > (run.frames or 0)
        )
        if over or budget.progress(seconds, trainer.frames) >= marks[0]:
            while len(marks) > 1 and marks[0] <= budget.progress(seconds, trainer.frames):
                marks.pop(0)
            now = {"seconds": seconds, "frames": trainer.frames}
            now |= {f"{clock}_seconds": each for clock, each in spent.items()}
            points.append(now | point_of(trainer, contest, optimum))
    trainer.close()
    return {
        "points": points,
        "optimal_steps": optimum.mean_steps,
        "settings": asdict(settings),
        "library": f"{entry.package} {entry.version}",
        "processor": processor(),
        "torch": str(torch.__version__),
        "commit": commit(),
    }


def perform(task: dict[str, Any], **rest: Any) -> dict[str, Any]:
    """Run `learn` on the fields of a `LibraryRun` in plain form."""
    return learn(LibraryRun(task=TaskSettings(**task), **rest))
