"""Speed of exact solutions, exploitability, pools and training; also against another version.

python tools/benchmarks/bench_self_play.py
python tools/benchmarks/bench_self_play.py --against 400a755 [--turns 7] [--only 2v2] [--seconds 1]

`--against` compares this version with another one: processor seconds per million frames of both
sides, on one thread.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from in_turns import add_options, compare

from pursuit.mazes.maze import load_maze
from scripted_agents import cop_number, solve_chase, solve_in_turns
from scripted_agents.exact.joint import equilibrium
from train.evaluation.exploitability import exploitability
from train.kinds import start
from train.runs.folder import SELF_PLAY
from train.runs.loop import Run
from train.self_play.parts import self_play_settings_of
from train.settings.self_play import SelfPlaySettings
from train.settings.task import TaskSettings


def seconds(call: Any) -> float:
    """Duration of one call."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def exact_game() -> None:
    """Times of the solvers, without caches."""
    solve_chase(load_maze("2x2"))
    for name in ("5x5", "7x7", "9x9", "9x9-tree", "15x15", "15x15-tree"):
        maze = load_maze(name)
        equilibrium._kept.clear()
        print(f"solve_chase {name}, discount 0.95: {seconds(lambda m=maze: solve_chase(m)):.2f} s")
    maze = load_maze("5x5")
    print(f"solve_chase 5x5, 2 chasers: {seconds(lambda: solve_chase(maze, num_chasers=2)):.2f} s")
    for name in ("9x9", "15x15"):
        maze = load_maze(name)
        print(f"cop_number {name}: {seconds(lambda m=maze: cop_number(m)):.2f} s")
    maze = load_maze("9x9")
    print(f"solve_in_turns 9x9, 3 chasers: {seconds(lambda: solve_in_turns(maze, 3)):.2f} s")


def exploitabilities(folder: Path) -> None:
    """The time of a checkpoint's exploitability, including forward passes."""
    for name in ("5x5", "7x7", "9x9", "15x15"):
        task = TaskSettings(maze=name, rewards="zero_sum")
        run = start(SELF_PLAY, SelfPlaySettings(task=task, frames=1), folder / name)
        maze = run.trainee.game.task.mazes[0]

        def whole(run: Run = run, maze: Any = maze) -> None:
            tables = [
                run.trainee.policy(r).action_probabilities(maze) for r in ("chaser", "evader")
            ]  # type: ignore[attr-defined]
            exploitability(maze, tables[0], tables[1])

        equilibrium._kept.clear()
        first = seconds(whole)
        print(
            f"exploitability {name}: {first:.2f} s; the game solved before, {seconds(whole):.2f} s"
        )


def pools(folder: Path) -> None:
    """Frames per second against pools of 1 and 16 opponents, alternating, medians of three."""
    speeds: dict[int, list[float]] = {1: [], 16: []}
    for repeat in range(3):
        for size in speeds:
            settings = self_play_settings_of(
                maze="5x5", num_games=1024, minibatch_size=4096, frames=1, sampling="uniform"
            )
            game = start(SELF_PLAY, settings, folder / f"{size}-{repeat}").trainee
            for number in range(size - 1):
                for role, side in game.sides.items():
                    game.pools[role].add(f"{number}", side.snapshot(), game.rng)
            game._update_sampling()
            for side in game.sides.values():
                side.learner.iterate(0.0)
            before, began = game.frames, time.perf_counter()
            for _ in range(12):
                for side in game.sides.values():
                    side.learner.iterate(0.0)
            speeds[size].append((game.frames - before) / (time.perf_counter() - began))
    one, many = (sorted(speeds[size])[1] for size in (1, 16))
    print(f"training, 1024 games, one opponent: {one / 1e3:.1f} k frames/s")
    print(f"the same with a pool of 16: {many / 1e3:.1f} k frames/s, {100 * many / one:.0f} %")


# Runs in both versions, so it uses only names that exist in both.
MEASURE = """
import json, sys, tempfile, warnings
from pathlib import Path
from time import process_time
import torch
from train import start
from train.runs.folder import SELF_PLAY
from train.self_play.parts import self_play_settings_of
warnings.simplefilter("ignore")
torch.set_num_threads(1)
cases = {"1v1, 5x5": (1, 1), "2v1, 5x5": (2, 1), "2v2, 5x5": (2, 2), "4v4, 5x5": (4, 4)}
print(json.dumps(list(cases)), flush=True)
made = {}
for line in sys.stdin:
    name, seconds = json.loads(line)
    if name not in made:
        chasers, evaders = cases[name]
        teams = {"num_chasers": chasers, "num_evaders": evaders}
        size = {"num_games": 1024, "minibatch_size": 4096, "frames": 1}
        settings = self_play_settings_of(maze="5x5", rewards="default", **teams, **size)
        made[name] = start(SELF_PLAY, settings, Path(tempfile.mkdtemp()) / "run").trainee
    game = made[name]
    frames, began = game.frames, process_time()
    while process_time() - began < seconds or game.frames == frames:
        for side in game.sides.values():
            side.learner.iterate(0.0)
    print(json.dumps((process_time() - began) / (game.frames - frames) * 1e6), flush=True)
"""


def main() -> None:
    """Run all benchmarks, or the comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_options(parser)
    parser.add_argument("--seconds", type=float, default=1.0, help="time of each measurement")
    given = parser.parse_args()
    if given.against:
        what = "s of the processor for a million frames"
        compare(MEASURE, given.against, given.seconds, given.turns, given.only, what)
        return
    torch.set_num_threads(1)
    exact_game()
    with TemporaryDirectory() as folder:
        exploitabilities(Path(folder) / "exact")
        pools(Path(folder) / "pools")


if __name__ == "__main__":
    main()
