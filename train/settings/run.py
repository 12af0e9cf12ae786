"""The settings of one training run: what `config.json` holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Generic, TypeVar

from train.settings.algorithms import Hyperparameters, PPOSettings
from train.settings.checks import check, one_of, threads_from
from train.settings.common import RunSettings
from train.settings.curricula import CurriculumSettings, curriculum_form
from train.settings.task import AnyTask, TaskSettings

S = TypeVar("S", bound=Hyperparameters, covariant=True)


@dataclass(frozen=True)
class TrainSettings(RunSettings, Generic[S]):
    """One training run, complete."""

    task: AnyTask = field(default_factory=TaskSettings)
    hyper: S = field(default_factory=PPOSettings)  # type: ignore[assignment]
    """The settings of the algorithm."""
    lessons: CurriculumSettings = field(default_factory=CurriculumSettings)
    """The settings of the curriculum."""
    algorithm: str = "ppo"
    """The learner: ppo, a2c, reinforce, dqn, cross_entropy, q_learning; of an arm ppo, a2c, reinforce, ddpg, td3,
    sac; or package.module:Name of your own."""
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
