"""EpisodeHook: how whoever changes the next episode comes into an environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.device.waiting import Settings


@dataclass(frozen=True)
class Foretold:
    """What a hook will settle of the next n episodes, in the order in which they begin.

    Attributes:
        settings: of their games, in rows; None where nothing is set.
        rows: [n], which of the rows each is given.
        seeds: [n] int64, the seeds of their starts; None where these are not settled.
        drawn: [n], which of several opponents plays in each; None where there is one.
    """

    settings: Settings | None = None
    rows: NDArray[np.int64] | None = None
    seeds: NDArray[np.int64] | None = None
    drawn: NDArray[np.int64] | None = None


class EpisodeHook:
    """The base of teachers and of whoever draws opponents; every method does nothing here.

    Attributes:
        copies: games i, i + n/copies, ... are to begin alike (for learners that compare candidates
            on the same starts); a learner sets it.
        wants_advantages: whether `note_advantages` is to be called.
        in_order: whether what it settles for n episodes, and then for m, is what it settles for
            n + m at once: then it can be asked before it is known how many there are.
    """

    copies: int = 1
    wants_advantages: bool = False
    in_order: bool = False

    def before_restart(self, games: NDArray[np.intp]) -> None:
        """Settle what the next episode of each of `games` [n] is; n is at least 1."""

    def after_restart(self, games: NDArray[np.intp]) -> None:
        """Look at how the episodes of `games` [n] have just begun."""

    def episode_ended(self, games: NDArray[np.bool_]) -> None:
        """Note the games of the mask [num_games], whose episodes have just ended."""

    def note_advantages(self, advantages: NDArray[Any], done: NDArray[np.bool_]) -> None:
        """Note a rollout's advantages and ends of episodes, [num_games, steps] each."""

    def foretell(self, count: int) -> Foretold:
        """What will be settled of the next `count` episodes; nothing is settled by that.

        For games on a GPU, which begin anew before the hook hears of it: the calls above come
        later, in the same order, and must bring the same.
        """
        raise NotImplementedError(f"{type(self).__name__} settles what only the CPU can do")
