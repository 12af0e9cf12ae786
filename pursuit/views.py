"""What is seen of a batch: encodings of the games, and the views that policies are given."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.maze_arrays import MazeArrays
from pursuit.observations import Encoder
from pursuit.policy import GameView
from pursuit.rules.layout import Games
from pursuit.task import Task


class Views:
    """Encoders and views of one batch, made when they are first asked for.

    Args:
        task: the rules and settings.
        games: the live games.
        streams: [games, ...] uint64, their random streams.
        epsilon: [games, agents] float64, the share of random moves.
        arrays: the mazes.
    """

    def __init__(
        self,
        task: Task,
        games: Games,
        streams: NDArray[np.uint64],
        epsilon: NDArray[np.float64],
        arrays: MazeArrays,
    ) -> None:
        self._task, self._games, self._streams = task, games, streams
        self._epsilon, self._arrays = epsilon, arrays
        self._encoders: dict[Any, Encoder] = {}
        self._views: dict[int, GameView] = {}

    def encoder(self, encoding: str) -> Encoder:
        """The `Encoder` of `encoding` for the task."""
        if not isinstance(encoding, str) or encoding not in self._encoders:
            self._encoders[encoding] = Encoder(self._task, encoding)
        return self._encoders[encoding]

    def encode(
        self, games: Games, encoding: str, seat: int | str | None, out: Any = None
    ) -> NDArray[Any]:
        """[games, agents, ...], or [games, ...] for one `seat`: a fresh array, or `out`."""
        encoder = self.encoder(encoding)
        if seat is None:
            return encoder.encode(games, out=out)
        number = self._task.seat(seat)
        one = out[:, None] if isinstance(out, np.ndarray) and out.ndim else out
        return encoder.encode(games, slice(number, number + 1), one)[:, 0]

    def view(self, seat: int | str) -> GameView:
        """The games as the policy in `seat` sees them."""
        number = self._task.seat(seat)
        if number not in self._views:
            self._views[number] = GameView(
                self._task,
                number,
                self._games,
                self._streams,
                self._epsilon,
                self._arrays,
                observe=lambda encoding: self.encode(self._games, encoding, number),
            )
        return self._views[number]
