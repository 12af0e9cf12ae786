"""Who moves an arm without learning: at random, by inverse kinematics, or in the least steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.declared import number, one_of, whole
from pursuit.reacher.policy import ArmView
from scripted_agents import arm_kernels
from scripted_agents.least_steps import BUDGET, least_steps_of

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

    `scripted_agents.arm_kernels` says what the methods do, and whose they are. Where a method finds
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


class Planned:
    """Plans all of an episode at its start, and again where an arm is not as the plan has it.

    Plans are kept by the number of the arm in the batch. A plan is a constant action for a number
    of steps, which need not be whole: of the last one only a part is played. Then the arm holds
    still.
    """

    def __init__(self) -> None:
        self._plans: dict[str, NDArray[Any]] = {}

    def act(self, view: ArmView) -> NDArray[np.float64]:
        """[num_games, joints] float64 in [-1, 1]."""
        max_turn = view.task.max_turn
        aims: dict[str, NDArray[Any]] = {
            "targets": view.targets,
            "tolerance": view.tolerance,
            "free": view.free_joints,
            "max_turn": np.full(view.num_games, max_turn),
        }
        old = self._plans
        if not old or old["angles"].shape != view.angles.shape:
            old = self._plans = {name: np.zeros_like(array) for name, array in aims.items()}
            old["angles"], old["actions"] = np.zeros((2, *view.angles.shape))
            old["left"] = np.zeros(view.num_games)
            new = np.ones(view.num_games, dtype=bool)
        else:
            off = (view.angles - old["angles"] + np.pi) % (2.0 * np.pi) - np.pi
            new = (view.steps == 0) | (np.abs(off) > AS_PLANNED).any(axis=1)
            # Who did only nearly as planned may stand a hair out of reach when the plan is over.
            away = np.hypot(*(view.ends[:, -1] - view.targets).T)
            new |= (old["left"] <= 0.0) & (away > view.tolerance)
            for name, array in aims.items():
                new |= (array != old[name]).reshape(view.num_games, -1).any(axis=1)
        games = np.flatnonzero(new)
        if len(games):
            for name, array in aims.items():
                old[name][games] = array[games]
            old["angles"][games] = view.angles[games]
            old["actions"][games], old["left"][games] = self.plan(
                view.angles[games],
                view.targets[games],
                view.tolerance[games],
                view.free_joints[games],
                max_turn,
            )
        part = np.minimum(old["left"], 1.0)
        actions: NDArray[np.float64] = part[:, None] * old["actions"]
        old["left"] -= part
        old["angles"] += max_turn * actions
        return actions

    def plan(
        self,
        angles: NDArray[np.float64],
        targets: NDArray[np.float64],
        tolerance: NDArray[np.float64],
        free_joints: NDArray[np.int32],
        max_turn: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """[games, joints] float64 actions in [-1, 1], and [games] float64, how many steps of them.

        Args:
            angles: [games, joints] radians.
            targets: [games, 2].
            tolerance: [games].
            free_joints: [games].
            max_turn: radians of a whole action.
        """
        raise NotImplementedError


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
        self,
        angles: NDArray[np.float64],
        targets: NDArray[np.float64],
        tolerance: NDArray[np.float64],
        free_joints: NDArray[np.int32],
        max_turn: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Planned.plan`: equal moves."""
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
        self,
        angles: NDArray[np.float64],
        targets: NDArray[np.float64],
        tolerance: NDArray[np.float64],
        free_joints: NDArray[np.int32],
        max_turn: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Planned.plan`: the largest action is 1."""
        goals, room = angles.copy(), np.empty_like(angles)
        arm_kernels.solve_arms(
            arm_kernels.PSEUDO_INVERSE, goals, targets, free_joints, DAMPING, self.precision,
            self.iterations, room,
        )  # fmt: skip
        turns = (goals - angles + np.pi) % (2.0 * np.pi) - np.pi
        largest = np.abs(turns).max(axis=1)
        return turns / np.where(largest > 0.0, largest, 1.0)[:, None], largest / max_turn
