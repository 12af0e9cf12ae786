"""What lessons are laid over: a task and what is known of it; and an axis, from easy to hard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pursuit.reacher.task import ReacherTask
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from train.settings.checks import check
from train.teaching.optimum import Optimum, arm_optimum, optimum_of


@dataclass(frozen=True)
class CurriculumContext:
    """The game in a maze that axes are laid over.

    Attributes:
        task: the task itself, to which every axis leads.
        agent: who learns, by name or role.
        opponents: the policy of every other role.
        opponent_epsilon: share of random moves of the scripted opponents.
        learned_opponent: the name of an opponent that is not scripted; None where all are.
    """

    task: Task
    agent: str
    opponents: Mapping[str, Policy] = field(default_factory=dict)
    opponent_epsilon: float = 0.0
    learned_opponent: str | None = None

    @property
    def default_axis(self) -> str:
        """What `axis="auto"` means; ValueError where there is nothing to turn."""
        task = self.task
        if task.num_goals:
            return "goal-spread-start"
        check(
            task.num_chasers > 0 and task.num_evaders > 0,
            f"task {task.name!r} has neither goals nor chasers with evaders; name an axis",
        )
        return "start-distance"

    def check_levels(self, name: str) -> None:
        """ValueError where there are no starts to be replayed."""
        check(
            self.task.start == "random",
            f"curriculum={name!r} replays random starts; leave out start='marks'",
        )

    def optimum(self, task: Task) -> Optimum | None:
        """The exact optimum of every start of `task`, this one in other mazes; None if unknown."""
        return optimum_of(task, self.agent, self.opponents)


@dataclass(frozen=True)
class ArmContext:
    """The arm that axes are laid over; a `CurriculumContext`."""

    task: ReacherTask

    @property
    def default_axis(self) -> str:
        """What `axis="auto"` means."""
        return "target-distance"

    def check_levels(self, name: str) -> None:
        """Starts can be replayed whatever they are."""

    def optimum(self, task: ReacherTask) -> Optimum | None:
        """The least steps of any start; None for many joints, and where actions are discrete."""
        return arm_optimum(task)


AnyContext = CurriculumContext | ArmContext
