"""Compiles the kernels that most tests need, before the workers of pytest start.

    PYTHONPATH=. python tests/compile_kernels.py

Each of two processes compiles half of them to the cache on disk. Otherwise both workers compile a
kernel that both need at the same time.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from playthroughs import TASKS, policies_of

from pursuit import ReacherSimulator, ReacherTask, Simulator, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    best_response,
    best_team_response,
    evaluate_exactly,
    solve_chase,
    solve_hidden_chase,
    solve_joint,
)
from train.kinds import start
from train.runs.folder import RUN, SELF_PLAY
from train.runs.parts import settings_of
from train.self_play.parts import self_play_settings_of

ENCODINGS = ("index", "one_hot", "positions", "cells", "walls", "planes", "window:2")
OPTIONS = {"slip": 0.1, "collisions": "block", "capture": "adjacent", "stay_action": True}


def games() -> None:
    """Steps, observations and scripted agents of games of all sizes."""
    tasks = [task for task, _ in TASKS.values()]
    tasks += [make_task("chase", maze="3x3", **OPTIONS)]  # type: ignore[arg-type]
    tasks += [make_task("chase", maze="3x3", move_order="turns", stay_action=True)]
    for task in tasks:
        simulator = Simulator(task, 4, auto_restart=False)
        simulator.act(policies_of(task), actions := np.zeros((4, task.num_agents), np.int32))
        simulator.step(actions)
        simulator.reset(games=np.ones(4, bool))
        for encoding in ENCODINGS:
            simulator.observe(encoding, 0)
    arms = ReacherSimulator(ReacherTask(joints=2), 4)
    arms.step(np.zeros((4, 2)))


def solutions() -> None:
    """Exact solvers, and a few iterations of learners."""
    task = make_task("chase", maze="2x2")
    maze = task.mazes[0]
    evader, chaser = AStarEvader(0.2), AStarChaser(0.2)
    tables = [each.action_probabilities(maze) for each in (chaser, evader)]
    best_response("chaser", maze, tables[1], horizon=20)
    evaluate_exactly(maze, *tables, horizon=20)
    solve_chase(maze)
    pair = make_task("chase", maze="2x2", num_chasers=2)
    best_team_response(pair, "chaser", {"evader": evader}, horizon=20)
    solve_joint(pair, "chaser", {"evader": evader})
    solve_hidden_chase(maze, tables[1], view_radius=1, seconds=1.0)
    tiny = {"num_games": 8, "frames": 400, "threads": 1}
    with tempfile.TemporaryDirectory() as name:
        for algorithm in ("ppo", "q_learning", "cross_entropy"):
            small = {"population": 4, "elite_share": 0.5} if algorithm == "cross_entropy" else {}
            small |= {"rollout_steps": 5, "minibatch_size": 40} if algorithm == "ppo" else {}
            settings = settings_of(maze="3x3", algorithm=algorithm, **tiny, **small)
            start(RUN, settings, Path(name) / algorithm).train()
        pair_settings = self_play_settings_of(
            maze="2x2", snapshots=2, rollout_steps=5, minibatch_size=40, **tiny
        )
        start(SELF_PLAY, pair_settings, Path(name) / "pair").train()


HALVES: dict[str, Callable[[], None]] = {"games": games, "solutions": solutions}


def main() -> None:
    """One half, or both in processes of their own."""
    if len(sys.argv) > 1:
        warnings.simplefilter("ignore")
        HALVES[sys.argv[1]]()
        return
    children = [subprocess.Popen([sys.executable, __file__, name]) for name in HALVES]
    sys.exit(max([child.wait() for child in children]))


if __name__ == "__main__":
    main()
