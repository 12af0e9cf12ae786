"""The door: the settings of a run become its parts, once, from top to bottom, and are checked here.

Below it nobody knows the settings of a run: a learner gets its own and an environment, a teacher
its plan, a contest its task and opponents.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pursuit.policy import Policy
from pursuit.task import Task
from scripted_agents.environments import SCRIPTED
from train.algorithms.registry import Algorithm, Build, entry
from train.evaluation.contest import GameContest
from train.networks.policy import Seat
from train.runs.opponents import opponents_of
from train.runs.sizes import check_memory
from train.runs.tasks import agent_of, task_of
from train.runs.threads import uses_bfloat16
from train.settings.algorithms import Hyperparameters, PPOSettings
from train.settings.checks import check, evaluation_seed
from train.settings.presets import Setting
from train.settings.run import TrainSettings
from train.settings.task import TaskSettings
from train.teaching.plan import Plan, check_learner, plan_lessons


@dataclass(frozen=True)
class Parts:
    """What a run is made of.

    Attributes:
        task: what is evaluated.
        opponents: the policy of every role.
        plan: what is taught when; None without a curriculum.
        seat: whose policy is learned, in the training games.
        algorithm, hyper: what it learns by, and the settings of that.
        build: how the learner is to be built on this machine.
    """

    task: Task
    opponents: dict[str, Policy]
    plan: Plan | None
    seat: Seat
    algorithm: Algorithm
    hyper: Hyperparameters
    build: Build

    def contest(self, episodes: int) -> GameContest:
        """What it is judged by: the task itself, whatever the training games are."""
        masks = self.seat.mask_bumps
        return GameContest(self.task, self.seat.agent, self.opponents, episodes, mask_bumps=masks)


def parts_of(settings: TrainSettings[Any]) -> Parts:
    """The parts of a run.

    Raises:
        ValueError: settings that make no game, an agent that does not play in it, an opponent that
            is none, or what the algorithm or the curriculum cannot do.
    """
    algorithm = entry(settings.algorithm)
    check_algorithm(settings, algorithm)
    check(
        not (isinstance(settings.hyper, PPOSettings) and settings.hyper.central_critic),
        "central_critic=True is for several agents that learn at once; use it in "
        "`pursuit self-play`",
    )
    task = task_of(settings.task)
    agent = agent_of(settings.task, task)
    opponents = opponents_in(settings.task, task, agent)
    opponent = settings.task.opponent
    learned = None if opponent in SCRIPTED else opponent
    plan = plan_lessons(
        settings.curriculum,
        settings.lessons,
        task,
        agent,
        opponents,
        opponent_epsilon=settings.task.opponent_epsilon,
        learned_opponent=learned,
        seed=settings.seed,
    )
    if plan is not None:
        check_learner(plan, algorithm)
    seat = Seat(
        task if plan is None else plan.task, agent, settings.observation, settings.task.mask_bumps
    )
    algorithm.check_actions(seat)
    algorithm.check_player(settings.hyper, seat)
    check_memory(settings.hyper, seat)
    bfloat16 = uses_bfloat16(settings.precision, settings.device)
    build = Build(settings.device, bfloat16, settings.first_layer, settings.seed)
    return Parts(task, opponents, plan, seat, algorithm, settings.hyper, build)


def opponents_in(settings: TaskSettings, task: Task, agent: str) -> dict[str, Policy]:
    """The policy of every role, as the settings name them; ValueError as `opponents_of`."""
    how = (settings.opponent, settings.opponent_epsilon, settings.opponent_policy)
    return opponents_of(task, agent, *how)


def check_algorithm(settings: TrainSettings[Any], algorithm: Algorithm) -> None:
    """ValueError where the settings ask of the algorithm what it cannot do."""
    check(
        type(settings.hyper) is algorithm.settings,
        f"algorithm={algorithm.name!r} with settings of {type(settings.hyper).__name__}",
    )
    algorithm.check(
        observation=settings.observation,
        device=settings.device,
        greedy=settings.evaluate == "greedy",
    )


def setting_of(settings: TaskSettings) -> Setting:
    """What the presets go by."""
    task = task_of(settings)
    role = agent_of(settings, task).split("_")[0]
    return Setting(settings.task, role, task.max_cells, settings.start == "random", task.is_duel)


def contest_of(settings: TaskSettings, episodes: int, seed: int = 0) -> GameContest:
    """What a policy is judged by in a task, without any run; `seed` is one of the evaluation's."""
    task = task_of(settings)
    agent = agent_of(settings, task)
    opponents = opponents_in(settings, task, agent)
    return GameContest(
        task, agent, opponents, episodes, evaluation_seed(seed), mask_bumps=settings.mask_bumps
    )
