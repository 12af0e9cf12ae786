"""The interface of objects that configure the episodes of an environment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class EpisodeHook:
    """The base of teachers and opponent pools; by default every method does nothing.

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

    def note_advantages(self, advantages: NDArray[np.float32], done: NDArray[np.bool_]) -> None:
        """Called with the advantages and episode ends of a rollout, both [num_games, steps]."""
