"""The agents of a picture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class AgentMark:
    """One agent in a picture.

    Args:
        name: role and number, as in `"chaser_0"`; the role is chaser, evader or runner.
        cell: the number of its cell; of an agent that has left the game, of its last cell.
        active: False if captured or escaped.
        escaped: whether it has escaped.

    Raises:
        ValueError: an invalid name.
    """

    name: str
    cell: int
    active: bool = True
    escaped: bool = False

    def __post_init__(self) -> None:
        if self.role not in ("chaser", "evader", "runner") or not self.number.isdecimal():
            raise ValueError(
                f"agent name {self.name!r}; give chaser_N, evader_N or runner_N with a number N"
            )

    @property
    def role(self) -> str:
        """`"chaser"`, `"evader"` or `"runner"`."""
        return self.name.rpartition("_")[0]

    @property
    def fate(self) -> str:
        """`"captured"` or `"escaped"`; empty if it is in the game."""
        return "" if self.active else "escaped" if self.escaped else "captured"

    @property
    def number(self) -> str:
        """The number after the role, as text."""
        return self.name.rpartition("_")[2]


def outcome_text(fates: Sequence[str], goals: int, num_goals: int) -> str:
    """What became of the evaders and goals, as "1 captured, 1 escaped, all goals collected".

    Args:
        fates: of each evader: "captured", "escaped" or "free".
        goals: those that are left.
        num_goals: those of the game.
    """
    counts = [f"{n} {fate}" for fate, n in sorted(Counter(fates).items())]
    parts = counts if len(fates) > 1 else [*fates]
    if num_goals:
        left = f"{goals} goal{'s' * (goals > 1)} left"
        parts.append(left if goals else "all goals collected")
    return ", ".join(parts)
