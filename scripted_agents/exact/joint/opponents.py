"""The action distributions of fixed policies in every state, as arguments of the kernels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.rules.layout import Games
from pursuit.simulator.policy import DistributionPolicy, Policy, tells_its_play
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents.agents.scripted import MoveSets, Scripted
from scripted_agents.agents.table_policy import TablePolicy
from scripted_agents.exact.joint.policy import JointPlan, marginal, mixed_with_random_moves
from scripted_agents.exact.joint.states import JointStates
from scripted_agents.exact.tolerances import NETWORK_SUM_TOLERANCE

Policies = Mapping[str, Policy | ArrayLike]


class OtherPolicies(NamedTuple):
    """The policies of the other agents as arrays.

    Attributes:
        players: the agent indices of each player; a player is one agent, or several agents with a
            joint distribution.
        codes: [players, states] uint32, where in `rows` the distribution of a player starts.
        rows: float64, distributions over the joint actions of a player, one after the other.
    """

    players: list[tuple[int, ...]]
    codes: NDArray[np.uint32]
    rows: NDArray[np.float64]


def policies_of(
    task: Task, seats: Sequence[int], policies: Policies
) -> dict[int, DistributionPolicy]:
    """The policies of these agents, by agent index; they have action distributions.

    Args:
        task: the game.
        seats: the indices of the agents.
        policies: by agent name (first) or role; a table [self cell, other cell, action]
            is that of a `TablePolicy`.

    Raises:
        ValueError: a missing policy, or one that is no function of the state: without distribution,
            with memory or a clock, or with a limited view.
    """
    if not isinstance(policies, Mapping):
        raise ValueError(f"policies={policies!r}; give a dict, policies by agent or role")
    found: dict[int, DistributionPolicy] = {}
    for seat in seats:
        name = task.agent_names[seat]
        policy = policies.get(name, policies.get(task.seat_roles[seat]))
        if policy is None:
            raise ValueError(f"{name} has no policy; add policies={{{name!r}: ...}}")
        if not hasattr(policy, "act"):
            policy = TablePolicy(task.mazes[0], policy)
        if not tells_its_play(policy, "distribution"):
            bare = type(policy).__repr__ is object.__repr__
            shown = type(policy).__name__ if bare else repr(policy)
            raise ValueError(
                f"{shown} of {name} has memory or no distribution(task, games, seat); exact "
                "solutions need policies with action probabilities in every state"
            )
        if isinstance(policy, JointPlan) and len(policy.choices) > 1:
            raise ValueError(
                f"{policy!r} of {name} depends on the step; use one that was solved with "
                "horizon=None"
            )
        uses_clock = getattr(policy, "uses_clock", None)
        if uses_clock is not None and uses_clock(task):
            raise ValueError(
                f"{policy!r} of {name} depends on the step in this maze; exact solutions need "
                "policies that are functions of the state"
            )
        found[seat] = cast(DistributionPolicy, policy)
    return found


def why_no_distribution(task: Task, seats: Sequence[int], policies: Policies) -> str | None:
    """The reason why the distributions of these agents are unknown; None if they are known."""
    try:
        games = Simulator(task).games
        for seat, policy in policies_of(task, seats, policies).items():
            if isinstance(policy, Scripted):
                policy.moves(task, games, seat)
            else:
                policy.distribution(task, games, seat)
    except ValueError as refused:
        return str(refused)
    return None


def has_distributions(task: Task, policies: Policies) -> bool:
    """Whether the distributions of all policies are known in the games of this task."""
    return why_no_distribution(task, range(task.num_agents), policies) is None


def players_of(policies: Mapping[int, DistributionPolicy]) -> list[tuple[int, ...]]:
    """The seats of each player: those of one policy that draws their actions together are one."""
    found: dict[int, list[int]] = {}
    for seat, policy in policies.items():
        together = hasattr(policy, "joint_distribution")
        found.setdefault(id(policy) if together else -seat - 1, []).append(seat)
    return [tuple(seats) for seats in found.values()]


def bytes_of_others(task: Task, policies: Mapping[int, DistributionPolicy]) -> int:
    """The memory that the play of these policies takes for each state."""
    players = players_of(policies)
    dense = [seats for seats in players if not isinstance(policies[seats[0]], Scripted)]
    return 4 * len(players) + sum(16 * task.num_actions ** len(seats) for seats in dense)


def lay_out_others(
    states: JointStates, policies: Mapping[int, DistributionPolicy]
) -> OtherPolicies:
    """The distributions of the policies of these agents in every state.

    Raises:
        ValueError: what a policy raises; rows that are no distributions.
    """
    task, players = states.task, players_of(policies)
    codes = np.zeros((len(players), states.count), dtype=np.uint32)
    rows: list[NDArray[np.float64]] = [np.zeros(0)]
    begins = 0
    for number, seats in enumerate(players):
        policy, width = policies[seats[0]], task.num_actions ** len(seats)
        if isinstance(policy, Scripted):
            known = MoveSets(task.num_moves, task.stay_action)
        for first, games, real in states.chunks():
            part = slice(first, first + len(real))
            if isinstance(policy, Scripted):
                moves = policy.moves(task, games, seats[0])
                codes[number, part] = begins + width * known.numbers(moves[:, 0], moves[:, 1])
                continue
            playing = real & (games.active[:, seats] != 0).any(axis=1)
            found = _checked(_drawn_by(policy, task, games, seats), playing, task, seats, policy)
            slips = [task.slips[seat] for seat in seats]
            moved = mixed_with_random_moves(task, seats, slips, games.position, found)
            rows.append(moved.ravel())
            codes[number, part] = begins + width * np.arange(first, first + len(real))
        if isinstance(policy, Scripted):
            rows.append(known.rows(policy.epsilon, task.slips[seats[0]]).ravel())
        begins = sum(map(len, rows))
    return OtherPolicies(players, codes, np.concatenate(rows))


def _drawn_by(policy: Any, task: Task, games: Games, seats: tuple[int, ...]) -> NDArray[np.float64]:
    """[games, joint actions] float64, what a policy plays in some of its seats."""
    if len(seats) == 1:
        return np.asarray(policy.distribution(task, games, seats[0]), dtype=np.float64)
    role = task.seat_roles[seats[0]]
    team = [seat for seat, other in enumerate(task.seat_roles) if other == role]
    return marginal(policy.joint_distribution(task, games), task, team, seats)


def _checked(
    found: NDArray[np.float64],
    playing: NDArray[np.bool_],
    task: Task,
    seats: tuple[int, ...],
    policy: DistributionPolicy,
) -> NDArray[np.float64]:
    """[games, joint actions] rows normalised to sum to 1; others than `playing` count
    not.

    Raises:
        ValueError: no distribution.
    """
    total = found.sum(axis=1, keepdims=True)
    fine = (np.abs(total[:, 0] - 1.0) < NETWORK_SUM_TOLERANCE) & (found >= 0.0).all(axis=1)
    if found.shape[1] != task.num_actions ** len(seats) or not fine[playing].all():
        raise ValueError(
            f"{policy!r} of {task.agent_names[seats[0]]} returned no distribution over "
            f"the {task.num_actions} actions in some state; rows are non-negative and sum to 1"
        )
    return np.asarray(found / np.where(total > 0.0, total, 1.0))
