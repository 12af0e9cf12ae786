"""Games of two agents as a whole, in zero-sum form: values and equilibria of races and heists.

The payoff of an agent is its *lead*: its reward minus that of the other. So in a race of two
both want more goals than the other, and in a heist what the chaser loses counts for the evader.
"""

from __future__ import annotations

from pursuit.tasks.task import Task, checked_task
from pursuit.validation import number
from scripted_agents.exact.joint.policy import JointTable
from scripted_agents.exact.joint.results import JointGame
from scripted_agents.exact.joint.shapley_iteration import solve_infinite_horizon, stochastic_game_of
from scripted_agents.exact.joint.states import joint_states_of
from scripted_agents.exact.joint.sweeps import Quantity
from scripted_agents.exact.limits import MAX_DISCOUNT, MAX_GAME_STATES, check_joint_states


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
    game = stochastic_game_of(states, (0, 1), Quantity([1, -1], [0, 0]), discount)
    values, _ = solve_infinite_horizon(game)
    policies = {
        name: JointTable(states, (seat,), table)
        for seat, (name, table) in enumerate(zip(task.agent_names, game.strategies(), strict=True))
    }
    return JointGame(
        values=values,
        mean_over_starts=float(states.mean_over_starts(values)),
        policies=policies,
        mixed=game.mixed,
        states=states,
        discount=discount,
    )
