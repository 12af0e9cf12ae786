"""The agents of a picture."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AgentMark:
    """One agent in a picture.

    Args:
        name: role and number, as in `"chaser_0"`; the role is chaser, evader or runner.
        cell: the number of its cell; after capture, of its last cell.
        active: False if captured or escaped.
        escaped: whether it has escaped; it is not drawn then.

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
    def number(self) -> str:
        """The number after the role, as text."""
        return self.name.rpartition("_")[2]
