"""How tasks in Python objects are evaluated."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from pursuit.reacher.task import ReacherTask, make_reacher_task
from pursuit.tasks.task import Task, checked_task, make_task
from pursuit.validation import check
from scripted_agents.environments import chosen_policies
from scripted_agents.exact.limits import MAX_EVALUATED_WORK
from scripted_agents.games.env import chosen_players
from scripted_agents.games.simulator import INDEX, GameTask
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.scores import Contest
from train.evaluation.small_game_contest import SmallGameContest


class TaskClass(NamedTuple):
    """How tasks of a class are evaluated.

    Attributes:
        contest: (task, agent, opponent, epsilon, episodes, seed) -> the contest; the agent is None
            for the first.
        observation: the default encoding.
    """

    contest: Callable[..., Contest[Any, Any]]
    observation: str


def _in_maze(
    task: Task, agent: str | None, opponent: Any, epsilon: float, episodes: int, seed: int
) -> GameContest:
    agent = checked_task(task).agent_names[0] if agent is None else agent
    task.seat(agent)
    others = chosen_policies(task, agent, opponent, epsilon)
    return GameContest(task, agent, others, episodes, seed, False, MAX_EVALUATED_WORK)


def _of_arm(
    task: ReacherTask, agent: str | None, opponent: Any, epsilon: float, *how: int
) -> ArmContest:
    check(agent in (None, "arm"), f"agent={agent!r}; give 'arm' for task 'reacher'")
    for name, given, none in (("opponent", opponent, None), ("opponent_epsilon", epsilon, 0.0)):
        check(
            given == none,
            f"{name}={given!r}; task 'reacher' has no other agents; leave it out",
        )
    return ArmContest(task, *how)


def _of_small_game(
    task: GameTask, agent: str | None, opponent: Any, epsilon: float, episodes: int, seed: int
) -> SmallGameContest:
    name = task.agent_names[0 if agent is None else task.seat(agent)]
    others = chosen_players(task, name, opponent, epsilon)
    check(
        all(hasattr(own, "table") for own in others.values()),
        "opponent: exact results need tables; give names, functions of a state, or TableAgents",
    )
    return SmallGameContest(task, name, others, episodes=episodes, seed=seed)


CLASSES: dict[type, TaskClass] = {
    Task: TaskClass(_in_maze, "one_hot"),
    ReacherTask: TaskClass(_of_arm, "positions"),
    GameTask: TaskClass(_of_small_game, INDEX),
}
"""How tasks are evaluated, by their class; those of other families can be added."""


def class_of(task: Any) -> TaskClass:
    """How a task is evaluated; unknown ones as `Task`, which refuses them."""
    found = (CLASSES[each] for each in type(task).__mro__ if each in CLASSES)
    return next(found, CLASSES[Task])


def task_named(name: str, **settings: Any) -> Any:
    """A new task in a maze, or "reacher"."""
    make: Any = {"reacher": make_reacher_task}.get(name, partial(make_task, name))
    return make(**settings)
