"""The settings of one training run, as saved in `config.json`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Generic, TypeVar

from pursuit.observations.custom import without_id
from pursuit.validation import at_least, check, choice
from train.settings.algorithms import Hyperparameters, PPOSettings
from train.settings.checks import threads_from
from train.settings.common import RunSettings
from train.settings.curricula import (
    CurriculumSettings,
    ReversedSettings,
    ScheduleSettings,
    ShuffledSettings,
    UniformSettings,
    curriculum_form,
)
from train.settings.task import TaskSettings
from train.settings.task_form import AnyTask

S = TypeVar("S", bound=Hyperparameters, covariant=True)
ALIKE = (CurriculumSettings, ScheduleSettings, UniformSettings, ReversedSettings, ShuffledSettings)
"""Curricula that do not depend on outcomes, so that they are equal in all processes."""
SHARED_OUT = ("num_games", "minibatch_size")
"""Hyperparameters that data parallel training divides between its processes."""


def check_several_processes(settings: TrainSettings[Any]) -> None:
    """ValueError for settings that data parallel training does not support."""
    hyper, own, count = settings.hyper, settings.curriculum_settings, settings.processes
    alike = type(own) in ALIKE and own.schedule_unit != "episodes"
    found = [
        ("algorithm", settings.algorithm, settings.algorithm == "ppo", "use ppo"),
        ("device", settings.device, settings.device == "cpu", "use cpu"),
        ("clock", settings.clock, settings.clock == "wall", "use wall"),
        ("imitate", settings.imitate, settings.imitate is None, "leave it out"),
        ("threads", settings.threads, settings.threads <= 1, "leave it out (one thread each)"),
        ("recurrent", hyper.recurrent, hyper.recurrent is None, "leave it out"),
        (
            "curriculum",
            settings.curriculum,
            alike,
            "use a scheduled one in frames, seconds or shares, as others depend on the episodes of "
            "one process",
        ),
    ]
    for name in SHARED_OUT:
        value = getattr(hyper, name)
        fits = value % count == 0 and value >= 2 * count
        found.append((name, value, fits, f"use a multiple of {count} of at least {2 * count}"))
    for name, value, fits, instead in found:
        check(fits, f"{name}={value!r} with processes={count}; {instead}, or use processes=1")


@dataclass(frozen=True)
class TrainSettings(RunSettings, Generic[S]):
    """All settings of one training run."""

    REMOVED: ClassVar[Mapping[str, object]] = {"first_layer": "auto"}

    task: AnyTask = field(default_factory=TaskSettings)
    hyper: S = field(default_factory=PPOSettings)  # type: ignore[assignment]
    """Hyperparameters of the algorithm."""
    curriculum_settings: CurriculumSettings = field(default_factory=CurriculumSettings)
    """Settings of the curriculum."""
    algorithm: str = "ppo"
    """ppo, a2c, reinforce, dqn, cross_entropy or q_learning; sb3_ppo (PPO of Stable-Baselines3) or
    cleanrl_ppo (in CleanRL's form); ippo, mappo, iql, vdn or qmix for all agents of a role; for the
    arm ppo, a2c, reinforce, cross_entropy, ddpg, td3 or sac; or package.module:Name of a
    user-defined algorithm."""
    curriculum: str = "none"
    """Scheduled: opponent-epsilon, slip, goal-spread-fixed, goal-spread-start, start-distance,
    num-goals, maze-size, loops; for the arm target-distance, free-joints, hold, tolerance.
    Adaptive: success-gated, learning-progress, level-replay, learnability; for a suite of mazes
    maze-replay, maze-learnability. Controls: none, uniform, reversed, shuffled. Or
    package.module:Name of a user-defined curriculum or axis."""
    observation: str = "auto"
    """Observation of the network. In mazes: index (one_hot computed faster), one_hot, positions,
    cells, walls, planes, window:R (convolutions), or package.module:Name of a user-defined one;
    with the suffix +id (not of cells, walls) also the number of the agent within its role. For the
    arm: positions or positions_angles. auto: the first of these."""
    evaluate: Annotated[str, choice("greedy", "sampled")] = "greedy"
    """Policy of the evaluations during training: greedy (the most probable action) or sampled. The
    final results have both."""
    threads: Annotated[int, threads_from(0)] = 0
    """Threads of torch. 0: one per core; with a budget in seconds one or all, whichever is faster;
    with clock processor one."""
    processes: Annotated[int, at_least(1)] = 1
    """N above 1: data parallel training of ppo in N processes with one thread each, which share the
    games and every minibatch equally."""

    @property
    def fixed_threads(self) -> int:
        """Threads of torch; 0 where one or all of them are chosen during the run."""
        if self.seconds is None and self.processes == 1:  # results depend on them in the last bits
            return self.threads or os.cpu_count() or 1
        return self.threads or int(self.processes > 1 or self.clock == "processor")

    def __post_init__(self) -> None:
        if self.observation == "auto":
            object.__setattr__(self, "observation", self.task.OBSERVATION)
        super().__post_init__()
        self.task.check_observation(self.observation)
        planned = without_id(self.observation).split(":")[0] in ("planes", "window")
        check(
            self.network != "planning" or (planned and self.device == "cpu"),
            f"network='planning' with observation={self.observation!r} on device={self.device!r}; "
            "use planes or window:R, on the cpu",
        )
        check(
            type(self.curriculum_settings) is curriculum_form(self.curriculum),
            f"curriculum={self.curriculum!r} with {type(self.curriculum_settings).__name__}; give "
            f"{curriculum_form(self.curriculum).__name__}",
        )
        if self.processes > 1:
            check_several_processes(self)

    @property
    def learners(self) -> tuple[Hyperparameters, ...]:
        """As of `SelfPlayBase`."""
        return (self.hyper,)


AgentSettings = TrainSettings[Hyperparameters]
"""The settings of a run of one agent, with any algorithm."""
