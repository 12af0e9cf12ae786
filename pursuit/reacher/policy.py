"""The view of arms for policies, and the protocol of policies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.rules import POLICY_STREAM, Arms
from pursuit.reacher.task import ReacherTask
from pursuit.rules.arrays import Array
from pursuit.rules.randomness import uniform_numbers


class ArmArrays:
    """The arrays of a batch of arms (`arms`) under their public names."""

    arms: Arms

    @property
    def angles(self) -> NDArray[np.float64]:
        """[num_games, joints] float64, radians in [-pi, pi), each relative to the link before."""
        return self.arms.angles

    @property
    def targets(self) -> NDArray[np.float64]:
        """[num_games, 2] float64, positions of the targets."""
        return self.arms.target

    @property
    def ends(self) -> NDArray[np.float64]:
        """[num_games, joints, 2] float64, the end of every link; the last one is the tip."""
        return self.arms.ends

    @property
    def tips(self) -> NDArray[np.float64]:
        """[num_games, 2] float64, the positions of the tips; the bases are at (0, 0)."""
        return self.arms.ends[:, -1]

    @property
    def tolerance(self) -> NDArray[np.float64]:
        """[num_games] float64, the maximal distance from tip to target for success."""
        return self.arms.tolerance

    @property
    def free_joints(self) -> NDArray[np.int32]:
        """[num_games] int32, number of joints that turn; later joints are locked straight."""
        return self.arms.free_joints

    @property
    def steps(self) -> NDArray[np.int32]:
        """[num_games] int32, steps of the episode so far."""
        return self.arms.steps

    @property
    def held(self) -> NDArray[np.int32]:
        """[num_games] int32, consecutive steps with the tip in reach."""
        return self.arms.held


@dataclass(frozen=True, eq=False)
class ArmView(ArmArrays):
    """A batch of arms: live arrays of the `ReacherSimulator`, not copies.

    Attributes:
        task: the task.
        arms: the state.
        streams: [num_games, ...] uint64, the random streams; policies draw with `uniform` and
            `normal`.
        observe: `observe(encoding)` -> [num_games, numbers] float32.
    """

    task: ReacherTask
    arms: Arms
    streams: NDArray[np.uint64]
    observe: Callable[[str], NDArray[np.float32]]

    @property
    def num_games(self) -> int:
        """Number of arms in the batch."""
        return len(self.arms.steps)

    def uniform(self) -> NDArray[np.float64]:
        """[num_games] float64 in [0, 1), drawn from the random stream of policies."""
        return uniform_numbers(self.streams, POLICY_STREAM)

    def normal(self) -> NDArray[np.float64]:
        """[num_games, joints] float64, standard normal (Box and Muller, 1958)."""
        joints = self.task.joints
        drawn = np.stack([self.uniform() for _ in range(2 * joints)], axis=1)
        lengths = np.sqrt(-2.0 * np.log1p(-drawn[:, :joints]))
        return lengths * np.cos(2.0 * np.pi * drawn[:, joints:])


class ArmPolicy(Protocol):
    """A policy of arms: kinematic, exact or learned."""

    def act(self, view: ArmView) -> Array:
        """[num_games, joints] floats in [-1, 1].

        Draw random numbers from the view only, so that results do not depend on the batch size.
        """
        ...
