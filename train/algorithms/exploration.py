"""Random streams for learners that explore in kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.rules import seed_streams
from pursuit.simulator.simulator import Simulator

EXPLORATION_SEEDS = 2**63
"""Seeds from here on are those of exploration; games have lower ones, whatever they are for."""


def exploration_streams(simulator: Simulator, seed: int) -> NDArray[np.uint64]:
    """[num_games, 1] uint64: a stream for each game that nothing in any game draws from.

    So what a learner does by chance says nothing of where its games begin.
    """
    streams = np.zeros((simulator.num_games, 1), dtype=np.uint64)
    own: Any = np.uint64(EXPLORATION_SEEDS + seed)
    seed_streams(streams, own, simulator.first_game)
    return streams
