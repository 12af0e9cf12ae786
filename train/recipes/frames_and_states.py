"""How many frames does it take to come within 1 % of the optimum, by the number of states?

    python -m train.recipes.frames_and_states --out frames_and_states

Generated mazes of growing size; in each a table (Q-learning) and a network (PPO) learn until what
they do greedily is first so near to the shortest tours. Then a line is laid through the logarithms
of frames and states, for each learner in each set of mazes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from pursuit.maze import load_maze
from pursuit.maze_generation import generate_maze
from scripted_agents import num_states
from scripted_agents.tour import MAX_EXACT_GOALS
from train.commands.parse import fail, parse
from train.experiments.kinds import start
from train.figures import pyplot, save
from train.files import write_csv, write_text
from train.reproduction.rules import Decision, correct, threshold_test
from train.result_table import ResultTable, words
from train.runs.by_name import settings_of
from train.runs.folder import RUN, check_new
from train.runs.loop import Run
from train.settings.checks import check

LEARNERS = {"table": "q_learning", "network": "ppo"}
ALIKE = "5x5"
"""The maze whose settings all sizes learn with, so that nothing but the maze grows."""
FINER = {"table": {"num_games": 64}}
"""A table learns from every game at once; with few games it can be looked at often."""
STARTS = 4096
"""Games that a policy is judged by, each against the shortest tour from the same start."""
STEP = 1.03
"""Frames between two looks grow by this, so times are known to 3 %."""
GROWS, LESS = 0.8, 0.5
"""What is claimed: frames of the table grow at least as states to this power; those of the network
as states to less than this times the table's power."""


@dataclass(frozen=True)
class Recipe:
    """Train tables and networks on generated mazes of growing size until they are near enough."""

    sizes: tuple[int, ...] = (3, 4, 5, 6, 7)
    """Rows, and columns, of the mazes."""
    num_goals: int = 2
    """Goals of every maze."""
    mazes: int = 5
    """Generated mazes of each size; that of one number in every size is a set, and their seed."""
    threshold: float = 0.01
    """The gap of the greedy policy, as a share of the optimum, at which a run ends."""
    table_frames: int = 400_000_000
    """Frames of a table at most."""
    network_frames: int = 12_000_000
    """Frames of a network at most; its learning rate falls over them, alike in every maze."""
    workers: int = 2
    """Runs at a time, each on a core of its own."""
    out: Path = Path("frames_and_states")
    """A new folder for the mazes, the runs, runs.csv, frames_and_states.png and report.md."""

    def __post_init__(self) -> None:
        check(len(self.sizes) >= 2, f"sizes={self.sizes}; at least two, or there is no line")
        check(min(self.sizes) >= 2, f"sizes={self.sizes}; from 2 on")
        check(len(set(self.sizes)) == len(self.sizes), f"sizes={self.sizes}; one is given twice")
        goals, most = self.num_goals, min(min(self.sizes) ** 2 - 1, MAX_EXACT_GOALS)
        check(1 <= goals <= most, f"num_goals={goals}; 1 to {most} in mazes of these sizes")
        for name in ("table_frames", "network_frames"):
            check(getattr(self, name) >= 1, f"{name}={getattr(self, name)}; at least 1")
        check(self.mazes >= 1, f"mazes={self.mazes}; at least 1")
        check(self.threshold > 0.0, f"threshold={self.threshold}; it is above 0")
        check(self.workers >= 1, f"workers={self.workers}; at least 1")

    def frames(self, learner: str) -> int:
        """The most of a learner."""
        return self.table_frames if learner == "table" else self.network_frames


@dataclass(frozen=True)
class Reached:
    """A run that has ended.

    Attributes:
        learner: of `LEARNERS`.
        size, number: of its maze.
        states: of the maze with its goals.
        frames: that it had taken when it was near enough, or all of them.
        gap: then, as a share of the optimum.
        reached: whether that is near enough.
    """

    learner: str
    size: int
    number: int
    states: int
    frames: int
    gap: float
    reached: bool


def maze_file(recipe: Recipe, size: int, number: int) -> Path:
    """The file of a generated maze, written: a tree with a tenth of its walls opened."""
    path = recipe.out / "mazes" / f"{size}x{size}-{number}.txt"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, generate_maze("wilson", size, loops=0.1, seed=number).to_text())
    return path


def learn(recipe: Recipe, job: tuple[str, int, int]) -> Reached:
    """Train a learner in a maze until its gap is small enough, or its frames are spent."""
    learner, size, number = job
    path = maze_file(recipe, size, number)
    flat: dict[str, Any] = {"task": "maze", "num_goals": recipe.num_goals, "curriculum": "none"}
    flat |= {"algorithm": LEARNERS[learner], "frames": recipe.frames(learner), "threads": 1}
    alike = asdict(settings_of(**flat, maze=ALIKE).hyper) | FINER.get(learner, {})
    settings = settings_of(**flat, **alike, maze=str(path), seed=number)
    run = start(RUN, settings, recipe.out / f"{learner}-{size}x{size}-{number}")
    contest, policy = replace(run.trainee.contest, episodes=STARTS), run.trainee.policy
    optimum = contest.optimal_lengths()
    assert optimum is not None  # of a maze
    gap, next_look = float("inf"), 0.0

    def look(run: Run, row: dict[str, float]) -> None:
        """After a rollout: is it good enough?"""
        nonlocal gap, next_look
        if not row and run.trainee.frames >= next_look:
            gap = float(contest.lengths(policy).sum() / optimum.sum()) - 1.0
            next_look = STEP * run.trainee.frames
            run.stopped = run.stopped or gap <= recipe.threshold

    run.train(look)
    run.lock.release()
    if run.exit_status:
        raise KeyboardInterrupt
    gap = float(contest.lengths(policy).sum() / optimum.sum()) - 1.0
    states = num_states(load_maze(path).num_cells, recipe.num_goals)
    near = gap <= recipe.threshold
    return Reached(learner, size, number, states, run.trainee.frames, gap, near)


