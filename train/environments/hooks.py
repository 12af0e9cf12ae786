"""The interface of objects that configure the episodes of an environment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scripted_agents.games.simulator import OpponentTables


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

    def opponent_tables(self) -> OpponentTables | None:
        """The only opponent of every game of two as tables, which stay until the next rollout; None
        where there are none."""
        return None

    def note_episodes(self, members: NDArray[np.int64], returns: NDArray[np.float64]) -> None:
        """Called with the opponents [n] and the returns [n, players] of episodes that were played
        by tables, in the order of their ends."""

    def note_advantages(self, advantages: NDArray[np.float32], done: NDArray[np.bool_]) -> None:
        """Called with the advantages and episode ends of a rollout, both [num_games, steps]."""
