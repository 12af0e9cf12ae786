"""The settings of an arm: the frozen dataclass `ReacherTask`."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.validation import (
    Flag,
    Rule,
    WholeFrom1,
    check_fields,
    choice,
    named_settings,
    number,
    whole,
    whole_numbers,
)

MAX_JOINTS = 8
LEAST_TURN = 1e-4
"""Slower joints would need too many steps for half a turn."""
LEAST_TOLERANCE = 1e-6
"""Smaller tolerances are affected by rounding, so minimal steps would not be computable."""
STARTS = ("kept", "random", "fixed")
Joints = Annotated[int, Rule(lambda name, value: whole(name, value, 1, MAX_JOINTS))]


def _number(least: float, most: float) -> Rule:
    """Numbers in this range."""
    return Rule(lambda name, value: number(name, value, least, most))


@dataclass(frozen=True)
class ReacherTask:
    """An arm of `joints` links of length 1 that moves its tip to a target in the plane.

    A step turns each joint by up to `max_turn`. The reward is -distance / (2 joints) minus `effort`
    times the sum of the absolute actions. The angle of the target is uniform, and its radius is
    uniform in [0, joints], but 1 for one joint.

    Args:
        joints: 1 to 8.
        start: the first pose of an episode: "kept", the last one of the previous episode (at first
            random); "random", every angle uniform; "fixed", straight along the x-axis.
        hold: consecutive steps with the tip in reach that end the episode.
        tolerance: the tip is in reach within this distance of the target.
        max_steps: episodes are truncated after this many steps.
        max_turn: turn of a joint by an action of 1, in radians.
        effort: cost of an action of 1, per joint.
        discrete_actions: restricts the action of a joint to -1, 0 or 1.

    Raises:
        ValueError: an invalid value; the message names the rule and the remedy.
    """

    name: ClassVar[str] = "reacher"
    """The name of the task in results."""
    steps_per_round: ClassVar[int] = 1
    """As of `pursuit.Task`, where a round of turns has two."""

    joints: Joints = 2
    start: Annotated[str, choice(*STARTS)] = "kept"
    hold: WholeFrom1 = 1
    tolerance: Annotated[float, _number(LEAST_TOLERANCE, math.inf)] = 0.2
    max_steps: WholeFrom1 = 400
    max_turn: Annotated[float, _number(LEAST_TURN, math.pi)] = 0.1
    effort: Annotated[float, _number(0.0, 1e30)] = 0.01  # rewards are float32
    discrete_actions: Flag = False

    def __post_init__(self) -> None:
        check_fields(self)
        if self.hold > self.max_steps:
            raise ValueError(f"hold={self.hold} is above max_steps={self.max_steps}; lower hold")

    agent_names: ClassVar[tuple[str, ...]] = ("arm",)
    seat_roles: ClassVar[tuple[str, ...]] = ("arm",)
    """One agent turns all joints."""
    num_agents: ClassVar[int] = 1

    def seat(self, agent: str | int) -> int:
        """0, the index of the arm; ValueError for another agent."""
        if agent not in ("arm", 0):
            raise ValueError(f"agent {agent!r}; give 'arm'")
        return 0

    @property
    def num_choices(self) -> int:
        """Number of discrete actions of the whole arm: 3 per joint, in all combinations."""
        return 3**self.joints

    @property
    def numbers_for_kernels(self) -> tuple[int, int, float, float]:
        """The fields of `rules.Rules`."""
        return STARTS.index(self.start), self.max_steps, self.max_turn, self.effort

    def actions_of(self, choices: ArrayLike) -> NDArray[np.float64]:
        """[..., joints] in {-1, 0, 1}: the turns of choices [...] from 0 to 3**joints - 1.

        The first joint is the most significant digit: with two joints 0 is (-1, -1), 1 is (-1, 0),
        and 4 is stay.

        Raises:
            ValueError: a choice out of range.
        """
        chosen = whole_numbers("choices", choices, 0, self.num_choices - 1)
        digits = 3 ** np.arange(self.joints - 1, -1, -1)
        return (chosen[..., None] // digits % 3 - 1).astype(np.float64)

    def check_targets(
        self,
        targets: NDArray[np.float64],
        free_joints: ArrayLike,
        tolerance: ArrayLike | None = None,
    ) -> None:
        """Raise ValueError for an unreachable target.

        Args:
            targets: [arms, 2] float64.
            free_joints: number of joints that turn, per arm or for all; the others are straight.
            tolerance: per arm or for all; default: the tolerance of the task.
        """
        radii = np.hypot(targets[:, 0], targets[:, 1])
        free = np.broadcast_to(free_joints, radii.shape)
        least = np.maximum(self.joints - 2 * free + 2, 0)  # as in `rules.least_radius`
        allowed = np.broadcast_to(self.tolerance if tolerance is None else tolerance, radii.shape)
        within = allowed - 1e-9  # no targets that are reachable by rounding only
        wrong = (radii - self.joints > within) | (least - radii > within)
        if wrong.any():
            x, y = targets[wrong][0].tolist()
            raise ValueError(
                f"target ({x}, {y}) is out of reach; the tip of {self.joints} joint(s) of which "
                f"{free[wrong][0]} turn has radius {least[wrong][0]} to {self.joints}, and "
                f"tolerance={allowed[wrong][0]}: give a reachable target"
            )


def make_reacher_task(**settings: Any) -> ReacherTask:
    """Create a `ReacherTask`; `max_cycles` (PettingZoo's name) is accepted for `max_steps`.

    Raises:
        ValueError: invalid settings.
        TypeError: an unknown setting.
    """
    known = [field.name for field in fields(ReacherTask)]
    return ReacherTask(**named_settings("make_reacher_task", settings, known))
