"""Do different curricula leave different errors? Chasers of equal gap, compared state by state.

    python tools/equal_gap.py

PPO learns in twelve mazes by three curricula with four seeds each, until the exact gap of its
sampled policy is at most 5 %. Writes runs.csv and pairs.csv into docs/results/data/equal_gap/, in
which mazes with rows are kept, and prints the tables of docs/results/equal_gap.md. A test compares
the page with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, combinations_with_replacement
from pathlib import Path
from statistics import fmean, median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from scripted_agents import action_values
from train.evaluation.games import table_in
from train.experiments.statistics import holm, mean_interval, sign_flip_p
from train.files import read_csv, write_csv
from train.kinds import KINDS, start
from train.reports.tables import plain_table
from train.runs.folder import RUN

DATA = Path(__file__).parents[1] / "docs" / "results" / "data" / "equal_gap"
MAZES = tuple(f"suite:5x5-test/{number:03}" for number in range(96, 108))
"""One of each kind of the suite."""
CURRICULA = ("none", "start-distance", "opponent-epsilon")
SEEDS, FRAMES, THRESHOLD = 4, 1_000_000, 0.05
LENGTH = 0.1
"""Of the curricula, as a share of the frames, so that most runs stop in the task itself."""
CLAIMS = {
    "all three curricula": CURRICULA,
    "none and start-distance alone": CURRICULA[:2],
}
"""By name the curricula between which runs are compared; the first is the primary one."""
Row = dict[str, Any]


def learn(maze: str, curriculum: str, seed: int) -> tuple[Row, NDArray[np.float64]]:
    """A run until its gap is small enough: its row, and [starts] by how many steps its action is
    worse than the best one, on average, in every pair of cells."""
    length = {} if curriculum == "none" else {"schedule_length": LENGTH}
    settings = KINDS[RUN].settings_of(
        task="chase", role="chaser", maze=maze, evaluate="sampled", curriculum=curriculum,
        frames=FRAMES, seed=seed, threads=1, **length,
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        run: Any = start(RUN, settings, Path(folder) / "run")
        trainee, gaps = run.trainee, [np.inf]

        def look(run: Any, row: dict[str, float]) -> None:
            if not row:  # after every iteration
                score = trainee.contest.score("learned", trainee.policy)
                gaps.append(score.mean_steps / trainee.optimum.mean_steps - 1.0)
                run.stopped = run.stopped or gaps[-1] <= THRESHOLD

        run.train(look)
    contest = trainee.contest
    task, cells = contest.task, contest.task.mazes[0]
    other, table = contest.opponent_table(), table_in(task, trainee.policy)
    best = action_values("chaser", cells, other, task.max_steps)
    loss = ((best.steps - best.values[:, :, None]) * table).sum(axis=2)
    row = {"maze": maze, "curriculum": curriculum, "seed": seed}
    row |= {"frames": trainee.frames, "gap": gaps[-1]}
    return row, loss[~np.eye(cells.num_cells, dtype=bool)]


def measure(mazes: Sequence[str] = MAZES) -> None:
    """Execute the runs of mazes without rows, and write the rows of a maze once it is complete."""
    DATA.mkdir(parents=True, exist_ok=True)
    runs, pairs = rows_of("runs"), rows_of("pairs")
    for maze in mazes:
        if any(row["maze"] == maze for row in runs):
            continue
        found = []
        for place, curriculum in enumerate(CURRICULA):
            # No two runs of a maze have equal initial weights.
            seeds = range(SEEDS * place, SEEDS * (place + 1))
            found += [learn(maze, curriculum, seed) for seed in seeds]
        for (one, its), (two, others) in combinations(found, 2):
            pair = {"maze": maze, "one": one["curriculum"], "one_seed": one["seed"]}
            pair |= {"two": two["curriculum"], "two_seed": two["seed"]}
            pairs.append(pair | {"spearman": float(spearmanr(its, others).statistic)})
        runs += [row for row, _ in found]
        write_csv(DATA / "pairs.csv", pairs)
        write_csv(DATA / "runs.csv", runs)
        print(f"{maze}: {len(found)} runs", flush=True)


def rows_of(name: str) -> list[Row]:
    """The rows of a file; nothing if there is none."""
    path = DATA / f"{name}.csv"
    return [dict(row) for row in read_csv(path)] if path.exists() else []


def similarity(pairs: Sequence[Row], maze: str, one: str, two: str) -> float:
    """The mean correlation of runs of two curricula, or of one, in a maze."""
    return fmean(
        float(row["spearman"])
        for row in pairs
        if row["maze"] == maze and sorted((row["one"], row["two"])) == sorted((one, two))
    )


def differences(pairs: Sequence[Row], curricula: Sequence[str]) -> list[float]:
    """Of every maze the mean similarity within a curriculum minus that between two."""
    found = []
    for maze in dict.fromkeys(row["maze"] for row in pairs):
        within = fmean(similarity(pairs, maze, name, name) for name in curricula)
        between = fmean(similarity(pairs, maze, *both) for both in combinations(curricula, 2))
        found.append(within - between)
    return found


def tables() -> list[str]:
    """The tables of the page as Markdown."""
    runs, pairs = rows_of("runs"), rows_of("pairs")
    mazes = list(dict.fromkeys(row["maze"] for row in runs))
    alike = [
        {"curricula": " and ".join(dict.fromkeys(both)),
         "similarity": f"{fmean(similarity(pairs, maze, *both) for maze in mazes):.3f}"}
        for both in combinations_with_replacement(CURRICULA, 2)
    ]  # fmt: skip
    ends = []
    for name in CURRICULA:
        own = [row for row in runs if row["curriculum"] == name]
        frames = sorted(int(row["frames"]) for row in own)
        reached = sum(float(row["gap"]) <= THRESHOLD for row in own)
        early = 0 if name == "none" else sum(count < LENGTH * FRAMES for count in frames)
        line = {"curriculum": name, "runs": f"{len(own)}", "to 5 %": f"{reached}"}
        line["stopped before its end"] = f"{early}"
        ends.append(line | {"frames, median": f"{median(frames):,.0f}",
                            "least to most": f"{frames[0]:,} to {frames[-1]:,}"})  # fmt: skip
    values = {name: differences(pairs, own) for name, own in CLAIMS.items()}
    claims = []
    for (name, own), p in zip(values.items(), holm([sign_flip_p(own) for own in values.values()]),
                              strict=True):  # fmt: skip
        low, high = mean_interval([own])
        line = {"within minus between": name}
        line["mean [95 %]"] = f"{fmean(own):.3f} [{low:.3f}, {high:.3f}]"
        line["mazes above 0"] = f"{sum(value > 0 for value in own)} of {len(own)}"
        claims.append(line | {"p": f"{p:.2g}"})
    return [plain_table(rows).markdown() for rows in (claims, alike, ends)]


def main() -> None:
    """Execute what is missing, and print the tables."""
    measure()
    print("\n\n".join(tables()))


if __name__ == "__main__":
    main()
