"""Frame stacking: the latest observations of an episode as one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train.networks.features import Features

Observations = NDArray[Any]
"""Of a batch of games, [games, *shape], in the type of their encoding."""


def stacked(features: Features, count: int) -> Features:
    """The features of `count` stacked observations, the newest first.

    They are concatenated along the first axis. For "index" each one has its own rows.
    """
    if count == 1:
        return features
    shape = (count * features.shape[0], *features.shape[1:])
    high = np.concatenate([features.high] * count)
    if features.kind != "index":
        return replace(features, shape=shape, high=high)
    own, each = features.rows, features.num_rows
    total = count * each
    rows = [np.where(own == each, total, own + number * each) for number in range(count)]
    high = high + np.repeat(_offsets(features, count), features.shape[0])
    return replace(features, shape=shape, high=high, rows=np.concatenate(rows), num_rows=total)


class FrameStack:
    """The latest observations of games. Before the first step of an episode they are empty.

    Empty is 0, and for "index" the number that selects no row.

    Args:
        features: of one observation.
        count: number of stacked observations.

    Attributes:
        count: the argument.
        shape: of one stacked observation.
        offsets: [count], added to the numbers of each observation; 0 but for "index".
        empty: the number of which empty observations consist.
    """

    def __init__(self, features: Features, count: int) -> None:
        self.count, self._one = count, features.shape
        self.shape = stacked(features, count).shape
        index = features.kind == "index"
        self.offsets = _offsets(features, count)
        self.empty = len(features.rows) - 1 if index else 0

    def empty_frames(self, games: int, dtype: np.dtype[Any]) -> Observations:
        """[games, count, *shape of one], all empty."""
        return np.full((games, self.count, *self._one), self.empty, dtype=dtype)

    def forget(self, frames: Observations, games: NDArray[np.intp]) -> None:
        """Empty those of the given games, at the start of an episode."""
        frames[games] = self.empty

    def with_newest(self, frames: Observations, observed: Observations) -> Observations:
        """Writes the current observation [games, *shape of one] into `frames` [games, count, ...],
        and returns the stacked observations [games, *shape], a new array."""
        frames[:, 0] = observed
        offsets = self.offsets.astype(frames.dtype)[:, None]
        one = frames + offsets if offsets.any() else frames.copy()
        return one.reshape(len(frames), *self.shape)


def shift(frames: Observations) -> None:
    """Shift by one observation: the oldest is dropped, the newest is there twice."""
    frames[:, 1:] = frames[:, :-1].copy()


def _offsets(features: Features, count: int) -> NDArray[np.int64]:
    """[count]: the offset of the numbers of each observation for "index"."""
    return np.arange(count) * len(features.rows)
