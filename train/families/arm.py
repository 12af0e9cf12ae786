"""The arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.validation import Missing
from train.evaluation.arm_contest import ArmContest
from train.families.family import Family, TaskWorld
from train.networks.arm_policy import ArmSeat
from train.networks.seat import Seat
from train.settings.checks import EVALUATION_SEED
from train.settings.run import AgentSettings
from train.settings.task import ReacherSettings
from train.teaching.context import ArmContext
from train.teaching.teacher import EpisodeMetrics


def seat_of(settings: AgentSettings) -> ArmSeat:
    """The arm of a run."""
    return ArmSeat(settings.task.build(), settings.observation, settings.network)


@dataclass(frozen=True)
class ArmWorld(TaskWorld):
    """An arm; there are no other agents."""

    BATCH: ClassVar[Any] = ReacherSimulator
    opponents: ClassVar[dict[str, Any]] = {}

    @property
    def context(self) -> ArmContext:
        """As of `TaskWorld`."""
        return ArmContext(self.task)

    def policies(self, seat: Seat) -> list[Any]:
        """As of `TaskWorld`."""
        return [None]

    def metrics(self, seat: Seat) -> EpisodeMetrics:
        """As of `TaskWorld`."""
        return EpisodeMetrics(lambda arms: arms.terminated, lambda arms: arms.returns)

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> ArmContest:
        """As of `TaskWorld`."""
        return ArmContest(self.task, episodes, seed)


FAMILY = Family(
    ReacherSettings,
    seat_of,
    ArmWorld,
    Missing(
        "an arm has no other agents, and no policies by name or of files that play or are "
        "imitated; take another game"
    ),
    Missing("an arm has no sides; use `pursuit train`"),
)
