"""What every curriculum is: fed by the outcomes of episodes, asked for the next lessons.

A *lesson* is one number: the value of whatever the curriculum turns (an epsilon, a radius, the
number of a maze), or the seed of a level. What it means to the world is not known here.
"""

from __future__ import annotations

from copy import copy
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


def check_shares(**shares: float) -> None:
    """ValueError unless all lie in [0, 1]."""
    for name, share in shares.items():
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"{name}={share}; a share lies in [0, 1]")


class Resumable:
    """`state_dict` and `load_state_dict` of a curriculum: attributes, saved under their names.

    Arrays keep their length, unless they are in `GROWING`.
    """

    KIND = "this"
    """What messages call it."""
    STATE: tuple[str, ...] = ()
    """The attributes that are its state."""
    GROWING: tuple[str, ...] = ()

    def state_dict(self) -> dict[str, Any]:
        """Plain values and arrays: whatever it needs to go on exactly."""
        return {name: copy(getattr(self, name)) for name in self.STATE}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` gave; ValueError for the state of another curriculum."""
        if set(state) != set(self.STATE):
            raise ValueError(
                f"the checkpoint is of another curriculum than {self.KIND}: it holds "
                f"{sorted(state)}, and {sorted(self.STATE)} are needed; resume with the curriculum "
                "that it was made with"
            )
        loaded = {
            name: np.array(value) if isinstance(getattr(self, name), np.ndarray) else copy(value)
            for name, value in state.items()
        }
        for name, value in loaded.items():
            own = getattr(self, name)
            fixed = isinstance(own, np.ndarray) and name not in self.GROWING
            if fixed and value.shape != own.shape:
                raise ValueError(
                    f"the checkpoint has {name} of {value.size} levels, and {self.KIND} has "
                    f"{own.size}; resume with the settings that it was made with"
                )
        self._check_loaded(loaded)
        for name, value in loaded.items():
            setattr(self, name, value)

    def _check_loaded(self, state: dict[str, Any]) -> None:
        """ValueError for values that cannot be."""
