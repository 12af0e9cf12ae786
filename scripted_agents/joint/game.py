"""Games of two agents as a whole, in zero-sum form: values and equilibria of races and heists.

The payoff of an agent is its *lead*: its reward minus that of the other. So in a race of two
both want more goals than the other, and in a heist what the chaser loses counts for the evader.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pursuit.tasks.task import Task, checked_task
from pursuit.validation import number
from scripted_agents.joint.policy import JointTable
from scripted_agents.joint.shapley_iteration import game_of_task, solve_infinite_horizon
from scripted_agents.joint.states import JointStates, check_joint_states, joint_states_of
from scripted_agents.joint.sweeps import Quantity

MAX_GAME_STATES = 2_000_000
"""Above this number of states a game is not solved: minutes, and more than a gigabyte."""

MAX_DISCOUNT = 0.9995
"""Above this discount value iteration needs more than about 50,000 sweeps."""


@dataclass(frozen=True, eq=False)
class JointGame:
    """The result of `solve_joint_game`.

    Attributes:
        states: of the game.
        values: [states] float64, the discounted lead of the first agent from each state on, when
            both play an equilibrium; 0 in states that cannot be.
        mean_over_starts: the mean of `values` over the starts that the task draws.
        policies: by agent name, the policy in this equilibrium.
        mixed: number of states without an optimal pure strategy.
        discount: of the game.
    """

    states: JointStates = field(repr=False)
    values: NDArray[np.float64] = field(repr=False)
    mean_over_starts: float
    policies: dict[str, JointTable] = field(repr=False)
    mixed: int
    discount: float


def solve_joint_game(
    task: Task, discount: float = 0.95, most_states: int = MAX_GAME_STATES
) -> JointGame:
    """The value and an equilibrium of a game of two agents that maximise their lead.

    Shapley (1953): value iteration in which every state is a matrix game, by its saddle point or a
    linear program, with steps of policy evaluation in between where they help.

    Args:
        task: any game of two agents in one maze: a race, a heist, a duel.
        discount: of each step; above 0 and at most MAX_DISCOUNT.
        most_states: above this number of states the game is refused.

    Raises:
        ValueError: another number of agents, user-defined rewards, an invalid discount, too many
            states, or too little memory.
    """
    task = checked_task(task)
    if task.num_agents != 2 or task.reward_function is not None:
        raise ValueError(
            f"task {task.name!r}: {task.num_agents} agents, rewards {task.rewards!r}; the lead is "
            "zero-sum between two agents with reward coefficients: give two, and coefficients"
        )
    if not 0.0 < number("discount", discount) <= MAX_DISCOUNT:
        raise ValueError(
            f"discount {discount}; it lies above 0 and is at most {MAX_DISCOUNT}: nearer to 1 the "
            "values converge too slowly. Give a smaller one"
        )
    # Some 20 pairs of options a state, each with what it pays, where it leads, and its actions.
    check_joint_states(task, most_states, each=20 * 30)
    states = joint_states_of(task)
    game = game_of_task(states, (0, 1), Quantity([1, -1], [0, 0]), discount)
    values, _ = solve_infinite_horizon(game)
    policies = {
        name: JointTable(states, (seat,), table)
        for seat, (name, table) in enumerate(zip(task.agent_names, game.strategies(), strict=True))
    }
    mean, mixed = float(states.mean_over_starts(values)), int(game.mixed.sum())
    return JointGame(states, values, mean, policies, mixed, discount)
