"""The protocol of curricula, which use outcomes of episodes to choose the next stages or levels.

A stage or level is one number: the value of a setting (an epsilon, a radius, the index of a maze),
or the seed of a level. Curricula do not depend on its meaning.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from curricula.schedules import Progress

Saved: TypeAlias = dict[str, Any]
"""The state of a curriculum: plain values and arrays by name."""


@dataclass(frozen=True)
class Outcomes:
    """Episodes that ended since the last update, in any order.

    Attributes:
        stages: [n] float64, the stage or level of each episode.
        successes: [n] bool.
        returns: [n] float64, undiscounted.
        lengths: [n] int64, steps.
        regrets: [n] float64, shortfall from the exact optimum of the same start, relative to it and
            at least 0; NaN if the optimum is not known.
        errors: [n] float64, mean positive advantage of each; NaN if the learner computes none.
    """

    stages: NDArray[np.float64]
    successes: NDArray[np.bool_]
    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    regrets: NDArray[np.float64]
    errors: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stages)


@dataclass(frozen=True)
class Change:
    """A change of the sampled stages or levels, for the log.

    Attributes:
        mean, low, high: of the stages or levels that are sampled from now on.
        reason: text for the log.
    """

    mean: float
    low: float
    high: float
    reason: str


class Curriculum(Protocol):
    """Chooses the stages or levels of the next episodes."""

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Update from episodes that ended; return the changes.

        Raises:
            ValueError: outcomes of stages or levels that are not part of this curriculum.
        """

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] float64: stages or levels for games that restart."""

    def state_dict(self) -> Saved:
        """Plain values and arrays: everything needed to resume exactly."""

    def load_state_dict(self, state: Saved) -> None:
        """Restore the state that `state_dict` returned.

        Raises:
            ValueError: the state of another curriculum.
        """


def check_count(name: str, value: Any, least: int, what: str) -> None:
    """ValueError unless `value` is a whole number of at least `least`; `what`: its unit."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least:
        raise ValueError(f"{name}={value!r}; give a whole number, at least {least} {what}")


def check_shares(**shares: float) -> None:
    """ValueError unless all are in [0, 1]."""
    for name, share in shares.items():
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"{name}={share}; give a number in [0, 1]")


class Resumable:
    """`state_dict` and `load_state_dict` of a curriculum, which save the attributes in `STATE`.

    Arrays have a fixed length, except those in `GROWING`.
    """

    KIND = "this"
    """The name of the curriculum in messages."""
    STATE: tuple[str, ...] = ()
    """The names of the attributes of the state."""
    GROWING: tuple[str, ...] = ()

    def state_dict(self) -> Saved:
        """Plain values and arrays: everything needed to resume exactly."""
        return {name: copy(getattr(self, name)) for name in self.STATE}

    def load_state_dict(self, state: Saved) -> None:
        """Restore the state of `state_dict`; ValueError for the state of another curriculum."""
        if set(state) != set(self.STATE):
            raise ValueError(
                f"the checkpoint is of another curriculum than {self.KIND}: it holds "
                f"{sorted(state)}, and {sorted(self.STATE)} are needed; resume with the curriculum "
                "of the checkpoint"
            )
        loaded: Saved = {}
        for name, value in state.items():
            own = getattr(self, name)
            loaded[name] = np.array(value) if isinstance(own, np.ndarray) else copy(value)
            fixed = isinstance(own, np.ndarray) and name not in self.GROWING
            if fixed and loaded[name].shape != own.shape:
                raise ValueError(
                    f"the checkpoint has {name} of {loaded[name].size} levels, and {self.KIND} has "
                    f"{own.size}; resume with the settings of the checkpoint"
                )
        self._check_loaded(loaded)
        for name, value in loaded.items():
            setattr(self, name, value)

    def _check_loaded(self, state: Saved) -> None:
        """ValueError for invalid values."""
