"""The exact references of games that only a solver of whole games knows: teams, races, heists.

A game in which evaders collect goals ends by a capture as by the last goal, so steps say little of
it: its reference is what its agents are paid. A race is compared by goals: known are the goals that
a runner can collect, what it can be paid, and the steps until all goals are collected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from pursuit.policy import Policy
from pursuit.task import Rewards, Task
from scripted_agents import (
    JointResponse,
    check_joint_states,
    count_joint_states,
    solve_joint,
    why_no_distribution,
)

MAX_WORK, MAX_EVALUATED_WORK = 5_000_000, 200_000_000
"""Above this size (`joint_work`) a whole game is not solved: as a run begins (4x4, two agents and
three goals: two seconds); and as it ends, by `pursuit evaluate` and by `pursuit baseline` (5x5, two
agents and three goals or two against two: a quarter of a minute; up to some 10 million states)."""


def joint_work(task: Task) -> int:
    """The size of a game: its states times the joint actions of all agents."""
    return int(count_joint_states(task) * task.num_actions**task.num_agents)


def why_not_joint(task: Task, agent: str, opponents: Mapping[str, Policy], most: int) -> str | None:
    """What is in the way of an agent's exact best response in a whole game; None for nothing.

    Args:
        task: the game.
        agent: who responds, by name or role (the first agent of it).
        opponents: who plays the other seats, by agent name or role.
        most: the size that is solved, in the units of `joint_work`.
    """
    if len(task.mazes) > 1:
        return f"{len(task.mazes)} mazes; whole games are solved in one"
    work = joint_work(task)
    if work > most:
        return (
            f"{count_joint_states(task):,} states, times joint actions {work:,}; "
            f"at most {most:,} are solved here"
        )
    try:
        check_joint_states(task, each=100)
    except ValueError as refused:
        return str(refused)
    seat = task.seat(agent)
    others = [other for other in range(task.num_agents) if other != seat]
    return why_no_distribution(task, others, opponents)


def best_of_steps(task: Task, agent: str, opponents: Mapping[str, Policy]) -> JointResponse | None:
    """The best response in steps, as a contest counts them; None where steps are no aim."""
    if task.num_goals and task.num_evaders:
        return None
    return solve_joint(task, [_name(task, agent)], opponents, task.max_steps)


def best_of_returns(
    task: Task, agent: str, opponents: Mapping[str, Policy]
) -> JointResponse | None:
    """The best response in what the agent is paid; None where steps say as much, or a user's
    function pays."""
    rivals = task.num_goals and task.num_agents > 1
    if not rivals or task.reward_function is not None:
        return None
    own = [_name(task, agent)]
    return solve_joint(task, own, opponents, task.max_steps, objective="return")


def best_of_goals(task: Task, agent: str, opponents: Mapping[str, Policy]) -> JointResponse:
    """The best response in goals that the agent collects, whatever it is paid."""
    role = task.seat_roles[task.seat(agent)]
    by_goals = replace(task, rewards={role: Rewards(goal=1.0)})
    own = [_name(task, agent)]
    return solve_joint(by_goals, own, opponents, task.max_steps, objective="return")


def _name(task: Task, agent: str) -> str:
    """Of the one agent that a contest is of: a role is its first agent, not all of them."""
    return task.agent_names[task.seat(agent)]
