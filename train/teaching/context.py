"""The task for which a curriculum is built, with the opponents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from pursuit.reacher.task import ReacherTask
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from pursuit.validation import check
from scripted_agents.games.simulator import GameTask, StatePolicy
from train.teaching.optimum import Optimum, arm_optimum, optimum_of


@dataclass(frozen=True)
class CurriculumContext:
    """A game in mazes for which a curriculum is built.

    Attributes:
        task: the task of the evaluation; by default every axis ends at its settings.
        agent: the learning agent, by name or role.
        opponents: the policy of every other role.
        opponent_epsilon: share of random moves of the scripted opponents.
        learned_opponent: the name of an opponent that is not scripted; None without one.
    """

    task: Task
    agent: str
    opponents: Mapping[str, Policy] = field(default_factory=dict)
    opponent_epsilon: float = 0.0
    learned_opponent: str | None = None

    @property
    def default_axis(self) -> str:
        """The axis for "auto"; ValueError where there is none."""
        task = self.task
        if task.num_goals:
            return "goal-spread-start"
        check(
            task.num_chasers > 0 and task.num_evaders > 0,
            f"axis='auto' needs goals, or chasers and evaders, and task {task.name!r} has neither; "
            "give an axis",
        )
        return "start-distance"

    def check_levels(self, name: str) -> None:
        """ValueError unless starts are random: a level is the seed of a start."""
        check(
            self.task.start == "random",
            f"curriculum={name!r} replays random starts; use start=random, not {self.task.start}",
        )

    def optimum(self, task: Task) -> Optimum | None:
        """The optimum of every start of `task` (this task in other mazes); None if unknown."""
        return optimum_of(task, self.agent, self.opponents)


@dataclass(frozen=True)
class ArmContext:
    """An arm for which a curriculum is built; as `CurriculumContext`."""

    task: ReacherTask
    default_axis: ClassVar[str] = "target-distance"
    """The axis for "auto"."""

    def check_levels(self, name: str) -> None:
        """Nothing to check: any start of an arm can be replayed."""

    def optimum(self, task: ReacherTask) -> Optimum | None:
        """As `arm_optimum`."""
        return arm_optimum(task)


@dataclass(frozen=True)
class SmallGameContext:
    """A small game for which a curriculum is built; as `CurriculumContext`.

    Attributes:
        task: the game.
        agent: the learning player.
        opponents: the policies of the other players.
        opponent_epsilon: the probability of a random action of the other players.
    """

    task: GameTask
    agent: str
    opponents: Mapping[str, StatePolicy]
    opponent_epsilon: float
    default_axis: ClassVar[str] = "opponent-epsilon"
    """The axis for "auto"."""

    def check_levels(self, name: str) -> None:
        """Nothing to check: any start can be replayed."""

    def optimum(self, task: GameTask) -> Optimum | None:
        """None: games have no optimum in steps."""
        return None


AnyContext = CurriculumContext | ArmContext | SmallGameContext
