"""Policies of the arm: random, and inverse kinematics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.policy import ArmView
from pursuit.rules.arrays import Array
from pursuit.validation import number, one_of, whole
from scripted_agents.agents import arm_kernels

IK_METHODS = ("transpose", "pseudo-inverse", "damped", "cyclic")
"""The methods in the order of their numbers in the kernels."""

DAMPING = 0.3
"""Default of the damped method, in link lengths."""
AS_PLANNED = 1e-6
"""Difference in radians of a pose from its plan above which the episode is planned again."""


class RandomArm:
    """Uniformly random actions of all joints, in [-1, 1] or from three discrete values.

    Random numbers are from the streams of the arms.
    """

    def __repr__(self) -> str:
        return "RandomArm()"

    def act(self, view: ArmView) -> NDArray[np.float64]:
        """[num_games, joints] float64 in [-1, 1]."""
        drawn = np.stack([view.uniform() for _ in range(view.task.joints)], axis=1)
        return np.floor(3.0 * drawn) - 1.0 if view.task.discrete_actions else 2.0 * drawn - 1.0


class InverseKinematics:
    """Moves towards the target by inverse kinematics, and stops within the tolerance.

    `scripted_agents.agents.arm_kernels` describes the methods and cites their sources. In a
    singular pose, such as a straight arm that points at the target, the arm is bent for one step.

    Args:
        method: "transpose" or "pseudo-inverse" of the Jacobian, "damped" least squares, or
            "cyclic" coordinate descent.
        damping: of the damped method, in link lengths; above 0.

    Raises:
        ValueError: another method, or a damping that is not above 0.
    """

    def __init__(self, method: str = "damped", damping: float = DAMPING) -> None:
        self.method = one_of("method", method, IK_METHODS)
        self.damping = number("damping", damping)
        if self.damping <= 0.0:
            raise ValueError(
                f"damping={damping}; give a number above 0, or method='pseudo-inverse'"
            )

    def __repr__(self) -> str:
        return f"InverseKinematics({self.method!r}, damping={self.damping:g})"

    def act(self, view: ArmView) -> NDArray[np.float64]:
        """[num_games, joints] float64 in [-1, 1]."""
        actions = np.empty(view.angles.shape)
        arm_kernels.turn_arms(
            IK_METHODS.index(self.method), view.angles, view.targets, view.tolerance,
            view.free_joints, view.task.max_turn, self.damping, actions,
        )  # fmt: skip
        return actions


class ArmGoals(NamedTuple):
    """The targets of arms [games, 2], and their tolerance, free joints and `max_turn` [games], the
    radians of an action of 1."""

    targets: Array
    tolerance: Array
    free_joints: Array
    max_turn: Array


class Planned(ABC):
    """Plans an episode at its start, and again if the pose or target differs from the plan.

    There is a plan for each arm of the batch. It is a constant action for a number of steps that
    need not be whole; only that part of the last action is taken. After that the arm does not move.
    """

    def __init__(self) -> None:
        self._aims: ArmGoals | None = None
        self._angles: NDArray[np.float64] = np.zeros((0, 0))
        self._actions: NDArray[np.float64] = np.zeros((0, 0))
        self._left: NDArray[np.float64] = np.zeros(0)

    def act(self, view: ArmView) -> NDArray[np.float64]:
        """[num_games, joints] float64 in [-1, 1]."""
        turn = np.full(view.num_games, view.task.max_turn)
        aims = ArmGoals(view.targets, view.tolerance, view.free_joints, turn)
        if self._aims is None or self._angles.shape != view.angles.shape:
            self._aims = ArmGoals(*(np.zeros_like(array) for array in aims))
            self._angles, self._actions = np.zeros((2, *view.angles.shape))
            self._left = np.zeros(view.num_games)
        pairs: list[tuple[Array, Array]] = list(zip(aims, self._aims, strict=True))
        off = (view.angles - self._angles + np.pi) % (2.0 * np.pi) - np.pi
        new = (view.steps == 0) | (np.abs(off) > AS_PLANNED).any(axis=1)
        # By rounding the tip can be just outside the tolerance at the end of a plan.
        away = np.hypot(*(view.ends[:, -1] - view.targets).T)
        new |= (self._left <= 0.0) & (away > view.tolerance)
        for array, planned in pairs:
            new |= (array != planned).reshape(view.num_games, -1).any(axis=1)
        if new.any():
            for array, planned in pairs:
                planned[new] = array[new]
            self._angles[new] = view.angles[new]
            changed = ArmGoals(*(array[new] for array in aims))
            self._actions[new], self._left[new] = self.plan(view.angles[new], changed)
        part = np.minimum(self._left, 1.0)
        actions: NDArray[np.float64] = part[:, None] * self._actions
        self._left -= part
        self._angles += view.task.max_turn * actions
        return actions

    @abstractmethod
    def plan(
        self, angles: NDArray[np.float64], aims: ArmGoals
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """[games, joints] float64 actions in [-1, 1] from these angles [games, joints], and [games]
        float64 the number of steps."""


class ThesisInverseKinematics(Planned):
    """The baseline of the thesis (section 3.3.1): computes a pose at the target, then moves there.

    The pose is the result of pseudo-inverse iterations from the current pose. Every joint turns in
    the shorter direction. The joint with the largest turn takes full steps, the others proportional
    ones.

    Args:
        precision: largest distance between tip and target in the computed pose.
        iterations: maximum number of iterations.

    Raises:
        ValueError: a precision that is not above 0, or no iterations.
    """

    def __init__(self, precision: float = 1e-3, iterations: int = 1000) -> None:
        super().__init__()
        self.precision = number("precision", precision)
        self.iterations = whole("iterations", iterations, 1)
        if self.precision <= 0.0:
            raise ValueError(f"precision={precision}; give a number above 0")

    def __repr__(self) -> str:
        return f"ThesisInverseKinematics({self.precision:g}, {self.iterations})"

    def plan(
        self, angles: NDArray[np.float64], aims: ArmGoals
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Planned.plan`, with a largest action of 1."""
        goals, scratch = angles.copy(), np.empty_like(angles)
        arm_kernels.solve_arms(
            arm_kernels.PSEUDO_INVERSE, goals, aims.targets, aims.free_joints, DAMPING,
            self.precision, self.iterations, scratch,
        )  # fmt: skip
        turns = (goals - angles + np.pi) % (2.0 * np.pi) - np.pi
        largest = np.abs(turns).max(axis=1)
        return turns / np.where(largest > 0.0, largest, 1.0)[:, None], largest / aims.max_turn