def power(runs: Sequence[Reached]) -> float:
    """Of states that frames grow as: the slope of the line through their logarithms.

    A run that was never near enough counts with all of its frames, so where that is the largest
    maze the slope is one from below.
    """
    states, frames = (np.log([getattr(run, name) for run in runs]) for name in ("states", "frames"))
    return float(np.polyfit(states, frames, 1)[0])


def powers(runs: Sequence[Reached]) -> dict[str, dict[int, float]]:
    """By learner, and the number of the set of mazes."""
    numbers = sorted({run.number for run in runs})
    return {
        learner: {
            n: power([run for run in runs if (run.learner, run.number) == (learner, n)])
            for n in numbers
        }
        for learner in LEARNERS
    }


def verdicts(runs: Sequence[Reached]) -> list[str]:
    """What came of the two claims, which were written before the runs: a line each.

    Each is decided by the sign test over the sets of mazes, corrected for two claims (Holm).
    """
    found = powers(runs)
    never = {run.number for run in runs if run.learner == "network" and not run.reached}
    says = {
        f"frames of the table grow at least as states to the power of {GROWS}": {
            n: slope >= GROWS for n, slope in found["table"].items()
        },
        f"the power of the network is less than {LESS} times that of the table": {
            n: n not in never and slope < LESS * found["table"][n]
            for n, slope in found["network"].items()
        },
    }
    tests = [threshold_test(list(said.values())) for said in says.values()]
    decided = correct([Decision(test=test) for test in tests])
    return [
        f"{claim}: {found.verdict}, {sum(said.values())} of {len(said)} (p = {found.test.p:.2g})"
        for (claim, said), found in zip(says.items(), decided, strict=True)
    ]


def draw(runs: Sequence[Reached], recipe: Recipe) -> None:
    """Frames over states, a point a run; hollow where it was never near enough."""
    figure, axes = pyplot().subplots(figsize=(6.0, 4.0), layout="constrained")
    for colour, learner in zip(("C0", "C1"), LEARNERS, strict=True):
        own = [run for run in runs if run.learner == learner]
        for near in (True, False):
            part = [run for run in own if run.reached is near]
            if part:
                axes.scatter(
                    [run.states for run in part],
                    [run.frames for run in part],
                    s=22,
                    facecolors=colour if near else "none",
                    edgecolors=colour,
                    label=f"{learner} ({LEARNERS[learner]})" + ("" if near else ", not reached"),
                )
    axes.set(xscale="log", yscale="log", xlabel="states")
    axes.set_ylabel(f"frames to a gap of {100 * recipe.threshold:g} %")
    axes.legend(frameon=False)
    save(figure, recipe.out / "frames_and_states.png")


def report(runs: Sequence[Reached], recipe: Recipe) -> list[str]:
    """Write the tables and the figure; the lines that say what came out."""
    rows = [asdict(run) for run in runs]
    write_csv(recipe.out / "runs.csv", rows)
    slopes = powers(runs)
    sizes: list[dict[str, Any]] = []
    for learner in LEARNERS:
        for size in recipe.sizes:
            own = [run for run in runs if (run.learner, run.size) == (learner, size)]
            told = [f"{run.frames:,}" if run.reached else f"> {run.frames:,}" for run in own]
            sizes.append({"learner": learner, "maze": f"{size}x{size}"})
            sizes[-1] |= {"states": f"{own[0].states:,}", "frames": "; ".join(told)}
    near = words("learner"), words("maze"), words("states"), words("frames")
    lines = [ResultTable(sizes, list(near)).markdown(), ""]
    found = [
        {"learner": name} | {f"power, set {n}": f"{slope:.2f}" for n, slope in own.items()}
        for name, own in slopes.items()
    ]
    lines.append(ResultTable(found, [words(head) for head in found[0]]).markdown())
    lines += ["", *verdicts(runs)]
    draw(runs, recipe)
    write_text(recipe.out / "report.md", "# Frames and states\n\n" + "\n".join(lines) + "\n")
    return lines


def run(recipe: Recipe) -> None:
    """Train all, and lay the lines."""
    check_new(recipe.out)
    recipe.out.mkdir(parents=True, exist_ok=True)
    numbers = range(recipe.mazes)
    jobs = [(name, size, n) for n in numbers for size in recipe.sizes for name in LEARNERS]
    found: list[Reached] = []
    # Spawned: torch's threads do not survive a fork.
    with ProcessPoolExecutor(min(recipe.workers, len(jobs)), get_context("spawn")) as pool:
        for each in pool.map(partial(learn, recipe), jobs):
            found.append(each)
            maze = f"{each.size}x{each.size}, maze {each.number}"
            gap = f"gap {100 * each.gap:.2f} %{'' if each.reached else ', not reached'}"
            print(
                f"{len(found)} of {len(jobs)}: {each.learner}, {maze}, {each.states:,} states: "
                f"{each.frames:,} frames, {gap}",
                flush=True,
            )
    print("\n".join(["", *report(found, recipe)]))


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line; errors are one line and exit status 2."""
    try:
        run(parse(Recipe, sys.argv[1:] if arguments is None else arguments, "recipe"))
    except (ValueError, OSError, ImportError) as error:
        fail(str(error))


if __name__ == "__main__":
    main()
