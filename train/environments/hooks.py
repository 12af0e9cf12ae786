"""EpisodeHook: how whoever changes the next episode comes into an environment."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class EpisodeHook:
    """The base of teachers and of whoever draws opponents; every method does nothing here.

    Attributes:
        wants_advantages: whether `note_advantages` is to be called.
    """

    wants_advantages: bool = False

    def before_restart(self, games: NDArray[np.intp]) -> None:
        """Settle what the next episode of each of `games` [n] is; n is at least 1."""

    def after_restart(self, games: NDArray[np.intp]) -> None:
        """Look at how the episodes of `games` [n] have just begun."""

    def episode_ended(self, games: NDArray[np.bool_]) -> None:
        """Note the games of the mask [num_games], whose episodes have just ended."""

    def note_advantages(self, advantages: NDArray[Any], done: NDArray[np.bool_]) -> None:
        """Note a rollout's advantages and ends of episodes, [num_games, steps] each."""
