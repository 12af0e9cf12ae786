"""Games of two agents as a whole, in zero-sum form: values and equilibria of races and heists.

What one agent gets is its *lead*: what it is paid less what the other is paid. So in a race of two
both want more goals than the other, and in a heist what the chaser loses counts for the evader.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pursuit.declared import number
from pursuit.task import Task, checked_task
from scripted_agents.equilibrium import solve_matrix_game
from scripted_agents.joint_opponents import Others
from scripted_agents.joint_policy import JointTable
from scripted_agents.joint_states import JointStates, check_joint_states, joint_states_of
from scripted_agents.joint_sweeps import Problem, Quantity, Sweeper

MAX_GAME_STATES = 2_000_000
"""Above this number of states a game is not solved: minutes, and more than a gigabyte."""

SADDLE = 1e-12
"""Relative difference below which the pure maximin and minimax count as equal."""

TOLERANCE = 1e-8
"""How exact values are, relative to the largest."""

MAX_DISCOUNT = 0.9995
"""Above this discount value iteration needs more than about 50,000 sweeps."""


@dataclass(frozen=True, eq=False)
class JointGame:
    """What `solve_joint_game` found.

    Attributes:
        states: of the game.
        values: [states] float64, the discounted lead of the first agent from each state on, when
            both play an equilibrium; 0 in states that cannot be.
        mean_over_starts: the mean of `values` over the starts that the task draws.
        policies: by agent name, what it plays in this equilibrium.
        mixed: in how many states no pure choice is optimal.
        discount: of the game.
    """

    states: JointStates = field(repr=False)
    values: NDArray[np.float64] = field(repr=False)
    mean_over_starts: float
    policies: dict[str, JointTable] = field(repr=False)
    mixed: int
    discount: float


@dataclass(frozen=True, eq=False)
class _Alike:
    """All states in which both agents have so many options.

    Attributes:
        states: [n] their numbers.
        at_once: [n, options, options] float64, the lead of one step.
        after: [n, options, options] the next state, -1 for the end.
        joint: [n, options, options] the joint action.
    """

    states: NDArray[np.int64]
    at_once: NDArray[np.float64]
    after: NDArray[np.int32]
    joint: NDArray[np.int16]


def solve_joint_game(
    task: Task, discount: float = 0.95, most_states: int = MAX_GAME_STATES
) -> JointGame:
    """The value and an equilibrium of a game of two agents whose aim is to lead.

    Shapley (1953): value iteration in which every state is a matrix game, by its saddle point or a
    linear program, until the values are exact to about TOLERANCE.

    Args:
        task: any game of two agents in one maze: a race, a heist, a duel.
        discount: of each step; above 0 and at most MAX_DISCOUNT.
        most_states: above this number of states the game is refused.

    Raises:
        ValueError: another number of agents, a user's own rewards, a discount outside these limits,
            or more states, or bytes, than are solved.
    """
    task = checked_task(task)
    if task.num_agents != 2 or task.reward_function is not None:
        raise ValueError(
            f"task {task.name!r}: {task.num_agents} agents, paid by {task.rewards!r}; the lead is "
            "zero-sum between two agents that the rule book pays: give two, and coefficients"
        )
    if not 0.0 < number("discount", discount) <= MAX_DISCOUNT:
        raise ValueError(
            f"discount {discount}; it lies above 0 and is at most {MAX_DISCOUNT}: nearer to 1 the "
            "values converge too slowly. Give a smaller one"
        )
    # Some 20 pairs of options a state, each with what it pays, where it leads, and its actions.
    check_joint_states(task, most_states, each=20 * 30)
    states = joint_states_of(task)
    kinds = _kinds_of(states)
    values = np.zeros(states.count)
    while True:
        target = values.copy()
        for kind in kinds:
            target[kind.states] = _values_of(_payoffs(kind, values, discount))
        change, values = float(np.abs(target - values).max()), target
        largest = max(1.0, float(np.abs(values).max()))
        if change * discount <= (1.0 - discount) * TOLERANCE * largest:
            break
    tables, mixed = np.zeros((2, states.count, task.num_actions)), 0
    for kind in kinds:
        payoffs = _payoffs(kind, values, discount)
        for at, state in enumerate(kind.states.tolist()):
            game = solve_matrix_game(payoffs[at])
            rows, columns = np.divmod(kind.joint[at].astype(np.int64), task.num_actions)
            tables[0, state, rows[:, 0]] = game.row
            tables[1, state, columns[0]] = game.column
            mixed += not game.pure
    mean = float(states.mean_over_starts(values))
    policies = {
        name: JointTable(states, seat, tables[seat]) for seat, name in enumerate(task.agent_names)
    }
    return JointGame(states, values, mean, policies, mixed, discount)


def _kinds_of(states: JointStates) -> list[_Alike]:
    """All states that can be, those with as many options together."""
    task = states.task
    nobody = Others(np.zeros((0, states.count), dtype=np.uint32), np.zeros((0, task.num_actions)))
    problem = Problem(states, (0, 1), nobody, (Quantity([1, -1], [0, 0]),))
    choice = np.zeros(states.count, dtype=np.int16)
    with Sweeper(problem, np.zeros((states.count, 1)), choice) as sweeper:
        for _ in sweeper.steps(1):
            pass
        if sweeper.store is None:
            raise ValueError(
                f"task {task.name!r}: what follows {states.count:,} states does not fit into "
                "memory; take a smaller maze or fewer goals"
            )
        pairs, edges, shape, following, sides, joints = sweeper.store
    neighbors = task.mazes[0].neighbors[:, : task.num_actions]
    ways = np.array([len(set(row)) for row in neighbors.tolist()], dtype=np.int64)
    options = np.concatenate([ways[games.position] for _, games, _ in states.chunks()])
    found = []
    for ours, theirs in np.unique(options, axis=0).tolist():
        same = (options == (ours, theirs)).all(axis=1) & (shape[:, 0] > 0)
        numbers = np.flatnonzero(same)
        some = np.arange(ours * theirs)
        where = (len(numbers), ours, theirs)
        found.append(
            _Alike(
                numbers,
                sides[edges[numbers, None] + some].reshape(where),
                following[pairs[numbers, None] + some].reshape(where),
                joints[edges[numbers, None] + some].reshape(where),
            )
        )
    return found


def _payoffs(kind: _Alike, values: NDArray[np.float64], discount: float) -> NDArray[np.float64]:
    """[n, options, options] float64, the lead of the first agent, which chooses the row."""
    return kind.at_once + discount * np.where(kind.after < 0, 0.0, values[kind.after])


def _values_of(payoffs: NDArray[np.float64]) -> NDArray[np.float64]:
    """[n] float64, the values of matrix games."""
    lower = payoffs.min(axis=2).max(axis=1)
    upper = payoffs.max(axis=1).min(axis=1)
    scale = np.maximum(np.abs(payoffs).max(axis=(1, 2)), 1.0)
    for at in np.flatnonzero(upper - lower > SADDLE * scale).tolist():
        lower[at] = solve_matrix_game(payoffs[at]).value
    return np.asarray(lower)
