"""Reference policies for a learner with a limited view: scripted agents with the same view."""

from __future__ import annotations

from collections.abc import Mapping

from pursuit.simulator.policy import Policy, TabularPolicy
from pursuit.tasks.task import Task
from scripted_agents.agents.searchers import SearchingChaser, SearchingRunner, WaryEvader
from scripted_agents.exact.hidden.beliefs import BeliefChaser
from scripted_agents.exact.limits import why_no_belief


def limited_references(
    task: Task, agent: str | int, opponents: Mapping[str, Policy]
) -> dict[str, Policy]:
    """The references of an agent by name; empty if it has a full view.

    Chaser: the searching chaser, and in a duel against a tabular policy the belief chaser with that
    table as model. Evader: the wary evader. Runner: the searching runner.

    Args:
        task: the game; the policies have the view of this agent.
        agent: by name, role or index.
        opponents: the policies of the other agents, by name or role.
    """
    seat = task.seat(agent)
    if task.sight.limits[seat].sees_all:
        return {}
    role = task.seat_roles[seat]
    if role == "evader":
        return {"wary evader": WaryEvader()}
    if role == "runner":
        return {"searching runner": SearchingRunner()}
    found: dict[str, Policy] = {"searching chaser": SearchingChaser()}
    other = opponents.get("evader_0", opponents.get("evader"))
    if why_no_belief(task) is None and isinstance(other, TabularPolicy):
        found["belief chaser"] = BeliefChaser(other)
    return found
