"""The cells visible to a scripted agent, by its own limits or by those of the task."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.simulator.policy import GameView, Memory
from pursuit.tasks.visibility import check_visible, visible_cells
from pursuit.validation import check_bool, whole


class ViewTables:
    """Tables of the cells that are visible from each cell.

    Args:
        view_radius: the path distance up to which cells are visible, at least 0.
        line_of_sight: whether cells are visible only along rows and columns, up to the next wall.
            Without both, the limits of the task apply.

    Raises:
        ValueError: an invalid setting.
    """

    def __init__(self, view_radius: int | None = None, line_of_sight: bool = False) -> None:
        self.view_radius = None if view_radius is None else whole("view_radius", view_radius)
        self.line_of_sight = check_bool("line_of_sight", line_of_sight)
        self._kept = Memory(self._laid_out)

    def __repr__(self) -> str:
        radius = [] if self.view_radius is None else [f"view_radius={self.view_radius}"]
        return ", ".join([*radius, "line_of_sight=True"][: len(radius) + self.line_of_sight])

    def table(self, view: GameView) -> NDArray[np.uint8]:
        """uint8 [own, other] of all mazes of the view, with the layout of the distance tables.

        Raises:
            ValueError: a maze is too large for a table.
        """
        return self._kept.of(view)["visible"]

    def _laid_out(self, view: GameView) -> dict[str, NDArray[Any]]:
        for maze in view.task.mazes:
            check_visible(maze)
        pairs = [self.of(view, number, maze).ravel() for number, maze in enumerate(view.task.mazes)]
        return {"visible": np.concatenate(pairs).astype(np.uint8)}

    def of(self, view: GameView, number: int, maze: Maze) -> NDArray[np.bool_]:
        """[own, other] bool in one of the mazes of a view."""
        if self.view_radius is None and not self.line_of_sight:
            return view.task.sees(view.seat, number)
        return visible_cells(maze, self.view_radius, self.line_of_sight)
