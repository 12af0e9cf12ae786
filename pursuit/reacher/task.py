"""ReacherTask: one frozen, validated description of an arm and what it is to do."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.validation import (
    check_fields,
    choice,
    count,
    declared,
    flag,
    named_settings,
    number,
    whole,
    whole_numbers,
)

MAX_JOINTS = 8
LEAST_TURN = 1e-4
"""Slower joints would need more steps for half a turn than is worth searching."""
LEAST_TOLERANCE = 1e-6
"""What is nearer is a matter of rounding, and the least steps could not be told."""
STARTS = ("kept", "random", "fixed")


def _from(least: float, most: float = math.inf) -> Callable[[str, Any], float]:
    """A check of a field: a finite number in that range."""
    rule = f"at least {least:g}" + (f" and at most {most:g}" if most < math.inf else "")

    def check(name: str, value: Any) -> float:
        found = number(name, value)
        if not least <= found <= most:
            raise ValueError(f"{name}={value}; it is {rule}")
        return found

    return check


@dataclass(frozen=True)
class ReacherTask:
    """An arm of `joints` links of length 1 that is to bring its tip to a target in the plane.

    Every step turns each joint by up to `max_turn`; the reward is -distance / (2 joints) less
    `effort` for each joint's share of the turn. The target lies on the rim where there is one
    joint, else at a radius uniform in [0, joints] and a uniform angle.

    Args:
        joints: 1 to 8.
        start: the pose of an episode: "kept" is that in which the last episode ended (the first
            one's is drawn), "random" draws every angle uniformly, "fixed" is straight along the
            x-axis.
        hold: steps in a row after which the tip must be in reach, for the episode to end.
        tolerance: it is in reach within this distance of the target.
        max_steps: an episode of this many steps is truncated.
        max_turn: radians that an action of 1 turns a joint.
        effort: cost of that.
        discrete_actions: whether every joint only turns fully, back or forth, or not at all.

    Raises:
        ValueError: naming the value, the rule and the remedy.
    """

    joints: int = declared(lambda name, value: whole(name, value, 1, MAX_JOINTS), default=2)
    start: str = choice(STARTS, default="kept")
    hold: int = count(1, default=1)
    tolerance: float = declared(_from(LEAST_TOLERANCE), default=0.2)
    max_steps: int = count(1, default=400)
    max_turn: float = declared(_from(LEAST_TURN, math.pi), default=0.1)
    effort: float = declared(_from(0.0), default=0.01)
    discrete_actions: bool = flag(False)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.hold > self.max_steps:
            raise ValueError(
                f"hold={self.hold} of max_steps={self.max_steps}; no episode can succeed: lower it"
            )

    @property
    def name(self) -> str:
        """What results call this task."""
        return "reacher"

    @property
    def num_choices(self) -> int:
        """How many discrete actions the whole arm has: 3 for each joint."""
        return 3**self.joints

    @property
    def numbers_for_kernels(self) -> tuple[int, int, float, float]:
        """As `rules.Rules` has them."""
        return STARTS.index(self.start), self.max_steps, self.max_turn, self.effort

    def actions_of(self, choices: ArrayLike) -> NDArray[np.float64]:
        """[..., joints] in {-1, 0, 1}: the turns that choices [...] from 0 to 3**joints - 1 mean.

        The first joint's turn counts most: with two joints 0 is (-1, -1), 1 is (-1, 0), 4 is stay.

        Raises:
            ValueError: what is no choice.
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
        """Raise ValueError for a target that no pose reaches.

        Args:
            targets: [arms, 2] float64.
            free_joints: how many joints turn, in each arm or in all; the others are straight.
            tolerance: of each arm or of all; the task's own by default.
        """
        radii = np.hypot(targets[:, 0], targets[:, 1])
        free = np.broadcast_to(free_joints, radii.shape)
        least = np.maximum(self.joints - 2 * free + 2, 0)  # as `rules.least_radius` has it
        allowed = np.broadcast_to(self.tolerance if tolerance is None else tolerance, radii.shape)
        within = allowed - 1e-9  # what rounding alone could reach is out of reach
        wrong = (radii - self.joints > within) | (least - radii > within)
        if wrong.any():
            x, y = targets[wrong][0].tolist()
            raise ValueError(
                f"target ({x}, {y}) is out of reach; the tip of {self.joints} joint(s) of which "
                f"{free[wrong][0]} turn goes from radius {least[wrong][0]} to {self.joints}, and "
                f"tolerance={allowed[wrong][0]} beyond: put it nearer"
            )


def make_reacher_task(**settings: Any) -> ReacherTask:
    """The arm with `settings` of `ReacherTask` changed.

    `max_cycles` is PettingZoo's name of `max_steps`.

    Raises:
        ValueError: settings that make no game.
        TypeError: an unknown setting, as an unknown keyword is everywhere.
    """
    known = [field.name for field in fields(ReacherTask)]
    return ReacherTask(**named_settings("make_reacher_task", settings, known))
