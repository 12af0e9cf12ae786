"""The random policy of any game with discrete actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.batch import Batch


class RandomPolicy:
    """Uniformly random legal actions; views give random numbers by `uniform()`, [num_games] in
    [0, 1).

    Args:
        num_actions: of the agent.
        allowed: (batch, slice of agents) -> [games, agents, actions] bool, the legal actions; by
            default all are.
    """

    name = "random"

    def __init__(
        self,
        num_actions: int,
        allowed: Callable[[Batch[Any], slice], NDArray[np.bool_]] | None = None,
    ) -> None:
        self.num_actions, self.allowed = num_actions, allowed

    def act(self, view: Any) -> NDArray[np.int32]:
        """[num_games] int32; 0 where no action is legal, as in games that are over."""
        drawn = view.uniform()
        if self.allowed is None:
            return np.asarray(drawn * self.num_actions).astype(np.int32)
        legal = self.allowed(view.batch, slice(view.seat, view.seat + 1))[:, 0]
        place = (drawn * legal.sum(axis=1)).astype(np.int64)  # among the legal actions
        passed = legal.cumsum(axis=1) > place[:, None]
        return passed.argmax(axis=1).astype(np.int32)
