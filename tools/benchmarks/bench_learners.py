"""Every learner on two small tasks: processor speed, and the gap after a budget in frames.

python tools/benchmarks/bench_learners.py [--only td3] [--seed 0] [--out learners.csv]

`tests/train/algorithms/test_every_learner.py` trains the first case of each and checks its bound.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
import warnings
from pathlib import Path
from time import process_time
from types import SimpleNamespace
from typing import Any, NamedTuple

from train.kinds import KINDS, start
from train.machine import processor
from train.runs.folder import RUN, SELF_PLAY

TASKS: dict[str, dict[str, Any]] = {
    "maze 3x3, 1 goal": {"task": "maze", "maze": "3x3", "num_goals": 1},
    "maze 5x5, 3 goals": {"task": "maze", "maze": "5x5", "num_goals": 3},
    "chaser 3x3": {"task": "chase", "role": "chaser", "maze": "3x3"},
    "chaser 4x4": {"task": "chase", "role": "chaser", "maze": "4x4"},
    "arm, 1 joint": {"task": "reacher", "joints": 1},
    "arm, 2 joints": {"task": "reacher", "joints": 2},
    "team of 2, 3x3": {"task": "chase", "maze": "3x3", "num_chasers": 2},
    "team of 2, 4x4": {"task": "chase", "maze": "4x4", "num_chasers": 2},
    "self-play 2x2-tree": {"maze": "2x2-tree"},
    "self-play 3x3-tree": {"maze": "3x3-tree"},
}
DISCRETE = ["maze 3x3, 1 goal", "chaser 4x4"]
ARMS = ["arm, 1 joint", "arm, 2 joints"]
TEAMS = ["team of 2, 3x3", "team of 2, 4x4"]
DUELS = ["self-play 2x2-tree", "self-play 3x3-tree"]


class Case(NamedTuple):
    """A training with the default settings.

    Attributes:
        algorithm: of the learner.
        task: one of `TASKS`.
        frames: the budget.
        bound: of the gap. A learner without updates stays above it.
    """

    algorithm: str
    task: str
    frames: int
    bound: float


def _cases(algorithm: str, tasks: list[str], *limits: tuple[int, float]) -> list[Case]:
    return [Case(algorithm, task, *limit) for task, limit in zip(tasks, limits, strict=True)]


CASES = [
    *_cases("ppo", DISCRETE, (300_000, 0.5), (500_000, 0.5)),
    *_cases("sb3_ppo", DISCRETE, (300_000, 0.5), (500_000, 1.0)),
    *_cases("cleanrl_ppo", DISCRETE, (300_000, 0.5), (500_000, 1.0)),
    *_cases("a2c", DISCRETE, (300_000, 0.5), (600_000, 1.0)),
    *_cases("reinforce", DISCRETE, (300_000, 0.5), (1_000_000, 2.0)),
    *_cases("dqn", DISCRETE, (200_000, 0.5), (300_000, 1.0)),
    *_cases(
        "cross_entropy", ["maze 3x3, 1 goal", "chaser 3x3"], (4_500_000, 5.0), (4_000_000, 2.0)
    ),
    *_cases("q_learning", ["chaser 4x4", "maze 5x5, 3 goals"], (1_000_000, 0.5), (8_000_000, 0.5)),
    *_cases("ddpg", ARMS, (100_000, 5.0), (250_000, 5.0)),
    *_cases("td3", ARMS, (150_000, 3.0), (250_000, 5.0)),
    *_cases("sac", ARMS, (60_000, 2.0), (250_000, 5.0)),
    *_cases("mmd", DUELS, (400_000, 2.0), (600_000, 2.0)),
    *_cases("rnad", DUELS, (400_000, 3.0), (600_000, 3.0)),
    *_cases("nfsp", DUELS, (200_000, 5.0), (200_000, 5.0)),
    *_cases("ippo", TEAMS, (400_000, 0.3), (800_000, 0.15)),
    *_cases("mappo", TEAMS, (400_000, 0.3), (800_000, 0.15)),
    *_cases("iql", TEAMS, (400_000, 0.3), (800_000, 0.15)),
    *_cases("vdn", TEAMS, (400_000, 0.1), (800_000, 0.1)),
    *_cases("qmix", TEAMS, (400_000, 0.1), (800_000, 0.1)),
]


class Measured(NamedTuple):
    """The result of a case.

    Attributes:
        frames: environment steps.
        frames_per_second: of the processor, on one thread.
        gap: to the exact optimum as a fraction; in self-play NashConv in discounted steps.
    """

    frames: int
    frames_per_second: float
    gap: float


def measure(case: Case, seed: int = 0) -> Measured:
    """Train the learner of a case, without a curriculum, and evaluate its policy."""
    flat: dict[str, Any] = {
        "algorithm": case.algorithm,
        "frames": case.frames,
        "seed": seed,
        "threads": 1,
    }
    duel = case.task in DUELS
    if not duel:
        flat["curriculum"] = "none"
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kind = SELF_PLAY if duel else RUN
        settings = KINDS[kind].settings_of(**TASKS[case.task], **flat)
        run = start(kind, settings, Path(folder) / "run")
        trainee, warm, began = run.trainee, 0, process_time()
        while trainee.frames < case.frames:
            progress = trainee.frames / case.frames
            trainee.iterate(SimpleNamespace(progress=progress, scheduled=progress, seconds=0.0))
            if not warm:  # the first iteration compiles kernels
                warm, began = trainee.frames, process_time()
        seconds = process_time() - began
        found = trainee.evaluate()
    gap = found["nash_conv" if duel else "optimality_gap"]
    return Measured(trainee.frames, (trainee.frames - warm) / max(seconds, 1e-9), gap)


def main() -> None:
    """Print a row for every case, and write the rows to a file if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="cases with this in their algorithm or task")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="a CSV file for the rows")
    given = parser.parse_args()
    print(f"{processor()}, one thread; gap in %, of self-play NashConv in discounted steps")
    print(f"{'':<16}{'':<20}{'frames':>11}{'frames/s':>12}{'gap':>10}{'bound':>8}")
    rows = []
    for case in CASES:
        if given.only not in f"{case.algorithm}, {case.task}":
            continue
        found = measure(case, given.seed)
        scale = 1.0 if case.task in DUELS else 100.0
        print(
            f"{case.algorithm:<16}{case.task:<20}{found.frames:>11,}"
            f"{found.frames_per_second:>12,.0f}{scale * found.gap:>10.2f}"
            f"{scale * case.bound:>8.2f}",
            flush=True,
        )
        rows.append((case.algorithm, case.task, *found, case.bound, processor()))
    if given.out:
        names = ("algorithm", "task", *Measured._fields, "bound", "processor")
        with open(given.out, "w", newline="") as file:
            csv.writer(file).writerows([names, *rows])


if __name__ == "__main__":
    main()
