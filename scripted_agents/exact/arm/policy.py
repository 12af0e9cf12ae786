"""The policy of the arm that moves in the minimum number of steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import whole
from scripted_agents.agents.arm import ArmGoals, Planned
from scripted_agents.exact.arm.least_steps import least_steps_of
from scripted_agents.exact.limits import MAX_ARM_NODES


class LeastStepsPolicy(Planned):
    """Moves in equal steps to a pose that `least_steps` found, and stops there.

    An episode takes max(T, 1) + hold - 1 steps, where T is the upper bound of `least_steps`. Does
    not support discrete actions.

    Args:
        budget: as in `least_steps`.

    Raises:
        ValueError: a budget that is no whole number of at least 0.
    """

    def __init__(self, budget: int = MAX_ARM_NODES) -> None:
        super().__init__()
        self.budget = whole("budget", budget, 0, 2**62)

    def __repr__(self) -> str:
        return f"LeastStepsPolicy(budget={self.budget})"

    def plan(
        self, angles: NDArray[np.float64], aims: ArmGoals
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Planned.plan`, with equal moves in all steps."""
        targets, tolerance, free_joints, (max_turn, *_) = aims
        _, steps, turns = least_steps_of(
            angles, targets, max_turn, tolerance, free_joints, self.budget
        )
        whole_turns = np.maximum(steps, 1)[:, None] * max_turn
        return np.clip(turns / whole_turns, -1.0, 1.0), steps.astype(np.float64)
