"""Speed beside environments of other libraries, in one run.

python tools/benchmarks/bench_peers.py [--seconds 0.5] [--turns 5] [--also FOLDER] [--csv FILE]

Steps of the environment (of all its agents) per second of processor time, actions at random,
measured in turns: the peer, ours with one game through the same kind of interface, and a batch of
our simulator. Agents observe in each step; of OpenSpiel's games there are no observations. Peers
that are not installed are left out. Most want older versions of NumPy or Gymnasium than this
package, but run beside it from a folder that is searched last:

    pip install --target FOLDER magent2 pogema jumanji mpe2 minigrid "setuptools<81"

POGEMA also needs pydantic before version 2, in a folder that is searched first (PYTHONPATH).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from bench_games import Copies, spiel_rate
from bench_observations import CHASERS, EVADERS, SIDE, stepping
from bench_simulator import simulator_step

from pursuit import chase_v0
from pursuit.mazes.generation import generate_maze
from pursuit.tasks.task import make_task
from train.files import write_csv
from train.machine import processor

Step = Callable[[], object]
Rate = Callable[[float], float]
GAME = "tic_tac_toe"


class Case(NamedTuple):
    """A task of another library, and one like it of ours.

    Attributes:
        peer: name of the environment.
        task: what is alike.
        rates: makes the functions from seconds to steps per processor second: of the "peer", of
            "one game" and of a "batch" of ours.
    """

    peer: str
    task: str
    rates: Callable[[], dict[str, Rate]]


def rate(step: Step, per_call: int = 1) -> Rate:
    """`per_call` times the calls per second of the processor."""

    def measured(seconds: float) -> float:
        calls, began = 0, process_time()
        while (took := process_time() - began) < seconds:
            step()
            calls += 1
        return calls * per_call / took

    return measured


def parallel(env: Any) -> Rate:
    """A PettingZoo environment, which begins anew when an episode ends."""
    env.reset(seed=0)
    most = {agent: env.action_space(agent).n for agent in env.possible_agents}
    drawn, turns = np.random.default_rng(0).random(4096).tolist(), count()

    def step() -> None:
        turn = next(turns)
        env.step({a: int(drawn[(turn + 7 * n) % 4096] * most[a]) for n, a in enumerate(env.agents)})
        if not env.agents:
            env.reset()

    return rate(step)


def single(env: gymnasium.Env[Any, Any]) -> Rate:
    """A Gymnasium environment, which begins anew when an episode ends."""
    env.reset(seed=0)
    most = env.action_space.n  # type: ignore[attr-defined]
    drawn, turns = np.random.default_rng(0).integers(most, size=4096).tolist(), count()

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(drawn[next(turns) % 4096])
        if terminated or truncated:
            env.reset()

    return rate(step)


def chase(games: int, observation: str, **options: Any) -> dict[str, Rate]:
    """Ours: one PettingZoo environment, and a batch of as many games."""
    env = chase_v0.parallel_env(observation=observation, max_steps=200, **options)
    task = make_task("chase", max_steps=200, **options)
    batch = rate(stepping(task, games, observation, "float32"), games)
    return {"one game": parallel(env), "batch": batch}


def runner(observation: str) -> dict[str, Rate]:
    """Ours: one Gymnasium environment of a runner with a goal, and a batch of 4096 games."""
    task = make_task("maze", maze="7x7", num_goals=1)
    env = gymnasium.make("pursuit/Maze-v0", maze="7x7", num_goals=1, observation=observation)
    batch = rate(stepping(task, 4096, observation, "float32"), 4096)
    return {"one game": single(env), "batch": batch}


def crowd() -> dict[str, Rate]:
    """Ours: a chase of the size of MAgent2's default."""
    maze = generate_maze("prim", height=SIDE, width=SIDE, loops=0.1, seed=0)
    return chase(16, "window:4", maze=maze, num_chasers=CHASERS, num_evaders=EVADERS)


def sisl_duel() -> dict[str, Rate]:
    from pettingzoo.sisl import pursuit_v5

    sizes = {"x_size": 7, "y_size": 7, "n_pursuers": 1, "n_evaders": 1, "n_catch": 1}
    env = pursuit_v5.parallel_env(max_cycles=200, **sizes)
    return {"peer": parallel(env), **chase(4096, "window:3", maze="7x7")}


def sisl_teams() -> dict[str, Rate]:
    from pettingzoo.sisl import pursuit_v5

    env = pursuit_v5.parallel_env(max_cycles=200)
    own = chase(64, "window:3", maze="pursuit_v5", num_chasers=8, num_evaders=30)
    return {"peer": parallel(env), **own}


def tag() -> dict[str, Rate]:
    from mpe2 import simple_tag_v3

    env = simple_tag_v3.parallel_env(
        num_good=1, num_adversaries=1, num_obstacles=2, max_cycles=200, dynamic_rescaling=False
    )
    return {"peer": parallel(env), **chase(4096, "one_hot", maze="7x7")}


def minigrid() -> dict[str, Rate]:
    import minigrid  # noqa: F401  (registers its ids)

    return {"peer": single(gymnasium.make("MiniGrid-Empty-8x8-v0")), **runner("window:3")}


