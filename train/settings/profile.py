"""The properties of a task that tuned settings depend on."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class TaskProfile:
    """The properties of a task that tuned settings depend on.

    Attributes:
        task: its name.
        role: of the learning agent: "chaser", "evader", "runner" or "arm".
        cells: of the largest maze.
        random_start: whether starts are random; False: the marks of the maze.
        duel: whether one chaser plays against one evader.
        joints: of an arm.
        recurrent: whether the network is recurrent.
        many_mazes: whether games are played in several mazes, as those of a suite.
        goals: of an episode.
        tuned: the table of tuned settings in `tuned.toml`.
    """

    task: str
    role: str
    cells: int
    random_start: bool = True
    duel: bool = False
    joints: int = 0
    recurrent: bool = False
    many_mazes: bool = False
    goals: int = 0
    tuned: str = "mazes"

    @property
    def many_goals(self) -> float:
        """Position of the number of goals between 3 (0) and 8 (1)."""
        return on_the_way(self.goals, 3, 8)

    @property
    def far_evader(self) -> float:
        """Position of a chaser's maze size between 25 cells (0) and 49 (1)."""
        far = self.random_start and self.role == "chaser"
        return on_the_way(self.cells, 25, 49) if far else 0.0

    @property
    def far_goals(self) -> float:
        """Position of a runner's maze size between 25 cells (0) and 81 (1)."""
        far = self.random_start and self.role == "runner"
        return on_the_way(self.cells, 25, 81) if far else 0.0

    @property
    def recurrent_and_near(self) -> bool:
        """Whether the network is recurrent, and evaders or goals are never far."""
        return self.recurrent and not self.far_evader and not self.far_goals

    @property
    def many_joints(self) -> bool:
        """Whether an arm has more than two joints."""
        return self.joints > 2

    @property
    def unseen_mazes(self) -> bool:
        """Whether a runner learns to plan in any maze."""
        return self.many_mazes and self.random_start and self.role == "runner"


def on_the_way(count: int, start: int, end: int) -> float:
    """Logarithmic position of `count` between `start` and `end`, clipped to [0, 1]."""
    return min(max(math.log(count / start) / math.log(end / start), 0.0), 1.0) if count else 0.0
