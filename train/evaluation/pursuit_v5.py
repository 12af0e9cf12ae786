"""Policies of chasers, learned or scripted, inside PettingZoo's own `pursuit_v5`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.observations.custom import AGENT_ID, without_id
from pursuit.observations.pursuit_v5 import PURSUIT_V5_ACTIONS
from pursuit.rules.arrays import Array
from pursuit.simulator.policy import GameView, play, role_of
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from pursuit.validation import check, whole
from scripted_agents.agents.scripted import Scripted
from train.evaluation.games import half_width
from train.files import Plain

ENCODINGS = ("pursuit_v5", "pursuit_v5_flat")
"""Of policies that play there: also with the number of the agent ("+id")."""


@dataclass(frozen=True, eq=False)
class PursuitV5Episodes:
    """Episodes in `pursuit_v5`.

    Attributes:
        returns: [episodes, pursuers] float64, the sum of the rewards of each pursuer.
        steps: [episodes] int64, cycles.
        caught: [episodes] int64, evaders.
    """

    returns: NDArray[np.float64]
    steps: NDArray[np.int64]
    caught: NDArray[np.int64]

    def summary(self) -> Plain:
        """Means over the episodes; `ci95` is half the width of the 95 % interval of `mean_return`.

        `mean_return` is that of one agent, the mean over all of them; `total_return` the sum over
        the agents.
        """
        own = self.returns.mean(axis=1)
        return {
            "episodes": len(own),
            "mean_return": float(own.mean()),
            "ci95": half_width(own),
            "total_return": float(self.returns.sum(axis=1).mean()),
            "mean_steps": float(self.steps.mean()),
            "mean_caught": float(self.caught.mean()),
        }


def play_pursuit_v5(
    policy: Any, episodes: int = 100, seed: int = 0, **arguments: Any
) -> PursuitV5Episodes:
    """Play all pursuers by one policy in `pettingzoo.sisl.pursuit_v5.parallel_env(**arguments)`.

    A trained policy receives the environment's observations and nothing else; a scripted agent the
    cells of all agents, of which `GatheringTeam` uses those in its window.

    Args:
        policy: of chasers, trained with the observation `pursuit_v5`, as of `load_policy`; or a
            scripted agent such as `GatheringTeam()`.
        episodes: their number; episode i is reset with the seed `seed` + i.
        seed: of the episodes, and of the draws of a policy that is not greedy.
        **arguments: of the environment; none for its defaults.

    Raises:
        ValueError: another observation or role, another number of agents or actions, or a window of
            a scripted agent that is larger than that of the environment.
    """
    envs = environments(whole("episodes", episodes, 1), **arguments)
    task = check_plays_pursuit_v5(policy, envs[0])
    most = max(task.num_chasers, task.num_evaders)
    # Games that are never played: their views have the random streams and the number of steps, and
    # for scripted agents the cells of the agents in the environments.
    games = Simulator(task, episodes, seed, auto_restart=False)
    theirs = np.argsort(PURSUIT_V5_ACTIONS)  # its action by ours
    latest: list[Array] = []

    def view_of(seat: int) -> GameView:
        return replace(games.view(seat), observe=lambda form: encoded(latest[0], seat, form, most))

    # Views are kept, as policies with memory have one memory for each.
    views = [view_of(seat) for seat in range(len(envs[0].possible_agents))]

    def choose(seen: Array) -> Array:
        latest[:] = [seen]
        if isinstance(policy, Scripted):
            for number, env in enumerate(envs):
                copy_cells(env, games, number)
        actions = np.stack([play(policy, view) for view in views], axis=1)
        games.steps[:] += 1
        return np.asarray(theirs[actions])

    return play_episodes(envs, choose, seed)


def encoded(seen: Array, seat: int, encoding: str, most: int) -> Array:
    """[episodes, *shape]: the observations of a pursuer in an encoding of `ENCODINGS`.

    Args:
        seen: [episodes, pursuers, rows, columns, 3], the environment's.
        seat: the number of the pursuer.
        encoding: with or without "+id".
        most: the agents of the largest role, for "+id".
    """
    own = seen[:, seat]
    if without_id(encoding) == ENCODINGS[1]:
        own = own.reshape(len(own), -1)
    if not encoding.endswith(AGENT_ID):
        return own
    ids = np.zeros((len(own), most, *own.shape[2:]), dtype=own.dtype)
    ids[:, seat] = 1.0
    return np.concatenate([own, ids], axis=1)


def environments(count: int, **arguments: Any) -> list[Any]:
    """New environments `pettingzoo.sisl.pursuit_v5.parallel_env(**arguments)`."""
    # Imported by another name, as that one warns that it is deprecated; it imports pygame.
    from pettingzoo.sisl.pursuit.pursuit import parallel_env

    return [parallel_env(**arguments) for _ in range(count)]


def play_episodes(
    envs: list[Any], choose: Callable[[Array], Array], seed: int
) -> PursuitV5Episodes:
    """One episode in each environment, number i with the seed `seed` + i.

    Args:
        envs: as of `environments`.
        choose: the environment's actions [episodes, pursuers] from its observations [episodes,
            pursuers, rows, columns, 3]; also called for the last observations of ended episodes.
        seed: of the first episode.
    """
    names = envs[0].possible_agents

    def by_name(found: Plain) -> list[Any]:
        return [found[name] for name in names]

    seen = np.array([by_name(env.reset(seed + i)[0]) for i, env in enumerate(envs)])
    returns, steps = np.zeros((len(envs), len(names))), np.zeros(len(envs), dtype=np.int64)
    while any(env.agents for env in envs):
        actions = choose(seen).tolist()
        for i, env in enumerate(envs):
            if env.agents:
                observed, rewards, *_ = env.step(dict(zip(names, actions[i], strict=True)))
                seen[i], steps[i] = by_name(observed), steps[i] + 1
                returns[i] += by_name(rewards)
    caught = np.array([env.unwrapped.env.evaders_gone.sum() for env in envs])
    return PursuitV5Episodes(returns, steps, caught)


def copy_cells(env: Any, games: Simulator, number: int) -> None:
    """Copy the cells of all agents, and which evaders are free, to the game of this number."""
    base, cells = env.unwrapped.env, games.task.mazes[0].cell_numbers
    layers = base.pursuer_layer, base.evader_layer
    x, y = np.array([layer.get_position(i) for layer in layers for i in range(layer.n_agents())]).T
    free = np.append(np.ones(games.task.num_chasers, dtype=bool), ~base.evaders_gone)
    games.active[number] = free
    games.positions[number, free] = cells[y, x]  # its arrays are [x, y], ours [row, column]


def task_of(env: Any) -> Task:
    """The game of a `pursuit_v5` as a task, but for the rewards."""
    base = env.unwrapped.env
    walkable = base.map_matrix.T == 0
    height, width = walkable.shape
    open_south = np.ones((height - 1, width), dtype=bool)
    open_east = np.ones((height, width - 1), dtype=bool)
    return Task(
        Maze(walkable, open_south, open_east, name=ENCODINGS[0]),
        num_chasers=base.n_pursuers,
        num_evaders=base.n_evaders,
        stay_action=True,
        move_order="chasers_first",
        capture_check="after_chasers",
        capture="surround" if base.surround else "cell",
        n_catch=1 if base.surround else base.n_catch,
        max_steps=base.max_cycles,
    )


def check_plays_pursuit_v5(policy: Any, env: Any) -> Task:
    """The task that the policy was trained in, for a scripted agent that of `env`; ValueError
    unless the policy fits this `pursuit_v5`."""
    if isinstance(policy, Scripted):
        check(
            role_of(policy) in (None, "chaser"),
            f"{policy!r} plays {role_of(policy)}s, but pursuers are chasers; give GatheringTeam() "
            "or another chaser",
        )
        own, its = getattr(policy, "obs_range", 0), env.unwrapped.env.obs_range
        check(
            own <= its,
            f"obs_range={own} of {policy!r}, but pursuers of this pursuit_v5 see {its} rows and "
            "columns; give it at most as many",
        )
        return task_of(env)
    remedy = "; train with --preset sisl-pursuit, or with the agents and actions of this one"
    seat = getattr(policy, "seat", policy)
    encoding, own = getattr(seat, "encoding", None), getattr(seat, "agent", type(policy).__name__)
    check(
        without_id(str(encoding)) in ENCODINGS and role_of(policy) == "chaser",
        f"the policy of {own} observes {encoding!r}, but pursuers of pursuit_v5 "
        f"see {' or '.join(map(repr, ENCODINGS))}{remedy}",
    )
    task: Task = policy.task
    space = env.observation_space(env.possible_agents[0])
    own = Simulator(task).encoder(without_id(policy.encoding)).space
    counts = {
        "pursuers": (task.num_chasers, len(env.possible_agents)),
        "actions": (task.num_actions, len(PURSUIT_V5_ACTIONS)),
        "numbers observed": (math.prod(own.shape), math.prod(space.shape)),
    }
    for what, (mine, its) in counts.items():
        check(mine == its, f"{what} of the policy: {mine}, of this pursuit_v5: {its}{remedy}")
    check(not policy.seat.has_masks, f"mask_bumps needs the walls around the agent{remedy}")
    return task
