"""Exact NashConv of any small game: the sum of all gains by best responses."""

from __future__ import annotations

from typing import Any, Literal

from pursuit.tasks.task import Task, checked_task
from pursuit.validation import check_bool, one_of
from scripted_agents.exact.joint.opponents import Policies
from scripted_agents.exact.joint.results import JointNashConv
from scripted_agents.exact.joint.solver import evaluate_joint, solve_joint
from scripted_agents.exact.limits import MAX_STATES


def joint_nash_conv(
    task: Task,
    policies: Policies,
    horizon: int | None = 200,
    discount: float = 1.0,
    sides: bool = False,
    objective: Literal["return", "lead"] = "return",
    most_states: int = MAX_STATES,
) -> JointNashConv:
    """What every player's best response gains against the policies of all others, exactly.

    Defined for any number of players and any rewards (no zero sum is needed): in a race
    every runner is a player. Arguments and errors are those of `solve_joint`; policies must be
    stationary.

    Args:
        task: any game in one maze.
        policies: of all agents, by agent name or role.
        horizon: number of steps of the game, or None for infinitely many.
        discount: of each step.
        sides: whether all agents of a role are one player with the sum of their returns; for
            chasers with `per_evader` rewards, which are all equal, their mean. So `zero_sum` is
            zero-sum between two sides, and for one evader NashConv is that of
            `train.evaluation.team_exploitability`.
        objective: of all players, as in `solve_joint`; with "lead" a race of two is
            zero-sum, and both numbers are those of `solve_joint_game`.
        most_states: above this number of states the game is refused.
    """
    task = checked_task(task)
    players: dict[str, list[str]] = {}
    for name, role in zip(task.agent_names, task.seat_roles, strict=True):
        players.setdefault(role if check_bool("sides", sides) else name, []).append(name)
    one_of("objective", objective, ("return", "lead"))
    shared_return = sides and objective == "return" and task.role_rewards["chaser"].per_evader
    weights = {
        player: 1.0 / len(names) if shared_return and player == "chaser" else 1.0
        for player, names in players.items()
    }
    rest: Any = policies, horizon, discount, objective, most_states
    best = {
        player: weights[player] * solve_joint(task, names, *rest).mean_over_starts
        for player, names in players.items()
    }
    achieved = evaluate_joint(task, policies, horizon, discount, None, most_states).returns
    returns = {
        player: weights[player] * sum(achieved[name] for name in names)
        for player, names in players.items()
    }
    if objective == "lead":
        returns = {player: 2.0 * own - sum(achieved.values()) for player, own in returns.items()}
    return JointNashConv(returns, best)
