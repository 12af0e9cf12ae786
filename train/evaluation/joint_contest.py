"""Exact references of games that need a solver of whole games: teams, races, heists.

A game in which evaders collect goals (a heist) ends with a capture or with the last goal, so its
measure is the return, not steps. The measure of a race is goals; its optima in goals, returns and
steps are known.
"""

from __future__ import annotations

from collections.abc import Mapping

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from scripted_agents import (
    check_joint_states,
    count_joint_states,
    why_no_distribution,
)

MAX_WORK, MAX_EVALUATED_WORK = 5_000_000, 200_000_000
"""Whole games are solved up to these sizes (`joint_work`). The first applies at the start of a run
(4x4, two agents, three goals: two seconds). The second applies at the end of a run, and to `pursuit
evaluate` and `pursuit baseline` (5x5, two agents and three goals, or two against two: 15 seconds,
about 10 million states)."""


def joint_work(task: Task) -> int:
    """The size of a game: its states times the joint actions of all agents."""
    return int(count_joint_states(task) * task.num_actions**task.num_agents)


def why_not_joint(task: Task, agent: str, opponents: Mapping[str, Policy], most: int) -> str | None:
    """The reason why the exact best response in a whole game is not computed; None if it is.

    Args:
        task: the game.
        agent: the responding agent, by name, or a role for its first agent.
        opponents: the policies of the other agents, by agent name or role.
        most: the largest size that is solved (`joint_work`).
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
