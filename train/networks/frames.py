"""The last observations of an episode as one: the plain alternative to a memory that is learned."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train.networks.features import Features


def stacked(features: Features, count: int) -> Features:
    """The features of `count` observations as one, the newest first.

    They lie one after the other along the first axis: planes beside planes, numbers behind numbers.
    On "index" those of each name rows of their own.
    """
    if count == 1:
        return features
    shape = (count * features.shape[0], *features.shape[1:])
    high = np.concatenate([features.high] * count)
    if features.kind != "index":
        return replace(features, shape=shape, high=high)
    total = count * features.num_rows
    rows = [
        np.where(
            features.rows == features.num_rows, total, features.rows + number * features.num_rows
        )
        for number in range(count)
    ]
    high = high + np.repeat(_offsets(features, count), features.shape[0])
    return replace(features, shape=shape, high=high, rows=np.concatenate(rows), num_rows=total)


class FrameStack:
    """The last observations of games; older ones than an episode has are empty.

    Empty is 0 everywhere, and on "index" what names no row.

    Args:
        features: of one observation.
        count: observations.

    Attributes:
        count: the argument.
        shape: of what `concatenate` gives of a game.
    """

    def __init__(self, features: Features, count: int) -> None:
        self.count, self._one = count, features.shape
        self.shape = stacked(features, count).shape
        self._index = features.kind == "index"
        self._offsets = _offsets(features, count) if self._index else None
        self._empty = len(features.rows) - 1 if self._index else 0

    def begun(self, games: int, dtype: Any) -> NDArray[Any]:
        """[games, count, *shape of one]: nothing seen yet."""
        return np.full((games, self.count, *self._one), self._empty, dtype=dtype)

    def forget(self, frames: NDArray[Any], games: Any) -> None:
        """Empty those of some games: new episodes begin there."""
        frames[games] = self._empty

    def concatenate(self, frames: NDArray[Any]) -> NDArray[Any]:
        """[games, *shape], a fresh array, from [games, count, ...] with the newest first."""
        if self._offsets is not None:
            added = frames + self._offsets.astype(frames.dtype)[:, None]
            return added.reshape(len(frames), *self.shape)
        return frames.reshape(len(frames), *self.shape).copy()

    def seen(self, frames: NDArray[Any], observed: NDArray[Any]) -> NDArray[Any]:
        """Writes the current observation [games, *shape of one] into `frames`, and returns
        `concatenate(frames)`."""
        frames[:, 0] = observed
        return self.concatenate(frames)


def shift(frames: NDArray[Any]) -> None:
    """Make room for the next observation: the oldest goes, and the newest stands twice."""
    frames[:, 1:] = frames[:, :-1].copy()


def _offsets(features: Features, count: int) -> NDArray[np.int64]:
    """[count]: what is added to the numbers of each observation on "index"."""
    return np.arange(count) * len(features.rows)
