"""The chase of one evader by a team, exactly: the joint solver (`joint`) for one kind of game.

The states of such a game are the cells of all agents, the evader's counting fastest, so values have
the shape [chaser cell, ..., evader cell].
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pursuit.tasks.task import Task, checked_task
from pursuit.validation import one_of
from scripted_agents.joint.opponents import Policies, why_no_distribution
from scripted_agents.joint.policy import JointPlan
from scripted_agents.joint.solver import lengths_of, quantities_of, solve_joint
from scripted_agents.joint.states import joint_states_of


@dataclass(frozen=True, eq=False)
class TeamResponse:
    """The result of `best_team_response`.

    Attributes:
        role: the responder: a role (its agents act jointly), or the name of one agent.
        values: [chaser cell, ..., evader cell] float64, expected steps until capture (the capturing
            step included), cut at the horizon; 0 if a chaser is on the evader. With a
            discount the step t = 0, 1, ... counts discount**t.
        mean_over_starts: the mean of `values` over the starts that the game draws.
        policy: a `Policy` for the responding agents that attains the values.
        horizon, discount: of the problem.
    """

    role: str
    values: NDArray[np.float64] = field(repr=False)
    mean_over_starts: float
    policy: JointPlan = field(repr=False)
    horizon: int | None
    discount: float


def best_team_response(
    task: Task, role: str, policies: Policies, horizon: int | None = 200, discount: float = 1.0
) -> TeamResponse:
    """The exact best response of a side of a chase, acting as one player, to fixed policies.

    Chasers minimise the expected steps until capture, the evader maximises them: `solve_joint` with
    the objective "steps".

    Args:
        task: a chase of one evader by one or more chasers in one maze, with random starts.
        role: "chaser" or "evader"; or one agent ("chaser_1"), the others playing `policies`.
        policies: of all other agents, by agent name or role; a name goes first.
        horizon: the number of steps after which the game is cut, or None.
        discount: what a step counts in terms of the one before it; above 0, at most 1, and below 1
            without a horizon.

    Raises:
        ValueError: another task; a policy that is missing, or no known distribution; arguments
            outside these limits; a game that does not fit into memory.
    """
    _check(task, horizon, discount)
    one_of("role", role, ("chaser", "evader", *task.agent_names))
    found = solve_joint(task, role, policies, horizon, discount)
    values = found.values.reshape(_shape(task))
    return TeamResponse(role, values, found.mean_over_starts, found.policy, horizon, discount)


def evaluate_team(
    task: Task, policies: Policies, horizon: int | None = 200, discount: float = 1.0
) -> NDArray[np.float64]:
    """The expected number of steps until capture when all agents play `policies`.

    The same quantity as `best_team_response(...).values`, arguments and errors as there.
    """
    _check(task, horizon, discount)
    wanted = {"length": lengths_of(task)["length"]}
    _, values = quantities_of(task, policies, wanted, horizon, discount)
    return values[:, 0].reshape(_shape(task))


def team_survival(
    task: Task, policies: Policies, horizon: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`evaluate_team` for a horizon, and the probability of no capture within it."""
    _check(task, horizon, 1.0)
    _, values = quantities_of(task, policies, lengths_of(task), horizon, 1.0)
    length, ended = values.reshape(*_shape(task), 2).transpose(-1, *range(task.num_agents))
    return length, np.where(length > 0.0, 1.0 - ended, 0.0)


def mean_over_team_starts(
    values: NDArray[np.float64], task: Task, least: int | None = None
) -> float:
    """The mean of `values` [chaser cell, ..., evader cell] over the starts that the game draws.

    All agents are in different cells, every chaser at least `least` steps from the evader (the
    task's `min_start_distance` if left out), all such placements equally likely.

    Raises:
        ValueError: there is no such placement.
    """
    return float(joint_states_of(task).mean_over_starts(np.ravel(values), least))


def _shape(task: Task) -> tuple[int, ...]:
    """[chaser cell, ..., evader cell]."""
    return (task.max_cells,) * task.num_agents


# -- what can be solved ----------------------------------------------------------------------------


def why_not_team_chase(task: Task) -> str | None:
    """The reason why a task is no solvable team chase; None if it is one."""
    if checked_task(task).num_evaders != 1 or not task.num_chasers:
        return f"{task.num_chasers} chaser(s) and {task.num_evaders} evader(s)"
    if task.num_runners or task.num_goals:
        return f"{task.num_runners} runner(s) and {task.num_goals} goal(s)"
    return f"{len(task.mazes)} mazes" if len(task.mazes) > 1 else None


def work_of(task: Task) -> int:
    """The size of a team chase: its places times the pairs of joint and evader's actions."""
    pairs = checked_task(task).num_actions ** (task.num_chasers + 1)
    return int(task.max_cells ** (task.num_chasers + 1) * pairs)


def has_distributions(task: Task, policies: Policies) -> bool:
    """Whether the distributions of all policies are known in the games of this task."""
    return why_no_distribution(task, range(task.num_agents), policies) is None


def _check(task: Task, horizon: int | None, discount: float) -> None:
    obstacle = why_not_team_chase(task)
    if obstacle is not None or task.start != "random":
        raise ValueError(
            f"task {task.name!r} has {obstacle or 'starts at marks'}; chases of one evader by any "
            "number of chasers, without goals and in one maze with random starts, are solved here"
        )
    if horizon is None and discount == 1.0:
        raise ValueError("discount 1.0; below 1 where there is no horizon")
