"""The settings of one training run: what `config.json` holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Generic, TypeVar

from train.settings.algorithms import Hyperparameters, PPOSettings
from train.settings.checks import check, one_of, rule, threads_from
from train.settings.common import RunSettings
from train.settings.curricula import (
    CurriculumSettings,
    ReversedSettings,
    ScheduleSettings,
    ShuffledSettings,
    UniformSettings,
    curriculum_form,
)
from train.settings.task import AnyTask, TaskSettings

S = TypeVar("S", bound=Hyperparameters, covariant=True)
ALIKE = (CurriculumSettings, ScheduleSettings, UniformSettings, ReversedSettings, ShuffledSettings)
"""Curricula that two processes go through alike, whatever episodes each of them has seen."""
SHARED_OUT = ("num_games", "minibatch_size")
"""What two processes that learn together have a half each of."""


def check_two_processes(settings: TrainSettings[Any]) -> None:
    """ValueError for a run that two processes cannot share."""
    hyper, lessons = settings.hyper, settings.lessons
    alike = type(lessons) in ALIKE and getattr(lessons, "schedule_unit", "share") != "episodes"
    found = [
        ("algorithm", settings.algorithm, settings.algorithm == "ppo", "take ppo"),
        ("device", settings.device, settings.device == "cpu", "take cpu"),
        ("clock", settings.clock, settings.clock == "wall", "take wall"),
        ("threads", settings.threads, settings.threads <= 1, "each has one: leave threads out"),
        ("recurrent", hyper.recurrent, hyper.recurrent is None, "leave it out"),
        (
            "curriculum",
            settings.curriculum,
            alike,
            "it learns from episodes, of which each has seen its own: take a scheduled one, not by "
            "episodes",
        ),
    ]
    for name in SHARED_OUT:
        value = getattr(hyper, name, 0)
        fits = value % 2 == 0 and value >= 4
        found.append((name, value, fits, "each has half of it: take an even number from 4 on"))
    for name, value, fits, instead in found:
        check(fits, f"{name}={value!r} with processes=2; {instead}, or take processes=1")


@dataclass(frozen=True)
class TrainSettings(RunSettings, Generic[S]):
    """One training run, complete."""

    task: AnyTask = field(default_factory=TaskSettings)
    hyper: S = field(default_factory=PPOSettings)  # type: ignore[assignment]
    """The settings of the algorithm."""
    lessons: CurriculumSettings = field(default_factory=CurriculumSettings)
    """The settings of the curriculum."""
    algorithm: str = "ppo"
    """The learner: ppo, a2c, reinforce, dqn, cross_entropy, q_learning; of an arm ppo, a2c,
    reinforce, cross_entropy, ddpg, td3, sac; or package.module:Name of your own."""
    curriculum: str = "none"
    """What is taught when. Scheduled: opponent-epsilon, goal-spread-fixed, goal-spread-start,
    start-distance, num-goals, maze-size, loops; of an arm target-distance, free-joints, hold,
    tolerance. Adaptive: success-gated, learning-progress, level-replay, learnability; over the
    mazes of a suite maze-replay, maze-learnability. Controls: none, uniform, reversed, shuffled. Or
    package.module:Name, of a curriculum or an axis of your own."""
    observation: str = "auto"
    """What the network is given. In mazes: index (the same network as one_hot, faster), one_hot,
    positions, cells, walls, planes or window:R (convolutions), or package.module:Name of your own.
    Of an arm: positions or positions_angles. auto: the first of these."""
    evaluate: Annotated[str, one_of("greedy", "sampled")] = "greedy"
    """Which policy is evaluated: greedy (the most probable action), or sampled (as learned: it
    gets away where the greedy one steps to and fro for ever). Final results have both."""
    first_layer: Annotated[str, one_of("auto", "bag", "dense")] = "auto"
    """Form of the first layer on index: bag, dense, or auto (the faster, as measured)."""
    threads: Annotated[int, threads_from(0)] = 0
    """Threads of torch. 0 is one for each core; with a budget in seconds, one or all of them,
    whichever is the faster at the time; with one in seconds of the processor, one."""
    processes: Annotated[int, rule(lambda value: value in (1, 2), "1 or 2")] = 1
    """2: two processes with one thread each learn one policy, from half of the games and of every
    minibatch each (ppo, for two free cores; a start of some seconds)."""

    def __post_init__(self) -> None:
        if self.observation == "auto":
            object.__setattr__(self, "observation", self.task.OBSERVATION)
        super().__post_init__()
        self.task.check_observation(self.observation)
        planned = self.observation == "planes" or self.observation.split(":")[0] == "window"
        check(
            self.network != "planning" or (planned and self.device == "cpu"),
            f"network='planning' with observation={self.observation!r} on device={self.device!r}; "
            "it plans in planes or window:R, on the cpu",
        )
        check(
            type(self.lessons) is curriculum_form(self.curriculum),
            f"curriculum={self.curriculum!r} with settings of {type(self.lessons).__name__}",
        )
        if self.processes == 2:
            check_two_processes(self)
