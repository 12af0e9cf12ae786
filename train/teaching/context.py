"""The task for which a curriculum is built, with the opponents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from pursuit.mazes.maze import Maze
from pursuit.reacher.task import ReacherTask
from pursuit.tasks.task import Task
from pursuit.validation import check
from train.teaching.optimum import Optimum, arm_optimum, optimum_of

NEEDS = {
    "arm": "an arm",
    "in_mazes": "games in mazes",
    "goals": "goals",
    "random_starts": "random starts",
    "scripted": "opponents, all of them scripted",
    "both": "chasers and evaders",
}
"""What axes can need of a game, in words, in the order of the checks."""


@dataclass(frozen=True)
class Context:
    """A game for which a curriculum is built; by itself any game that has a `Batch`.

    Attributes:
        task: the task of the evaluation; by default every axis ends at its settings.
        agent: the learning agent, by name or role.
        opponents: the policies of the other agents.
        opponent_epsilon: share of random moves of the other agents where the batch sets it by
            `configure(games, epsilon=..., seat=...)`; else None.
        learned_opponent: the name of an opponent that is not scripted; None without one.
    """

    task: Any
    agent: str = ""
    opponents: Mapping[str, Any] = field(default_factory=dict)
    opponent_epsilon: float | None = None
    learned_opponent: str | None = None

    @property
    def offers(self) -> Mapping[str, bool]:
        """Which of the `NEEDS` of axes it meets; without an entry it does not."""
        others = self.opponent_epsilon is not None and self.task.num_agents > 1
        return {"random_starts": True, "scripted": others and self.learned_opponent is None}

    @property
    def default_axis(self) -> str:
        """The axis for "auto"; ValueError where there is none."""
        check(
            self.opponent_epsilon is not None,
            f"axis='auto' needs a default axis, and task {self.task.name!r} has none; give an axis",
        )
        return "opponent-epsilon"

    @property
    def mazes(self) -> tuple[Maze, ...]:
        """The mazes among which a curriculum can choose."""
        return ()

    def check(self, name: str) -> None:
        """ValueError if the game can have no curriculum."""

    def check_axis(self, name: str) -> None:
        """ValueError if the game can have no axis."""

    def check_levels(self, name: str) -> None:
        """ValueError unless levels, the seeds of starts, can be replayed: in any batch they can."""

    def optimum(self, task: Any) -> Optimum | None:
        """The optimum in steps of every start of `task` (this task in other mazes); None if
        unknown."""
        return None


@dataclass(frozen=True)
class CurriculumContext(Context):
    """A game in mazes for which a curriculum is built.

    Attributes:
        opponents: the policy of every other role.
        opponent_epsilon: share of random moves of the scripted opponents.
    """

    task: Task
    opponent_epsilon: float = 0.0

    @property
    def offers(self) -> Mapping[str, bool]:
        """As of `Context`."""
        task = self.task
        return {
            "in_mazes": True,
            "goals": task.num_goals > 0,
            "random_starts": task.start == "random",
            "scripted": super().offers["scripted"],
            "both": task.num_chasers > 0 and task.num_evaders > 0,
        }

    @property
    def default_axis(self) -> str:
        """As of `Context`."""
        if self.task.num_goals:
            return "goal-spread-start"
        check(
            self.offers["both"],
            f"axis='auto' needs goals, or chasers and evaders, and task {self.task.name!r} has "
            "neither; give an axis",
        )
        return "start-distance"

    @property
    def mazes(self) -> tuple[Maze, ...]:
        """As of `Context`."""
        return self.task.mazes

    def check(self, name: str) -> None:
        """As of `Context`: whether a game is won must be known at its end."""
        check(
            not self.task.most_exits or self.task.num_evaders == 1,
            f"curriculum={name!r} with exits and num_evaders={self.task.num_evaders}: whether a "
            "game is won is known at its end for one evader; give num_evaders=1, or curriculum "
            "none",
        )

    def check_levels(self, name: str) -> None:
        """As of `Context`: starts must be random."""
        check(
            self.task.start == "random",
            f"curriculum={name!r} replays random starts; use start=random, not {self.task.start}",
        )

    def optimum(self, task: Task) -> Optimum | None:
        """As of `Context`."""
        return optimum_of(task, self.agent, self.opponents)


@dataclass(frozen=True)
class ArmContext(Context):
    """An arm for which a curriculum is built."""

    task: ReacherTask
    default_axis: ClassVar[str] = "target-distance"
    offers: ClassVar[Mapping[str, bool]] = {"arm": True, "random_starts": True}

    def optimum(self, task: ReacherTask) -> Optimum | None:
        """As `arm_optimum`."""
        return arm_optimum(task)


@dataclass(frozen=True)
class SmallGameContext(Context):
    """A small game for which a curriculum is built: its one axis is of its other players."""

    def check_axis(self, name: str) -> None:
        """As of `Context`."""
        check(
            self.task.num_agents > 1,
            f"curriculum {name!r} needs other players, which this game does not have",
        )
