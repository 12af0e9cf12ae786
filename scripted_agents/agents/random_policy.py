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

    def probabilities(self, view: Any) -> NDArray[np.float64]:
        """[num_games, actions] the probability of every action; 0 for all where none is legal."""
        if self.allowed is None:
            return np.full((view.num_games, self.num_actions), 1.0 / self.num_actions)
        allowed, own = self.allowed, slice(view.seat, view.seat + 1)
        legal = view.of(lambda batch: allowed(batch, own)[:, 0])
        return np.asarray(legal / np.maximum(legal.sum(axis=1, keepdims=True), 1))

    def act(self, view: Any) -> NDArray[np.int32]:
        """[num_games] int32; 0 where no action is legal, as in games that are over."""
        sums = self.probabilities(view).cumsum(axis=1)
        return (sums > view.uniform()[:, None]).argmax(axis=1).astype(np.int32)
