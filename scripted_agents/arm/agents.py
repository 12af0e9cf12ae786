"""Policies of the arm without learning: random, inverse kinematics, and least steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.policy import ArmView
from pursuit.validation import number, one_of, whole
from scripted_agents.arm import kernels as arm_kernels
from scripted_agents.arm.least_steps import BUDGET, least_steps_of

IK_METHODS = ("transpose", "pseudo-inverse", "damped", "cyclic")
"""In the order of their numbers in the kernels."""

DAMPING = 0.3
"""Of the damped method, in link lengths."""
AS_PLANNED = 1e-6
"""A pose may be off its plan by so many radians."""


class RandomArm:
    """Turns every joint by a uniformly random part of a step, or of three choices where discrete.

    Random numbers come from the arms' own streams.
    """

    def __repr__(self) -> str:
        return "RandomArm()"

    def act(self, view: ArmView) -> NDArray[np.float64]:
        """[num_games, joints] float64 in [-1, 1]."""
        drawn = np.stack([view.uniform() for _ in range(view.task.joints)], axis=1)
        return np.floor(3.0 * drawn) - 1.0 if view.task.discrete_actions else 2.0 * drawn - 1.0


class InverseKinematics:
    """Turns towards the target as the pose of the moment says, and holds still in reach of it.

    `scripted_agents.arm.kernels` describes the methods and their sources. Where a method finds
    no way, as when a straight arm points at the target, the arm is bent for a step.

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
            raise ValueError(f"damping={damping}; it is above 0: take the pseudo-inverse for none")

    def __repr__(self) -> str:
        return f"InverseKinematics({self.method!r}, damping={self.damping:g})"

    def act(self, view: ArmView) -> NDArray[np.float64]:
        """[num_games, joints] float64 in [-1, 1]."""
        actions = np.empty(view.angles.shape)
        arm_kernels.turn_arms(
            IK_METHODS.index(self.method),
            view.angles,
            view.targets,
            view.tolerance,
            view.free_joints,
            view.task.max_turn,
            self.damping,
            actions,
        )
        return actions


class ArmGoals(NamedTuple):
    """What arms are to reach, and how: [games, 2], [games], [games], [games]; `max_turn` is the
    radians of a whole action."""

    targets: NDArray[Any]
    tolerance: NDArray[Any]
    free_joints: NDArray[Any]
    max_turn: NDArray[Any]


class Planned(ABC):
    """Plans all of an episode at its start, and again where an arm is not as the plan has it.

    Plans are kept by the number of the arm in the batch. A plan is a constant action for a number
    of steps, which need not be whole: of the last one only a part is played. Then the arm holds
    still.
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
        pairs: list[tuple[NDArray[Any], NDArray[Any]]] = list(zip(aims, self._aims, strict=True))
        off = (view.angles - self._angles + np.pi) % (2.0 * np.pi) - np.pi
        new = (view.steps == 0) | (np.abs(off) > AS_PLANNED).any(axis=1)
        # Rounding can leave the tip just out of reach at the end of a plan.
        away = np.hypot(*(view.ends[:, -1] - view.targets).T)
        new |= (self._left <= 0.0) & (away > view.tolerance)
        for array, planned in pairs:
            new |= (array != planned).reshape(view.num_games, -1).any(axis=1)
        if new.any():
            for array, planned in pairs:
                planned[new] = array[new]
            self._angles[new] = view.angles[new]
            given = ArmGoals(*(array[new] for array in aims))
            self._actions[new], self._left[new] = self.plan(view.angles[new], given)
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
        float64, how many steps of them."""


class LeastStepsPolicy(Planned):
    """Goes straight to a pose that is in reach after the least steps, and holds still there.

    An episode takes max(T, 1) + hold - 1 steps, with T the upper bound of `least_steps`. Those with
    discrete actions cannot be played so.

    Args:
        budget: as in `least_steps`.

    Raises:
        ValueError: a budget that is no whole number from 0 on.
    """

    def __init__(self, budget: int = BUDGET) -> None:
        super().__init__()
        self.budget = whole("budget", budget, 0, 2**62)

    def __repr__(self) -> str:
        return f"LeastStepsPolicy(budget={self.budget})"

    def plan(
        self, angles: NDArray[np.float64], aims: ArmGoals
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Planned.plan`: equal moves."""
        targets, tolerance, free_joints, (max_turn, *_) = aims
        _, steps, turns = least_steps_of(
            angles, targets, max_turn, tolerance, free_joints, self.budget
        )
        whole_turns = np.maximum(steps, 1)[:, None] * max_turn
        return np.clip(turns / whole_turns, -1.0, 1.0), steps.astype(np.float64)


class ThesisInverseKinematics(Planned):
    """The thesis' baseline (section 3.3.1): finds a pose at the target, then goes there.

    The pose is where iterations of the pseudo-inverse end that begin at the present one. The way
    there is straight, each joint going the shorter way round; the one with the farthest to go turns
    by whole steps, and the others in proportion.

    Args:
        precision: the pose puts the tip so near to the target.
        iterations: at most.

    Raises:
        ValueError: a precision that is not above 0, or no iterations.
    """

    def __init__(self, precision: float = 1e-3, iterations: int = 1000) -> None:
        super().__init__()
        self.precision = number("precision", precision)
        self.iterations = whole("iterations", iterations, 1)
        if self.precision <= 0.0:
            raise ValueError(f"precision={precision}; it is above 0")

    def __repr__(self) -> str:
        return f"ThesisInverseKinematics({self.precision:g}, {self.iterations})"

    def plan(
        self, angles: NDArray[np.float64], aims: ArmGoals
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Planned.plan`: the largest action is 1."""
        goals, room = angles.copy(), np.empty_like(angles)
        arm_kernels.solve_arms(
            arm_kernels.PSEUDO_INVERSE, goals, aims.targets, aims.free_joints, DAMPING,
            self.precision, self.iterations, room,
        )  # fmt: skip
        turns = (goals - angles + np.pi) % (2.0 * np.pi) - np.pi
        largest = np.abs(turns).max(axis=1)
        return turns / np.where(largest > 0.0, largest, 1.0)[:, None], largest / aims.max_turn
