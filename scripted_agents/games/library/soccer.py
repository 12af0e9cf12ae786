"""Littman's soccer on a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import whole
from scripted_agents.games.library.boards import (
    MOVES,
    Cell,
    Transitions,
    cells_of,
    moved,
    one_hot,
    picture,
)

Position = tuple[Cell, Cell, int]
"""The cell of A, the cell of B, and the index of the player with the ball."""
MOST = 10
"""Rows and columns: 19,800 states."""


class Soccer:
    """Soccer of two players on a grid (Littman, 1994), zero-sum; it ends with the first goal.

    A and B stand in different cells, one of them has the ball. Both choose north, south, east, west
    or stand at once; all five are always legal. The moves are executed one after the other, in
    either order with probability 1/2. A move

    - into the cell in which the other player stands then does not take place, and the other player
      has the ball afterwards, whoever had it;
    - by the player with the ball, from a goal row over the end of the grid that it attacks, is a
      goal: the player gets 1, the other -1, and the game ends, without the move that is left;
    - over any other edge does not take place.

    A attacks the west end, B the east end. Goal rows are the middle one, or the middle two of an
    even number of rows. A starts in the column before the last, in row rows // 2, B in column 1,
    in row (rows - 1) // 2 (counted from 0 in the north-west); either has the ball with probability
    1/2.

    In the paper the board is reset after a goal. By symmetry a start is worth 0, so play before a
    goal is the same. Its discount of 0.9 is that of the solver, `equilibrium(game, 0.9)`; the draw
    with probability 0.1 in every step, by which the paper evaluates policies, amounts to the same.
    Source: M. L. Littman, "Markov games as a framework for multi-agent reinforcement learning",
    ICML 1994.

    Args:
        rows: of the grid, 2 to `MOST`.
        columns: of the grid, 4 to `MOST`.

    Raises:
        ValueError: an invalid argument.
    """

    players = ("A", "B")

    def __init__(self, rows: int = 4, columns: int = 5) -> None:
        self.rows, self.columns = whole("rows", rows, 2, MOST), whole("columns", columns, 4, MOST)
        self.goal_rows = {(self.rows - 1) // 2, self.rows // 2}
        self.cells = cells_of(self.rows, self.columns)
        self._on_board = set(self.cells)

    def starts(self) -> list[tuple[float, Position]]:
        """The ball is with either player."""
        cells = (self.rows // 2, self.columns - 2), ((self.rows - 1) // 2, 1)
        return [(0.5, (*cells, ball)) for ball in (0, 1)]

    def legal_actions(self, state: Position, player: int) -> tuple[str, ...]:
        """All five."""
        return tuple(MOVES)

    def transitions(self, state: Position, actions: tuple[str, str]) -> Transitions[Position]:
        """The moves in both orders."""
        return [(0.5, *self._after(state, actions, order)) for order in ((0, 1), (1, 0))]

    def _after(
        self, state: Position, actions: tuple[str, str], order: tuple[int, int]
    ) -> tuple[Position, tuple[float, float], bool]:
        cells, ball = [state[0], state[1]], state[2]
        for player in order:
            row, column = target = moved(cells[player], MOVES[actions[player]])
            if target == cells[1 - player]:
                ball = 1 - player
            elif target in self._on_board:
                cells[player] = target
            elif ball == player and row in self.goal_rows and column == (-1, self.columns)[player]:
                return state, ((1.0, -1.0), (-1.0, 1.0))[player], True
        return (cells[0], cells[1], ball), (0.0, 0.0), False

    def observe(self, state: Position, player: int) -> NDArray[np.float32]:
        """[2 rows columns + 1] float32: the player's cell and the other's, row by row, one-hot;
        then whether the player has the ball."""
        places = [one_hot(state[seat], self.cells) for seat in (player, 1 - player)]
        return np.concatenate([*places, [np.float32(state[2] == player)]])

    def draw(self, state: Position) -> str:
        """The grid, with gaps for the goals; the player with the ball is marked by `*`."""
        marks = {
            cell: name + "*" * (state[2] == seat)
            for seat, (name, cell) in enumerate(zip(self.players, state[:2], strict=True))
        }
        board = picture(self.rows, self.columns, marks, dict.fromkeys(self.goal_rows, (" ", " ")))
        return f"{board}\n{self.players[state[2]]} has the ball; A attacks west, B east"
