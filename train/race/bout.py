"""One bout: one contestant learns one task, on one core, judged at marks of its budget."""

from __future__ import annotations

import os
import signal
import traceback
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import torch

from train.evaluation.contest import GameContest
from train.evaluation.scores import BY_STEPS, Score, optimality_gap
from train.files import read_json, write_json, write_text
from train.machine import commit, processor
from train.race.contestants import Racer, contestant, settings_of
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
class Bout:
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


def learn(bout: Bout) -> dict[str, Any]:
    """Do a bout.

    The clock runs while games are played and learned from: not while anything is imported, compiled
    or evaluated. It ends with the last iteration that fits into the budget, if the next takes as
    long as the last did.

    Returns:
        "points": at every mark "seconds" of the bout's clock, "wall_seconds" and "cpu_seconds",
        "frames", "greedy" and "sampled" gaps, and the share of starts that they solve; what the
        bout was, and where.
    """
    entry = contestant(bout.contestant)
    world, contest, optimum = world_and_contest(bout.task, bout.episodes)
    settings = settings_of(bout.contestant, world, bout.drawn)
    torch.set_num_threads(1)
    keep_freed_memory()
    warm = entry.build(world, settings, WARM_UP_SEED)
    warm.iterate(0.0)
    point_of(warm, replace(contest, episodes=2), optimum)
    warm.close()
    budget = Budget(bout.seconds, bout.frames)
    marks = [n / EVALUATIONS for n in range(1, EVALUATIONS + 1)] if bout.watched else [1.0]
    marks = [marks[0] / 4, marks[0] / 2, *marks] if bout.watched else marks
    racer = entry.build(world, settings, bout.seed)
    torch.manual_seed(bout.seed)
    spent, seconds, points, over = dict.fromkeys(CLOCKS, 0.0), 0.0, [], False
    while not over:
        before, began, began_cpu = racer.frames, perf_counter(), process_time()
        racer.iterate(budget.progress(seconds, racer.frames))
        took = {"wall": perf_counter() - began, "cpu": process_time() - began_cpu}
        spent = {clock: spent[clock] + took[clock] for clock in CLOCKS}
        seconds, last, frames = spent[bout.clock], took[bout.clock], racer.frames - before
        over = (
            seconds + last > bout.seconds
            if bout.seconds is not None
            else racer.frames + frames > (bout.frames or 0)
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


# -- as files --------------------------------------------------------------------------------------


def bout_of(plain: dict[str, Any]) -> Bout:
    """What `plain_bout` gave."""
    return Bout(**{**plain, "task": TaskSettings(**plain["task"])})


def plain_bout(bout: Bout) -> dict[str, Any]:
    """A bout as plain values."""
    return asdict(bout)


def error_of(path: Path) -> Path:
    """Where it says why a bout failed."""
    return path.with_suffix(".error.txt")


def perform(request: Path, result: Path) -> None:
    """Do the bout that lies in a file; write its result, or why it failed."""
    plain = read_json(request)
    try:
        found = learn(bout_of(plain))
    except Exception:  # whatever a library raises: the race goes on, and the report says so
        write_text(error_of(result), traceback.format_exc())
        return
    write_json(result, {"bout": plain, **found})
    error_of(result).unlink(missing_ok=True)


def perform_alone(request: Path, result: Path, lane: int) -> None:
    """`perform` in a process of its own, on one core; Ctrl-C is for whoever started it.

    Args:
        request, result: the files.
        lane: bouts at the same time have different ones, and so different cores.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0), reverse=True)
        os.sched_setaffinity(0, {cores[lane % len(cores)]})
    perform(request, result)
