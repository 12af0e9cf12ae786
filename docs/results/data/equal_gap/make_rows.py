"""Do different curricula leave different errors? Chasers of equal gap, compared state by state.

    python docs/results/data/equal_gap/make_rows.py

PPO learns in twelve mazes by three curricula with four seeds each, until the exact gap of its
sampled policy is at most 5 %. Writes runs.csv and pairs.csv into this folder, in which mazes with
rows are kept; analysis.py makes the tables of docs/results/equal_gap.md from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from scripted_agents import action_values
from train.evaluation.games import table_in
from train.experiments.analysis import module_at
from train.experiments.committed import read_table
from train.files import write_csv
from train.kinds import KINDS, start
from train.runs.folder import RUN

DATA = Path(__file__).parent
STUDY = module_at(DATA / "analysis.py")
MAZES = tuple(f"suite:5x5-test/{number:03}" for number in range(96, 108))
"""One of each kind of the suite."""
SEEDS = 4
Row = dict[str, Any]


def learn(maze: str, curriculum: str, seed: int) -> tuple[Row, NDArray[np.float64]]:
    """A run until its gap is small enough: its row, and [starts] by how many steps its action is
    worse than the best one, on average, in every pair of cells."""
    length = {} if curriculum == "none" else {"schedule_length": STUDY.LENGTH}
    settings = KINDS[RUN].settings_of(
        task="chase", role="chaser", maze=maze, evaluate="sampled", curriculum=curriculum,
        frames=STUDY.FRAMES, seed=seed, threads=1, **length,
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        run: Any = start(RUN, settings, Path(folder) / "run")
        trainee, gaps = run.trainee, [np.inf]

        def look(run: Any, row: dict[str, float]) -> None:
            if not row:  # after every iteration
                score = trainee.contest.score("learned", trainee.policy)
                gaps.append(score.mean_steps / trainee.optimum.mean_steps - 1.0)
                run.stopped = run.stopped or gaps[-1] <= STUDY.THRESHOLD

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
    runs, pairs = (
        read_table(path) if path.exists() else list[Row]()
        for path in (DATA / "runs.csv", DATA / "pairs.csv")
    )
    for maze in mazes:
        if any(row["maze"] == maze for row in runs):
            continue
        found = []
        for place, curriculum in enumerate(STUDY.CURRICULA):
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


if __name__ == "__main__":
    measure()
