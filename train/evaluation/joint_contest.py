"""The exact references of games that only a solver of whole games knows: teams, races, heists.

A game in which evaders collect goals ends by a capture as by the last goal, so steps say little of
it: its reference is what its agents are paid. A race is compared by goals: known are the goals that
a runner can collect, what it can be paid, and the steps until all goals are collected.
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
