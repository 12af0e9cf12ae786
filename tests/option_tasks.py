"""Random tasks with all options of the rules, and random play of them beside the reference."""

from __future__ import annotations

from typing import Any

import networkx
import numpy as np
from random_mazes import connected_maze
from reference_options import Result, Rulebook

from pursuit.mazes.generation import generate_graph
from pursuit.mazes.maze import Maze, load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.rewards import Rewards
from pursuit.tasks.task import REWARD_SCHEMES, Task

ONE_WAY = Maze.from_graph(
    networkx.DiGraph([(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2), (2, 0), (1, 4)]),
    name="one-way",
)
TORUS = generate_graph("torus", 3, 3)
CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")


def random_maze(rng: np.random.Generator) -> Maze:
    mazes = (ONE_WAY, TORUS, CORRIDOR, load_maze("3x3-open"), generate_graph("eight", 3, 3))
    pick = int(rng.integers(2 * len(mazes)))
    return mazes[pick] if pick < len(mazes) else connected_maze(pick + int(rng.integers(99)), 3, 3)


def random_rewards(rng: np.random.Generator) -> Any:
    """A scheme, or coefficients of all kinds."""
    kind = int(rng.integers(3))
    if kind == 0:
        return str(rng.choice(list(REWARD_SCHEMES)))

    def coefficients(**more: Any) -> Rewards:
        numbers = dict(zip(("step", "capture", "goal", "escape"), rng.normal(size=4), strict=True))
        return Rewards(**numbers, **more)

    completion = bool(rng.integers(2))
    return {
        "chaser": coefficients(per_evader=True)
        if kind == 1
        else coefficients(on_completion=completion, touch=float(rng.normal())),
        "evader": coefficients(on_completion=completion),
        "runner": coefficients(),
    }


def random_task(rng: np.random.Generator, **fixed: Any) -> Task:
    """A valid task with random options."""
    while True:
        maze = random_maze(rng)
        chasers, evaders = int(rng.integers(1, 5)), int(rng.integers(1, 4))
        settings: dict[str, Any] = {
            "maze": maze,
            "num_chasers": chasers,
            "num_evaders": evaders,
            "num_runners": int(rng.choice([0, 0, 1, 2])),
            "num_goals": int(rng.choice([0, 0, 1, 2])),
            "max_steps": int(rng.integers(1, 9)),
            "stay_action": bool(rng.integers(2)),
            "move_order": str(rng.choice(["simultaneous", "chasers_first", "turns"])),
            "capture": str(rng.choice(["cell", "adjacent", "surround"])),
            "n_catch": int(rng.choice([1, 1, 2, 3])),
            "capture_check": str(rng.choice(["each_move", "after_chasers"])),
            "collisions": str(rng.choice(["share", "block"])),
            "rewards": random_rewards(rng),
        }
        kind = int(rng.integers(3))
        if kind == 1:
            settings["num_exits"] = int(rng.integers(1, 4))
        elif kind == 2:
            count = int(rng.integers(1, 4))
            settings["exits"] = rng.choice(maze.num_cells, count, replace=False).tolist()
        try:
            return Task(**settings | fixed)
        except ValueError:
            continue


def play_both(task: Task, rng: np.random.Generator, games: int = 6) -> list[Result]:
    """Whole games with random actions, by the simulator and the reference; they must agree."""
    simulator = Simulator(task, games, seed=int(rng.integers(2**32)), auto_restart=False)
    rules, results = Rulebook(task), []
    open_games = list(range(games))
    returns = np.zeros((games, task.num_agents))
    while open_games:
        before = [rules.read(simulator, game) for game in range(games)]
        actions = rng.integers(task.num_actions, size=(games, task.num_agents))
        stay = task.num_moves
        simulator.step(actions)
        for game in list(open_games):
            moves = tuple(
                int(a) if i in rules.movers(before[game]) else stay
                for i, a in enumerate(actions[game])
            )
            expected = rules.step(before[game], moves)
            said = f"{task}\n{before[game]}, {moves}"
            result = Result(
                rules.read(simulator, game),
                tuple(simulator.events[game].tolist()),
                tuple(simulator.rewards[game].tolist()),
                bool(simulator.terminated[game]),
                bool(simulator.truncated[game]),
            )
            near = np.allclose(result.rewards, expected.rewards, rtol=1e-5, atol=1e-5)
            assert near and result == expected._replace(rewards=result.rewards), (
                f"\n{result}\n{expected}\n{said}"
            )
            returns[game] += expected.rewards
            np.testing.assert_allclose(simulator.returns[game], returns[game], rtol=1e-5, atol=1e-5)
            if expected.terminated or expected.truncated:
                open_games.remove(game)
            results.append(expected)
    return results
