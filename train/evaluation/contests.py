"""How tasks in Python objects are evaluated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pursuit.reacher.task import ReacherTask
from pursuit.tasks.task import Task, checked_task
from pursuit.validation import check
from scripted_agents.environments import chosen_policies
from scripted_agents.exact.limits import MAX_EVALUATED_WORK
from scripted_agents.games.env import chosen_players
from scripted_agents.games.simulator import INDEX, GameTask
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.scores import Contest
from train.evaluation.small_game_contest import SmallGameContest

Evaluated = tuple[Contest[Any, Any], str]
"""A contest, and the default encoding of observations."""


def _in_maze(
    task: Task, agent: str | None, opponent: Any, epsilon: float, episodes: int, seed: int
) -> Evaluated:
    agent = checked_task(task).agent_names[0] if agent is None else agent
    task.seat(agent)
    others = chosen_policies(task, agent, opponent, epsilon)
    return GameContest(task, agent, others, episodes, seed, False, MAX_EVALUATED_WORK), "one_hot"


def _of_arm(
    task: ReacherTask, agent: str | None, opponent: Any, epsilon: float, *how: int
) -> Evaluated:
    check(agent in (None, "arm"), f"agent={agent!r}; give 'arm' for task 'reacher'")
    for name, given, none in (("opponent", opponent, None), ("opponent_epsilon", epsilon, 0.0)):
        check(
            given == none,
            f"{name}={given!r}; task 'reacher' has no other agents; leave it out",
        )
    return ArmContest(task, *how), "positions"


def _of_small_game(
    task: GameTask, agent: str | None, opponent: Any, epsilon: float, episodes: int, seed: int
) -> Evaluated:
    name = task.agent_names[0 if agent is None else task.seat(agent)]
    others = chosen_players(task, name, opponent, epsilon)
    check(
        all(hasattr(own, "table") for own in others.values()),
        "opponent: exact results need tables; give names, functions of a state, or TableAgents",
    )
    return SmallGameContest(task, name, others, episodes=episodes, seed=seed), INDEX


CLASSES: dict[type, Callable[..., Evaluated]] = {
    Task: _in_maze,
    ReacherTask: _of_arm,
    GameTask: _of_small_game,
}
"""How tasks are evaluated, by their class; those of other families can be added."""


def contest_for(task: Any, *given: Any) -> Evaluated:
    """The contest of a task: of unknown ones as of `Task`, which refuses them.

    Args:
        task: by its class.
        *given: the agent, None for the first; the opponent and its share of random moves; the
            episodes, and their seed.
    """
    found = (CLASSES[each] for each in type(task).__mro__ if each in CLASSES)
    return next(found, CLASSES[Task])(task, *given)
