"""Random mazes, as functions of a seed and as Hypothesis strategies, shared by several tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from pursuit.mazes.maze import Maze


def random_maze(seed: int, height: int, width: int, open_share: float, blocked: float) -> Maze:
    """Each wall is open, and each cell blocked, with these probabilities; never all cells."""
    rng = np.random.default_rng(seed)
    walkable = rng.random((height, width)) >= blocked
    walkable[rng.integers(height), rng.integers(width)] = True
    return Maze(
        walkable,
        rng.random((height - 1, width)) < open_share,
        rng.random((height, width - 1)) < open_share,
    )


def connected_maze(seed: int, height: int, width: int) -> Maze:
    """A maze with loops, and mostly with some blocked cells, in one part."""
    while not (maze := random_maze(seed, height, width, 0.7, 0.1)).is_connected:
        seed += 1_000_003
    return maze


seeds = st.integers(0, 2**32 - 1)
any_maze = st.builds(
    random_maze, seeds, st.integers(1, 7), st.integers(1, 7), st.floats(0, 1), st.floats(0, 0.5)
)
small_maze = st.builds(connected_maze, seeds, st.integers(1, 4), st.integers(2, 4))
