"""What a policy may see of a batch of arms, and what it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.rules import POLICY_STREAM, Arms
from pursuit.reacher.task import ReacherTask
from pursuit.rules.randomness import draw_uniform


@dataclass(frozen=True, eq=False)
class ArmView:
    """A batch of arms: live arrays of the `ReacherSimulator`, not copies.

    Attributes:
        task: the rules and settings.
        arms: the state under the names of the rule book.
        streams: [num_games, ...] uint64, the random streams; a policy draws by `uniform` and
            `normal` only.
        observe: `observe(encoding)` -> [num_games, numbers] float32.
    """

    task: ReacherTask
    arms: Arms
    streams: NDArray[np.uint64]
    observe: Callable[[str], NDArray[np.float32]]

    @property
    def num_games(self) -> int:
        """Arms in the batch."""
        return len(self.arms.steps)

    @property
    def angles(self) -> NDArray[np.float64]:
        """[num_games, joints] float64, radians in [-pi, pi), each from the link before."""
        return self.arms.angles

    @property
    def targets(self) -> NDArray[np.float64]:
        """[num_games, 2] float64."""
        return self.arms.target

    @property
    def ends(self) -> NDArray[np.float64]:
        """[num_games, joints, 2] float64, where every link ends; the last one is the tip."""
        return self.arms.ends

    @property
    def tolerance(self) -> NDArray[np.float64]:
        """[num_games] float64, how near the tip must come."""
        return self.arms.tolerance

    @property
    def free_joints(self) -> NDArray[np.int32]:
        """[num_games] int32, joints that turn; those after them are locked straight."""
        return self.arms.free_joints

    @property
    def steps(self) -> NDArray[np.int32]:
        """[num_games] int32, steps taken in the episode."""
        return self.arms.steps

    @property
    def held(self) -> NDArray[np.int32]:
        """[num_games] int32, steps that the tip has been in reach without a break."""
        return self.arms.held

    def uniform(self) -> NDArray[np.float64]:
        """[num_games] float64 in [0, 1), from the policy's own random stream, which moves on."""
        numbers = np.empty(self.num_games)
        draw_uniform(self.streams, POLICY_STREAM, numbers)
        return numbers

    def normal(self) -> NDArray[np.float64]:
        """[num_games, joints] float64, standard normal (Box and Muller, 1958)."""
        joints = self.task.joints
        drawn = np.stack([self.uniform() for _ in range(2 * joints)], axis=1)
        lengths = np.sqrt(-2.0 * np.log1p(-drawn[:, :joints]))
        return lengths * np.cos(2.0 * np.pi * drawn[:, joints:])


class ArmPolicy(Protocol):
    """Whoever moves an arm: kinematic, exact or learned."""

    def act(self, view: ArmView) -> NDArray[Any]:
        """[num_games, joints] floats in [-1, 1].

        Draw random numbers from the view only, so that an arm does not depend on the batch that it
        is in.
        """
        ...
