"""The interface of objects that configure the next episodes of an environment."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class EpisodeHook:
    """Base of teachers and opponent pools; every method does nothing here.

    Attributes:
        wants_advantages: whether `note_advantages` is called.
    """

    wants_advantages: bool = False

    def before_restart(self, games: NDArray[np.intp]) -> None:
        """Configure the next episode of each of `games` [n], n >= 1."""

    def after_restart(self, games: NDArray[np.intp]) -> None:
        """Called after the new episodes of `games` [n] have started."""

    def episode_ended(self, games: NDArray[np.bool_]) -> None:
        """Called with the mask [num_games] of episodes that have just ended."""

    def note_advantages(self, advantages: NDArray[Any], done: NDArray[np.bool_]) -> None:
        """Called with a rollout's advantages and ends of episodes, [num_games, steps] each."""
