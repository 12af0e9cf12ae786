"""What every curriculum is: fed by the outcomes of episodes, asked for the next lessons.

A *lesson* is one number: the value of whatever the curriculum turns (an epsilon, a radius, the
number of a maze), or the seed of a level. What it means to the world is not known here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from curricula.schedules import Progress


@dataclass(frozen=True)
class Outcomes:
    """Episodes that ended since the last update, in any order.

    Attributes:
        lessons: [n] float64, what each was played with.
        successes: [n] bool.
        returns: [n] float64, undiscounted.
        lengths: [n] int64, steps.
        regrets: [n] float64, how far each fell short of the exact optimum of its start, as a share
            of it and at least 0; NaN where that is not known.
        errors: [n] float64, mean positive advantage of each; NaN where the learner has none.
    """

    lessons: NDArray[np.float64]
    successes: NDArray[np.bool_]
    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    regrets: NDArray[np.float64]
    errors: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.lessons)


@dataclass(frozen=True)
class Change:
    """A change of what is sampled, for the log.

    Attributes:
        mean, low, high: of the lessons that are sampled from now on.
        reason: why, in words.
    """

    mean: float
    low: float
    high: float
    reason: str


class Curriculum(Protocol):
    """Decides what is played next."""

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Learn from the episodes that ended; what changed by that.

        Raises:
            ValueError: outcomes of lessons that this curriculum never gave.
        """

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] float64: lessons for that many games that begin anew."""

    def state_dict(self) -> dict[str, Any]:
        """Plain values and arrays: whatever it needs to go on exactly."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` gave.

        Raises:
            ValueError: the state of another curriculum.
        """


def check_count(name: str, value: Any, least: int, what: str) -> None:
    """ValueError unless `value` is a whole number from `least` on; `what` is counted."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least:
        raise ValueError(f"{name}={value!r}; a whole number, at least {least} {what}")


def check_state(name: str, state: dict[str, Any], wanted: set[str]) -> None:
    """ValueError unless `state` has exactly the wanted names."""
    if set(state) != wanted:
        raise ValueError(
            f"the checkpoint is of another curriculum than {name}: it holds {sorted(state)}, and "
            f"{sorted(wanted)} are needed; resume with the curriculum that it was made with"
        )
