"""One run of a library: it learns one task on one core, and is judged at marks of its budget."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time
from typing import Any

import torch

from train.evaluation.contest import GameContest
from train.evaluation.scores import BY_STEPS, Score, optimality_gap
from train.experiments.comparison.contestants import Racer, contestant, settings_of
from train.machine import commit, processor
from train.runs.loop import Budget
from train.runs.threads import keep_freed_memory
from train.runs.worlds import GridWorld
from train.settings.checks import check
from train.settings.task import TaskSettings

EVALUATIONS = 20
"""Even marks of a budget; two more lie before the first, each at half of the one after it."""
CLOCKS = ("wall", "cpu")
"""Seconds of the wall, or of this process on its core: the same on an idle machine."""
WARM_UP_SEED = 2**31
"""Of the games that compile and load what a contestant needs, and are thrown away."""


@dataclass(frozen=True)
class LibraryRun:
    """What is to be done.

    Attributes:
        contestant: its name.
        task: what is learned.
        drawn: the settings that lie over the defaults of the contestant.
        seed: of games, weights and draws.
        seconds, frames: the budget, one of the two.
        episodes: of each evaluation.
        watched: whether it is judged at every mark, or at the end alone.
        clock: one of `CLOCKS`: what seconds are of.
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
    """The games of a task, what they are judged by, and the exact optimum.

    Raises:
        ValueError: a task whose optimum is not known, or in which many steps are good.
    """
    world = GridWorld(task)
    contest = world.contest(episodes)
    one = isinstance(contest, GameContest)
    check(one, f"maze={task.maze!r} is several mazes; a race is run in one: {task.maze}/0, say")
    assert isinstance(contest, GameContest)
    optimum = contest.optimal()
    check(
        optimum is not None and contest.measure == BY_STEPS,
        f"the {world.agent} of {task.task} in {task.maze}: a race needs an exact optimum and few "
        "steps to be good; take a runner of up to 15 goals, or a chaser of one evader",
    )
    assert optimum is not None
    return world, contest, optimum


def point_of(racer: Racer, contest: GameContest, optimum: Score) -> dict[str, float]:
    """How well a contestant plays now, greedily and as it draws."""
    found: dict[str, float] = {}
    with torch.random.fork_rng():
        for name, greedy in (("greedy", True), ("sampled", False)):
            score = contest.score(name, racer.policy(greedy))
            gap = optimality_gap(score, optimum)
            assert gap is not None
            found |= {name: gap, f"{name}_success": score.success_rate}
    return found


def learn(run: LibraryRun) -> dict[str, Any]:
    """Do a run.

    The clock runs while games are played and learned from: not while anything is imported, compiled
    or evaluated. It ends with the last iteration that fits into the budget, if the next takes as
    long as the last did.

    Returns:
        "points": at every mark "seconds" of the run's clock, "wall_seconds" and "cpu_seconds",
        "frames", "greedy" and "sampled" gaps, and the share of starts that they solve; what the
        run was, and where.
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
    racer = entry.build(world, settings, run.seed)
    torch.manual_seed(run.seed)
    spent, seconds, points, over = dict.fromkeys(CLOCKS, 0.0), 0.0, [], False
    while not over:
        before, began, began_cpu = racer.frames, perf_counter(), process_time()
        racer.iterate(budget.progress(seconds, racer.frames))
        took = {"wall": perf_counter() - began, "cpu": process_time() - began_cpu}
        spent = {clock: spent[clock] + took[clock] for clock in CLOCKS}
        seconds, last, frames = spent[run.clock], took[run.clock], racer.frames - before
        over = (
            seconds + last > run.seconds
            if run.seconds is not None
            else racer.frames + frames > (run.frames or 0)
        )
        if over or budget.progress(seconds, racer.frames) >= marks[0]:
            while len(marks) > 1 and marks[0] <= budget.progress(seconds, racer.frames):
                marks.pop(0)
            now = {"seconds": seconds, "frames": racer.frames}
            now |= {f"{clock}_seconds": each for clock, each in spent.items()}
            points.append(now | point_of(racer, contest, optimum))
    racer.close()
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
    """Do the run of these values, those of a `LibraryRun` in plain form."""
    return learn(LibraryRun(task=TaskSettings(**task), **rest))
