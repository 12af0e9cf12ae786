"""The settings of one training run, as saved in `config.json`."""

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
    """All settings of one training run."""

    task: AnyTask = field(default_factory=TaskSettings)
    hyper: S = field(default_factory=PPOSettings)  # type: ignore[assignment]
    """Hyperparameters of the algorithm."""
    lessons: CurriculumSettings = field(default_factory=CurriculumSettings)
    """Settings of the curriculum."""
    algorithm: str = "ppo"
    """ppo, a2c, reinforce, dqn or q_learning; for the arm ppo, a2c, reinforce, ddpg, td3 or sac; or
    package.module:Name of a user-defined algorithm."""
    curriculum: str = "none"
    """Scheduled: opponent-epsilon, goal-spread-fixed, goal-spread-start, start-distance, num-goals,
    maze-size, loops; for the arm target-distance, free-joints, hold, tolerance. Adaptive:
    success-gated, learning-progress, level-replay, learnability; for a suite of mazes maze-replay,
    maze-learnability. Controls: none, uniform, reversed, shuffled. Or package.module:Name of a
    user-defined curriculum or axis."""
    observation: str = "auto"
    """Observation of the network. In mazes: index (one_hot computed faster), one_hot, positions,
    cells, walls, planes, window:R (convolutions), or package.module:Name of a user-defined one. For
    the arm: positions or positions_angles. auto: the first of these."""
    evaluate: Annotated[str, one_of("greedy", "sampled")] = "greedy"
    """Policy of the evaluations during training: greedy (the most probable action) or sampled. The
    final results have both."""
    first_layer: Annotated[str, one_of("auto", "bag", "dense")] = "auto"
    """Form of the first layer for observation index: bag, dense, or auto (the faster one)."""
    threads: Annotated[int, threads_from(0)] = 0
    """Threads of torch. 0: one per core; with a budget in seconds one or all, whichever is faster;
    with clock processor one."""

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
