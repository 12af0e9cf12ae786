"""The rewards of `pursuit_v5` of PettingZoo's SISL environments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.rules.layout import CAPTURED, CHASER
from pursuit.tasks.moments import After, Before


@dataclass(frozen=True)
class PursuitV5Rewards:
    """The rewards of `pursuit_v5`, up to rounding to float32; those of other agents are 0.

    The tag reward is paid after the move of every single chaser, to all chasers, for each evader
    one move away, and divided by the number of chasers. A cell beyond the border counts as the
    chaser's own cell: evaders in it are paid once for each side of the border there. Every captor
    gets `catch`, once a step for any number of evaders.

    Attributes:
        tag, catch, urgency: `tag_reward`, `catch_reward` and `urgency_reward` there.
        shared: whether every chaser gets the mean of all, as with `shared_reward=True` there.
    """

    tag: float = 0.01
    catch: float = 5.0
    urgency: float = -0.1
    shared: bool = True

    def for_mazes(self, mazes: Sequence[Maze]) -> Callable[[Before, Any, After], Any]:
        """The reward function of games in these mazes.

        Raises:
            ValueError: a graph, which has no border, or a maze too large for a table of distances.
        """
        sides = np.zeros((len(mazes), max(maze.num_cells for maze in mazes)), dtype=np.int64)
        for number, maze in enumerate(mazes):
            if not maze.is_grid or maze.num_cells > MAX_TABLE_CELLS:
                raise ValueError(
                    f"rewards 'pursuit_v5' need the rows and columns and all distances of a maze, "
                    f"which {maze.name} ({maze.num_cells} cells) does not have; give a maze of at "
                    f"most {MAX_TABLE_CELLS} cells"
                )
            for place, last in ((maze.rows, maze.height - 1), (maze.columns, maze.width - 1)):
                sides[number, : maze.num_cells] += (place == 0) * 1 + (place == last)

        def rewards(before: Before, actions: Any, after: After) -> NDArray[np.float64]:
            chasers, maze = before.roles == CHASER, before.maze_index[:, None]
            free = before.active[:, None, ~chasers]
            evaders = before.positions[:, None, ~chasers]

            def tags(cells: NDArray[np.int32]) -> NDArray[np.int64]:  # [games, chasers]
                beside = before.distances[maze[..., None], cells[..., None], evaders] == 1
                here = (cells[..., None] == evaders) * sides[maze, cells][..., None]
                return np.asarray(((beside + here) * free).sum(axis=2))

            count, number = chasers.sum(), np.arange(chasers.sum())  # chaser i waits for i others
            past, now = tags(before.positions[:, chasers]), tags(after.positions[:, chasers])
            own = self.tag * (number * past + (count - number) * now) / count + self.urgency
            own += self.catch * ((after.events[:, chasers] & CAPTURED) > 0)
            paid = np.zeros(before.positions.shape)
            paid[:, chasers] = own.mean(axis=1, keepdims=True) if self.shared else own
            return paid

        return rewards
