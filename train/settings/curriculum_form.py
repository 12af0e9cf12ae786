"""What the settings of every curriculum have, and checks that several of them share."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar

from train.settings.checks import check


@dataclass(frozen=True)
class CurriculumSettings:
    """No curriculum: the task as it is, from the start."""

    SHARES: ClassVar[frozenset[str]] = frozenset(
        {
            "promote_at", "demote_at", "average_fast", "average_slow", "explore_share",
            "replay_share", "staleness", "edit_share",
        }
    )  # fmt: skip

    @property
    def solved_within(self) -> float:
        """Success is an episode within this many times the exact optimum; 0: as the task says."""
        return 0.0

    @property
    def needs_optimum(self) -> bool:
        """Whether the exact optimum of every start must be known."""
        return self.solved_within > 0

    @property
    def needs_advantages(self) -> bool:
        """Whether the learner must tell its advantages."""
        return False

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if name in self.SHARES:
                check(0.0 <= value <= 1.0, f"{name}={value}; it lies in [0, 1]")


def check_temperature(value: float) -> None:
    """ValueError for a temperature that ranks nothing."""
    check(value > 0, f"level_temperature={value}; it is above 0")


def check_counts(settings: Any, **least: int) -> None:
    """ValueError for a setting that is less than it may be."""
    for name, value in least.items():
        check(
            getattr(settings, name) >= value, f"{name}={getattr(settings, name)}; at least {value}"
        )
