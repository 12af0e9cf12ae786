"""What the agents that decide nothing do in every state of a game, as the kernels take it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.policy import DistributionPolicy, MemoryPolicy, Policy
from pursuit.simulator import Simulator
from pursuit.task import Task
from scripted_agents.joint_policy import JointPlan
from scripted_agents.joint_states import JointStates
from scripted_agents.scripted import NUM_MOVES, Scripted, number_of_moves, rows_of_moves
from scripted_agents.table_policy import TablePolicy

TOLERANCE = 1e-4
"""By how much a distribution's sum may differ from 1, which a network's does."""

Policies = Mapping[str, Policy | ArrayLike]


class Others(NamedTuple):
    """How the other seats play.

    Attributes:
        codes: [seats, states] uint32, the row that a seat plays in a state.
        rows: [rows, actions] float64, distributions over the actions.
    """

    codes: NDArray[np.uint32]
    rows: NDArray[np.float64]


def policies_of(
    task: Task, seats: Sequence[int], policies: Policies
) -> dict[int, DistributionPolicy]:
    """Who fills these seats, by seat: policies that say how likely each action is.

    Args:
        task: the game.
        seats: to be filled.
        policies: by agent name or role, a name goes first; a table [self cell, other cell, action]
            is that of a `TablePolicy`.

    Raises:
        ValueError: nobody fills a seat; a policy that has no distribution, that remembers, that
            sees less than all (its distribution is no function of the state), or that draws
            together with another seat.
    """
    found: dict[int, DistributionPolicy] = {}
    for seat in seats:
        name = task.agent_names[seat]
        policy = policies.get(name, policies.get(task.seat_roles[seat]))
        if policy is None:
            raise ValueError(f"nobody fills the seat of {name}; add policies={{{name!r}: ...}}")
        if not hasattr(policy, "act"):
            policy = TablePolicy(task.mazes[0], policy)
        if isinstance(policy, MemoryPolicy) or not isinstance(policy, DistributionPolicy):
            raise ValueError(
                f"{policy!r} in the seat of {name} has no distribution(task, games, seat); only "
                "policies that say how likely each action is in every state can be answered exactly"
            )
        if isinstance(policy, JointPlan) and len(policy.choices) > 1:
            raise ValueError(
                f"{policy!r} in the seat of {name} does something else at every step; take one "
                "that was solved with horizon=None"
            )
        if hasattr(policy, "joint_distribution") and any(policy is p for p in found.values()):
            raise ValueError(
                f"{policy!r} fills several seats and draws their actions together; other seats are "
                "independent here: take `best_team_response` or `evaluate_team`"
            )
        found[seat] = policy
    return found


def why_no_distribution(task: Task, seats: Sequence[int], policies: Policies) -> str | None:
    """What is in the way of knowing how these seats play in every state; None for nothing."""
    try:
        for seat, policy in policies_of(task, seats, policies).items():
            games = Simulator(task).games
            if isinstance(policy, Scripted):
                policy.moves(task, games, seat)
            else:
                policy.distribution(task, games, seat)
    except ValueError as refused:
        return str(refused)
    return None


def bytes_of_others(task: Task, policies: Mapping[int, DistributionPolicy]) -> int:
    """The memory that the play of these policies takes for each state."""
    dense = sum(not isinstance(policy, Scripted) for policy in policies.values())
    return 4 * len(policies) + 8 * task.num_actions * dense


def lay_out_others(
    states: JointStates, seats: Sequence[int], policies: Mapping[int, DistributionPolicy]
) -> Others:
    """Ask everybody who fills one of `seats` for what it plays in every state.

    Raises:
        ValueError: what a policy raises; rows that are no distributions.
    """
    task = states.task
    codes = np.zeros((len(seats), states.count), dtype=np.uint32)
    rows = [np.zeros((0, task.num_actions))]
    begins = 0
    for number, seat in enumerate(seats):
        policy = policies[seat]
        scripted = isinstance(policy, Scripted)
        if scripted:
            rows.append(rows_of_moves(policy.epsilon, task.num_actions))  # type: ignore[attr-defined]
        for first, games, real in states.chunks():
            some = slice(first, first + len(real))
            if isinstance(policy, Scripted):
                moves = policy.moves(task, games, seat)
                codes[number, some] = begins + number_of_moves(moves)
                continue
            playing = real & (games.active[:, seat] != 0)
            found = policy.distribution(task, games, seat)
            rows.append(_checked(found, playing, task, seat, policy))
            codes[number, some] = np.arange(begins + first, begins + first + len(real))
        begins += NUM_MOVES if scripted else states.count
    return Others(codes, np.concatenate(rows))


def _checked(
    found: NDArray[np.float64],
    playing: NDArray[np.bool_],
    task: Task,
    seat: int,
    policy: DistributionPolicy,
) -> NDArray[np.float64]:
    """[games, actions] rows that sum to 1, whatever was rounded; others than `playing` count not.

    Raises:
        ValueError: no distribution.
    """
    found = np.asarray(found, dtype=np.float64)
    total = found.sum(axis=1, keepdims=True)
    fine = (np.abs(total[:, 0] - 1.0) < TOLERANCE) & (found >= 0.0).all(axis=1)
    if found.shape[1] != task.num_actions or not fine[playing].all():
        raise ValueError(
            f"{policy!r} in the seat of {task.agent_names[seat]} gives no distribution over the "
            f"{task.num_actions} actions in some state; rows are non-negative and sum to 1"
        )
    return np.asarray(found / np.where(total > 0.0, total, 1.0))