def magent2() -> dict[str, Rate]:
    from magent2.environments import adversarial_pursuit_v4

    env = adversarial_pursuit_v4.parallel_env(map_size=SIDE, max_cycles=200)
    return {"peer": parallel(env), **crowd()}


def pogema() -> dict[str, Rate]:
    from pogema import GridConfig
    from pogema.envs import PogemaLifeLong  # its makers need an older Gymnasium

    agents = CHASERS + EVADERS
    config = GridConfig(
        num_agents=agents, size=SIDE, obs_radius=4, density=0.3, on_target="restart"
    )
    env: Any = PogemaLifeLong(config)  # whose episodes have no end
    env.reset(seed=0)
    drawn, turns = np.random.default_rng(0).integers(5, size=(64, agents)).tolist(), count()
    return {"peer": rate(lambda: env.step(drawn[next(turns) % 64])), **crowd()}


def jumanji() -> dict[str, Rate]:
    import jax
    from jumanji.environments import Maze
    from jumanji.environments.routing.maze.generator import RandomGenerator

    env = Maze(generator=RandomGenerator(num_rows=7, num_cols=7))
    games, length = 4096, 64
    state, _ = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), games))
    actions = jax.random.randint(jax.random.PRNGKey(1), (length, games), 0, 4)

    def one(state: Any, chosen: Any) -> Any:
        state, timestep = jax.vmap(env.step)(state, chosen)  # no new episodes, in its favour
        return state, timestep.observation.walls.sum()

    run = jax.jit(partial(jax.lax.scan, one))
    batch = rate(lambda: jax.block_until_ready(run(state, actions)), games * length)
    return {"peer": batch, "batch": runner("planes")["batch"]}


def openspiel() -> dict[str, Rate]:
    import pyspiel  # noqa: F401  (whether it is installed)

    copies = Copies(GAME, 4096)

    def step() -> None:
        copies.simulator.act(copies.agents, copies.actions)
        copies.simulator.step(copies.actions)

    return {"peer": partial(spiel_rate, GAME), "batch": rate(step, 4096)}


def alone() -> dict[str, Rate]:
    """Our simulator by itself, 4096 duels on 7x7."""
    kinds: dict[str, dict[str, Any]] = {
        "random actions": {"scripted": False},
        "scripted evader": {},
        "scripted evader, index": {"encoding": "index"},
        "scripted evader, one_hot": {"encoding": "one_hot"},
    }
    task = make_task("chase", maze="7x7")
    return {
        name: rate(simulator_step(task, 4096, **options), 4096) for name, options in kinds.items()
    }


CASES = (
    Case("Pursuit", "simulator, 1 against 1, 7x7, 4096 games", alone),
    Case("PettingZoo sisl pursuit_v5", "1 against 1, 7x7, radius 3", sisl_duel),
    Case("PettingZoo sisl pursuit_v5", "8 against 30, 16x16, radius 3", sisl_teams),
    Case("mpe2 simple_tag_v3", "1 against 1, the whole field", tag),
    Case("MiniGrid Empty-8x8", "one agent with a goal, a window", minigrid),
    Case("MAgent2 adversarial_pursuit_v4", f"{CHASERS} against {EVADERS}, {SIDE}x{SIDE}", magent2),
    Case("POGEMA", f"{CHASERS + EVADERS} agents, {SIDE}x{SIDE}, radius 4", pogema),
    Case("jumanji Maze, ×4096", "one agent with a goal, 7x7, the whole maze", jumanji),
    Case(f"OpenSpiel {GAME}", "random legal moves", openspiel),
)


def measured(cases: list[tuple[Case, dict[str, Rate]]], given: Any) -> Iterator[dict[str, Any]]:
    """A row for each measurement."""
    for turn in range(-1, given.turns):  # the first one compiles
        for case, rates in cases:
            for what, of in rates.items():
                found = of(given.seconds if turn >= 0 else 0.01)
                if turn >= 0:
                    row = {"peer": case.peer, "task": case.task, "what": what, "turn": turn}
                    yield row | {"steps_per_second": round(found, 1)}


def main() -> None:
    """Print all cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=0.5, help="of each measurement")
    parser.add_argument("--turns", type=int, default=5, help="measurements of each kind")
    parser.add_argument("--also", type=Path, help="a folder with further packages")
    parser.add_argument("--csv", type=Path, help="write all measurements to this file")
    given = parser.parse_args()
    if given.also:
        sys.path.append(str(given.also.resolve()))
    cases = []
    for case in CASES:
        try:
            cases.append((case, case.rates()))
        except ImportError as error:
            print(f"without {case.peer}, which is not installed ({error})")
    rows = []
    for row in measured(cases, given):
        rows.append(row)
        if given.csv:
            write_csv(given.csv, rows)  # at once: an interrupted run keeps its measurements
    print(f"{processor()}: steps per second of the processor, medians of {given.turns}")
    for case, rates in cases:
        own = {
            what: median(
                row["steps_per_second"]
                for row in rows
                if (row["peer"], row["task"], row["what"]) == (case.peer, case.task, what)
            )
            for what in rates
        }
        print(f"{case.peer}, {case.task}")
        for what, speed in own.items():
            print(f"    {what:<28}{speed:>14,.0f}")


if __name__ == "__main__":
    main()
