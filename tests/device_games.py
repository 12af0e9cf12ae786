"""Games that are played on the CPU and under Numba's simulator of a GPU, for tests to compare.

`python tests/device_games.py FILE CASE ...` plays these cases on the device and writes all that is
seen of them; `play(CASE, "cpu")` is the same on the CPU.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import pursuit
from pursuit.task import Rewards, Task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    OptimalChaser,
    OptimalEvader,
    RandomAgent,
)

PAID = {
    "chaser": Rewards(step=-0.25, capture=1.0, distance=-0.1),
    "evader": Rewards(step=0.5, capture=-1.0, distance=0.1),
    "runner": Rewards(step=-0.1, goal=1.0, distance=-0.3, on_completion=True),
}
RING = pursuit.Maze.from_text("+-+-+-+\n|     |\n+ +-+ +\n|S  #G|\n+ + + +\n|    G|\n+-+-+-+")


@dataclass(frozen=True)
class Case:
    """One task, who fills its seats (None: actions are drawn beforehand), and what is looked at."""

    task: Mapping[str, Any]
    policies: tuple[Any, ...]
    name: str = "chase"
    encodings: tuple[str, ...] = ("index",)
    settings: Mapping[str, Any] = field(default_factory=dict)
    auto_restart: bool = True
    later: float | None = None  # everybody's epsilon, from half of the steps on
    steps: int = 12
    games: int = 5
    tables: bool = True


GRIDS = ("one_hot", "positions", "cells", "walls", "planes", "window:1")
DUEL = {"maze": "3x3"}
CASES = {
    "duel": Case(
        DUEL, (AStarChaser(0.2), AStarEvader(0.3)), encodings=("index", "one_hot"), later=0.9
    ),
    "maze": Case({"maze": "3x3", "num_goals": 2}, (NearestGoalRunner(0.2),), "maze"),
    "race": Case({"maze": "3x3"}, (NearestGoalRunner(0.1), None), "race"),
    "encodings": Case(
        {"maze": ["3x3", RING], "num_goals": 2, "view_radius": 1, "unknown_maze": "chaser"},
        (RandomAgent(), AStarEvader(0.5)),
        "heist",
        ("index", *GRIDS),
        steps=6,
    ),
    # -- the rest is slow
    "plain encodings": Case({"maze": ["3x3", RING]}, (None, None), "heist", ("index", *GRIDS)),
    "chasers first": Case(
        {**DUEL, "move_order": "chasers_first", "stay_action": True, "rewards": PAID},
        (OptimalChaser(0.1), OptimalEvader()),
        steps=30,
    ),
    "stay": Case({**DUEL, "stay_action": True}, (None, AStarEvader(0.1)), steps=30),
    "teams": Case(
        {"maze": "5x5", "num_chasers": 2, "num_evaders": 2, "rewards": PAID, "max_steps": 9},
        (AStarChaser(), None, AStarEvader(), RandomAgent()),
        encodings=("index", "positions"),
        steps=30,
    ),
    "teams, chasers first": Case(
        {
            "maze": RING,
            "num_chasers": 2,
            "num_evaders": 2,
            "move_order": "chasers_first",
            "stay_action": True,
        },
        (AStarChaser(0.1), AStarChaser(0.3), AStarEvader(0.1), AStarEvader()),
        steps=30,
    ),
    "heist": Case(
        {"maze": RING, "start": "marks", "num_goals": 3, "rewards": PAID},
        (AStarChaser(0.4), NearestGoalRunner(0.2)),
        "heist",
        steps=30,
    ),
    "line of sight": Case(
        {"maze": "5x5", "line_of_sight": True, "num_goals": 2},
        (AStarChaser(0.3), None),
        "heist",
        ("index", *GRIDS),
    ),
    "race of three": Case(
        {"maze": "5x5", "num_runners": 3, "num_goals": 4, "rewards": PAID, "max_steps": 15},
        (NearestGoalRunner(), NearestGoalRunner(0.5), RandomAgent()),
        "race",
        steps=40,
    ),
    "zero sum": Case({**DUEL, "rewards": "zero_sum"}, (AStarChaser(0.2), RandomAgent()), steps=30),
    "completion": Case({"maze": "3x3", "rewards": "completion"}, (None,), "maze", steps=40),
    "apart": Case(
        {"maze": "5x5", "min_start_distance": 4}, (AStarChaser(), AStarEvader(0.2)), steps=30
    ),
    "rare starts": Case(
        {"maze": "9x9", "min_start_distance": 18, "max_steps": 4},
        (AStarChaser(), None),
        games=2,
        steps=10,
    ),
    "near goals": Case(
        {"maze": "5x5", "num_goals": 3},
        (NearestGoalRunner(),),
        "maze",
        settings={"goal_radius": 2, "num_goals": 2, "epsilon": 0.5},
        steps=30,
    ),
    "no restarts": Case(DUEL, (AStarChaser(), None), auto_restart=False, steps=40),
    "no tables": Case(
        {"maze": "5x5", "num_chasers": 2},
        (AStarChaser(0.2), AStarChaser(), AStarEvader(0.2)),
        tables=False,
        steps=12,
    ),
    "no tables, goals": Case(
        {"maze": "5x5", "num_goals": 3},
        (NearestGoalRunner(0.2),),
        "maze",
        settings={"goal_radius": 2},
        tables=False,
        steps=20,
    ),
}
QUICK = ("duel", "maze", "race", "encodings")


def play(name: str, device: str) -> dict[str, np.ndarray]:
    """Everything that is seen of a case: arrays by name, of every step."""
    case = CASES[name]
    if not case.tables and device != "cpu":  # of the CPU the test does it, and undoes it
        without_tables()
    task: Task = pursuit.make_task(case.name, **case.task)
    given = {"num_games": case.games, "seed": 7, "first_game": 3}
    games = pursuit.Simulator(task, **given, auto_restart=case.auto_restart, device=device)
    if case.settings:
        games.configure(**case.settings)
        games.reset()
    shape = (case.steps, case.games, task.num_agents)
    drawn = np.random.default_rng(1).integers(0, task.num_actions, shape).astype(np.int32)
    seen: dict[str, list[np.ndarray]] = {}

    def note(**arrays: Any) -> None:
        for key, array in arrays.items():
            seen.setdefault(f"{name}: {key}", []).append(np.array(on_host(array)))

    for step, actions in enumerate(drawn):
        if case.later is not None and step == case.steps // 2:
            change_epsilon(games, case.later, device)
        if device == "cpu":
            games.act(case.policies, actions)
            games.step(actions)
        else:
            games.actions.copy_to_device(actions)
            games.act(case.policies)
            games.step()
            actions = on_host(games.actions)
        cpu = device == "cpu"
        outcome = games._outcome if cpu else games.outcome
        note(actions=actions, **games.games._asdict())
        note(**{f"after {key}": part for key, part in outcome._asdict().items() if key != "final"})
        note(**{f"final {key}": part for key, part in outcome.final._asdict().items()})
        for encoding in case.encodings:
            final = games.observe_final if cpu else lambda *how: games.observe(*how, final=True)
            note(
                **{encoding: games.observe(encoding), f"one {encoding}": games.observe(encoding, 0)}
            )
            note(**{f"final {encoding}": final(encoding)})
    if device != "cpu":
        games.check()
    note(**{f"state {key}": array for key, array in vars(games.get_state()).items()})
    return {key: np.stack(arrays) for key, arrays in seen.items()}


def change_epsilon(games: Any, share: float, device: str) -> None:
    """Of all agents, from now on."""
    if device == "cpu":
        games.epsilon = share
    else:
        games.set_epsilon(share)


def on_host(array: Any) -> np.ndarray:
    """An array of the device on the host; one of the host as it is."""
    return array.copy_to_host() if hasattr(array, "copy_to_host") else np.asarray(array)


def without_tables() -> None:
    """From here on every maze counts as too large for a table of distances."""
    from pursuit import maze, maze_arrays, placements
    from scripted_agents import scripted

    for module in (maze, maze_arrays, placements, scripted):
        module.MAX_TABLE_CELLS = 10  # type: ignore[attr-defined]
    maze_arrays.lay_out.cache_clear()


def main(path: str, *names: str) -> None:
    from pursuit.device import kernels

    kernels.THREADS = 3  # several blocks, the last one not full
    with np.errstate(over="ignore"):
        seen = {key: array for name in names for key, array in play(name, "cuda").items()}
    np.savez(path, **seen)


if __name__ == "__main__":
    main(*sys.argv[1:])
