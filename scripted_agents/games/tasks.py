"""Tasks as small games: the states and transitions of the joint solver, state by state."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from itertools import compress

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from pursuit.rules.layout import Games
from pursuit.tasks.task import Task, checked_task
from scripted_agents.games.game import State
from scripted_agents.games.small_game import SmallGame
from scripted_agents.joint.opponents import lay_out_others
from scripted_agents.joint.states import joint_states_of
from scripted_agents.joint.sweeps import Problem, Quantity, filled_store
from scripted_agents.limits import MAX_TASK_STATES, check_joint_states

CAPTURED = -1
"""The cell of a captured evader in a state."""


def states_of_games(games: Games) -> list[tuple[tuple[int, ...], ...]]:
    """The states of `game_of_task` that games are in: the cell of every agent, -1 for captured and
    escaped evaders, the cells of the goals that are left, in order, and in games with exits those
    of the exits."""
    cells = np.where(games.active != 0, games.position, CAPTURED).tolist()
    parts = [games.goal, games.exit] if games.exit.shape[1] else [games.goal]
    places = [[tuple(sorted({*row} - {-1})) for row in part.tolist()] for part in parts]
    return [(tuple(row), *rest) for row, *rest in zip(cells, *places, strict=True)]


def game_of_task(task: Task, most_states: int = MAX_TASK_STATES) -> SmallGame:
    """A task in one maze as a small game without a limit on steps; every agent is a player.

    A state is (cells of the agents, cells of the goals), with exits (..., cells of the exits); see
    `states_of_games`. Of actions that lead to the same cell only the first is listed.

    Raises:
        ValueError: several mazes, user-defined rewards, slips, turns, too many states, or too
            little memory.
    """
    task = checked_task(task)
    if task.reward_function is not None:
        raise ValueError(
            f"task {task.name!r} has a custom reward function; give rewards by coefficients"
        )
    if task.options.slips or task.options.turns:
        raise ValueError(
            f"task {task.name!r} with slip={task.slip!r}, move_order={task.move_order!r}: a small "
            "game has neither slips nor rounds of turns; use solve_joint and joint_nash_conv"
        )
    check_joint_states(task, most_states, each=1000)
    joint = joint_states_of(task)
    agents, nothing = task.num_agents, [0] * task.num_agents
    rewards = [Quantity(row, nothing) for row in np.eye(agents, dtype=np.int64).tolist()]
    problem = Problem(
        joint, tuple(range(agents)), lay_out_others(joint, {}), tuple(rewards), moves_first=False
    )
    store = filled_store(problem)
    counts = store.shape[:, 0].astype(np.int64)
    kept = np.flatnonzero(counts)
    state = np.repeat(kept, counts[kept])
    begins = np.concatenate([[0], np.cumsum(counts[kept])])
    within = np.arange(begins[-1]) - np.repeat(begins[:-1], counts[kept])
    played = store.joints[store.edges[state] + within].astype(np.int64)
    given = store.edges[state] + within * agents
    after = store.following[store.pairs[state] + within]
    renumbered = np.full(joint.count, -1)
    renumbered[kept] = np.arange(len(kept))
    goes_on = np.flatnonzero(after >= 0)
    following = csr_array(
        (np.ones(len(goes_on)), (goes_on, renumbered[after[goes_on]])),
        shape=(len(state), len(kept)),
    )
    names: list[State] = []
    for _, games, real in joint.chunks():
        names += compress(states_of_games(games), real)
    actions, choices = _actions(task, played, begins)
    start = np.zeros(joint.count)
    for numbers in joint.starts():
        weights = joint.weights(numbers)
        start[numbers] = 1.0 if weights is None else weights
    return SmallGame(
        task.agent_names,
        names,
        {name: number for number, name in enumerate(names)},
        actions,
        begins,
        choices,
        np.stack([store.sides[given + agent] for agent in range(agents)], axis=1),
        following,
        start[kept] / start.sum(),
        task,
    )


def _actions(
    task: Task, played: NDArray[np.int64], begins: NDArray[np.int64]
) -> tuple[list[list[Sequence[Hashable]]], NDArray[np.int32]]:
    """The legal actions of every player and state, and the index of each player's action."""
    agents, number = task.num_agents, task.num_actions
    single = np.stack([played // number ** (agents - 1 - at) % number for at in range(agents)], 1)
    actions: list[list[Sequence[Hashable]]] = [[] for _ in range(agents)]
    choices = np.empty_like(single, dtype=np.int32)
    for first, last in zip(begins[:-1].tolist(), begins[1:].tolist(), strict=True):
        for agent in range(agents):
            legal, index = np.unique(single[first:last, agent], return_inverse=True)
            actions[agent].append(tuple(legal.tolist()))
            choices[first:last, agent] = index
    return actions, choices
