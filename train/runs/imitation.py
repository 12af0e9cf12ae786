"""The policy that a learner imitates at first."""

from __future__ import annotations

import warnings
from typing import Any

from pursuit.validation import check
from train.algorithms.registry import Algorithm
from train.environments.batch_env import Expert
from train.families.family import TaskWorld
from train.networks.seat import Seat
from train.runs.opponents import policy_of
from train.settings.common import RunSettings

OPTIMAL = "optimal"
"""The name of the exact best response to the other agents."""
TRIED = 2
"""Games in which a policy is asked before training."""


class ImitationError(ValueError):
    """A policy that cannot be imitated; not the fault of a checkpoint of its learner."""


def expert_of(
    settings: RunSettings, world: TaskWorld, seat: Seat, algorithm: Algorithm, frames: int = 0
) -> Expert | None:
    """What a learner of these settings imitates; None without `imitate`, and when it is over.

    Args:
        settings: of the run.
        world: its task with the other agents.
        seat: the learning agent or team in the training games.
        algorithm: of the learner.
        frames: of the learner so far.

    Raises:
        ValueError: an algorithm or seat that cannot imitate; an unknown policy, one with memory, or
            of another game, role or other actions; an optimum that is not known.
    """
    name = settings.imitate
    if name is None or frames >= settings.imitate_frames:
        return None
    algorithm.check_imitation(name, seat)
    if settings.frames is not None and settings.imitate_frames > settings.frames:
        warnings.warn(
            f"imitate_frames={settings.imitate_frames} with frames={settings.frames}: the run ends "
            f"before the imitation does; give at most {settings.frames} imitate_frames",
            stacklevel=2,
        )
    try:
        policy = imitated(name, world, seat)
    except ValueError as error:
        raise ImitationError(f"imitate={name!r}: {error}") from None
    return Expert(policy, settings.imitate_frames)


def imitated(name: str, world: TaskWorld, seat: Seat) -> Any:
    """The policy of this name for a learner; ValueError as `expert_of`."""
    policy: Any
    if name == OPTIMAL:
        mazes = [getattr(task, "mazes", None) for task in (seat.task, world.task)]
        check(
            mazes[0] == mazes[1],
            "with a curriculum of other mazes, in which the optimum is not solved; leave one of "
            "the two out",
        )
        policy = world.optimal_policy()
    else:
        policy = policy_of(world.settings, name, world.task, seat.role)
    check(
        not hasattr(policy, "begin"),
        "is a policy with memory, which says nothing about states that it did not lead to itself; "
        "give one without memory",
    )
    games = world.BATCH(seat.task, TRIED, 0, 0, auto_restart=False)
    agents = slice(seat.number, seat.number + (seat.members if seat.team else 1))
    seat.probabilities_of(policy, games, agents)
    return policy
