"""Games as one table, to compare everything about them at once."""

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.simulator import Simulator, SimulatorState


def rows_of(games: Simulator | SimulatorState) -> NDArray[np.int32]:
    """[games, ...]: positions, active, events, goals, steps and maze of every game, a copy."""
    parts = (games.positions, games.active, games.events, games.goals)
    return np.column_stack([*parts, games.steps, games.maze_index])
