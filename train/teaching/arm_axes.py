"""What a curriculum can turn of an arm."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import LEAST_TOLERANCE, ReacherTask
from scripted_agents import least_steps_of
from train.settings.checks import check
from train.settings.curricula import AxisSettings
from train.teaching.axis import Axis, ends_of
from train.teaching.optimum import Optimum

EXACT_JOINTS = 5
"""Up to here the least steps of a start are known within half a millisecond."""


@dataclass(frozen=True)
class ArmGround:
    """The arm that axes are laid over; a `Ground`."""

    task: ReacherTask

    @property
    def default_axis(self) -> str:
        """What `axis="auto"` means."""
        return "target-distance"

    def check_levels(self, name: str) -> None:
        """Starts can be replayed whatever they are."""

    def optimum(self, task: ReacherTask) -> Optimum | None:
        """The least steps of any start; None for many joints, and where actions are discrete."""
        known = self.task.joints <= EXACT_JOINTS and not self.task.discrete_actions

        def steps(
            angles: NDArray[Any],
            target: NDArray[Any],
            tolerance: NDArray[Any],
            free_joints: NDArray[Any],
            hold: NDArray[Any],
        ) -> NDArray[np.float64]:
            least, _, _ = least_steps_of(angles, target, task.max_turn, tolerance, free_joints)
            lengths: NDArray[np.float64] = np.maximum(least, 1.0) + hold - 1.0
            return np.minimum(lengths, task.max_steps)

        return Optimum(_where, steps) if known else None


def _where(simulator: ReacherSimulator, games: NDArray[np.intp]) -> tuple[NDArray[Any], ...]:
    """What the least length of an episode of `games` depends on."""
    arms = simulator.arms
    start = (arms.angles, arms.target, arms.tolerance, arms.free_joints, arms.hold)
    return tuple(array[games] for array in start)


@dataclass(frozen=True)
class ArmMaker:
    """How an axis of an arm is made.

    Attributes:
        make: (name, ground, ends) -> the axis; ValueError for ends that are not allowed.
    """

    make: Callable[[str, ArmGround, AxisSettings], Axis]
    scripted: bool = False
    mazes: bool = False

    def check(self, name: str, ground: Any, ends: AxisSettings) -> None:
        """Raise ValueError for what the task has not."""
        check(
            isinstance(ground, ArmGround),
            f"curriculum {name!r} turns an arm, and task {ground.task.name!r} has none; take "
            "opponent-epsilon, start-distance or goal-spread-start, or task reacher",
        )
        check(
            ends.curriculum_mazes is None,
            f"curriculum_mazes={ends.curriculum_mazes!r}; an arm has no mazes: leave it out",
        )


def target_distance(name: str, ground: ArmGround, ends: AxisSettings) -> Axis:
    """Steps to the target, at most; a half turn of every joint reaches anywhere."""
    longest = math.ceil(math.pi / ground.task.max_turn)
    first, last = ends_of(ends, min(3, longest), longest)
    for value in (first, last):
        check(value > 0, f"{name} of {value:g}; a number of steps above 0")

    def apply(
        simulator: ReacherSimulator, games: NDArray[np.intp], values: NDArray[np.float64]
    ) -> None:
        distances = np.where(values >= longest, -1.0, values)
        simulator.configure(games, target_distance=distances)

    return Axis(name, first, last, apply, whole=False)


def free_joints(name: str, ground: ArmGround, ends: AxisSettings) -> Axis:
    """How many joints turn; the others are locked straight."""
    joints = ground.task.joints
    first, last = ends_of(ends, 1, joints)
    for value in (first, last):
        check(
            1 <= value <= joints and value == int(value),
            f"{value:g} free joints; a whole number from 1 to joints={joints}",
        )

    def apply(
        simulator: ReacherSimulator, games: NDArray[np.intp], values: NDArray[np.float64]
    ) -> None:
        simulator.configure(games, free_joints=values.astype(np.int64))

    return Axis(name, first, last, apply)


def hold(name: str, ground: ArmGround, ends: AxisSettings) -> Axis:
    """Steps in reach that end an episode."""
    first, last = ends_of(ends, 1, ground.task.hold)
    for value in (first, last):
        check(
            1 <= value <= ground.task.max_steps and value == int(value),
            f"{name} of {value:g}; a whole number from 1 to max_steps={ground.task.max_steps}",
        )

    def apply(
        simulator: ReacherSimulator, games: NDArray[np.intp], values: NDArray[np.float64]
    ) -> None:
        simulator.configure(games, hold=values.astype(np.int64))

    return Axis(name, first, last, apply)


def tolerance(name: str, ground: ArmGround, ends: AxisSettings) -> Axis:
    """How near the tip must come."""
    own, most = ground.task.tolerance, 2.0 * ground.task.joints
    first, last = ends_of(ends, min(5.0 * own, most), own)
    for value in (first, last):
        check(
            LEAST_TOLERANCE <= value <= most,
            f"{name} of {value:g}; from {LEAST_TOLERANCE:g} to {most:g}, twice the joints: set the "
            "task's own tolerance, easiest and hardest within",
        )

    def apply(
        simulator: ReacherSimulator, games: NDArray[np.intp], values: NDArray[np.float64]
    ) -> None:
        simulator.configure(games, tolerance=values)

    return Axis(name, first, last, apply, whole=False)


ARM_AXIS_MAKERS: dict[str, ArmMaker] = {
    "target-distance": ArmMaker(target_distance),
    "free-joints": ArmMaker(free_joints),
    "hold": ArmMaker(hold),
    "tolerance": ArmMaker(tolerance),
}
