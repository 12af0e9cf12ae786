"""Shares: an array of shares of random moves that refuses what is none."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.next_episode import checked_shares


class Shares(np.ndarray[Any, np.dtype[np.float64]]):
    """A view of float64 shares in [0, 1] or NaN: what is written to it is checked.

    Everything that is computed from it is a plain array, or a number.
    """

    def __setitem__(self, key: Any, value: Any) -> None:
        super().__setitem__(key, checked_shares(value))

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        plain = np.asarray(array)
        return plain[()] if return_scalar else plain
