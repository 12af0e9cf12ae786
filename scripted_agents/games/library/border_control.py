"""Border control: two guards and one intruder on a grid with exits."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import whole
from scripted_agents.games.library.boards import (
    DIAGONALS,
    MOVES,
    Cell,
    Transitions,
    cells_of,
    moved,
    one_hot,
    picture,
)

Watch = tuple[tuple[Cell, Cell], Cell]
"""The cells of the guards, the smaller one first, and that of the intruder."""
Pair = tuple[str, str]
"""The moves of the guards, in the order of their cells."""
CHANGES = {**MOVES, **DIAGONALS}
MOST = 8
"""Rows and columns: at most 112,896 states."""


class BorderControl:
    """Two guards catch an intruder before it reaches the east side of a grid, zero-sum.

    The player "guards" moves both guards; its actions are pairs of moves. All move at once: each
    guard north, south, east, west, or it stands; the intruder also diagonally. Moves off the grid
    are not legal. The guards may share a cell, and are told apart by their cells only: the first
    move of a pair is that of the guard with the smaller cell (row by row, from the north-west).

    After the moves the guards win if one of them is in the intruder's cell, or changed cells with
    it. Otherwise the intruder wins if it is on an exit; the exits are all cells of the last column.
    The winner gets 1, the other -1, and the game ends. Otherwise it goes on without a limit, so
    give the solver a discount below 1.

    The intruder starts in the first column, in each row with equal probability, the guards in the
    last column, in rows (rows - 1) // 2 and rows // 2 (one cell if the number of rows is odd).

    A diagonal move changes the row on the way, so guards must guess the row: an intruder without
    diagonal moves would be caught almost always. Source: rules of our own; a discrete form of
    guarding a target (R. Isaacs, "Differential Games", 1965), with the captures of this package.

    Args:
        rows: of the grid, 2 to `MOST`.
        columns: of the grid, 3 to `MOST`.

    Raises:
        ValueError: an invalid argument.
    """

    players = ("guards", "intruder")

    def __init__(self, rows: int = 4, columns: int = 5) -> None:
        self.rows, self.columns = whole("rows", rows, 2, MOST), whole("columns", columns, 3, MOST)
        self.cells = cells_of(self.rows, self.columns)
        on_board = set(self.cells)
        self._guard_moves, self._intruder_moves = (
            {cell: [m for m in known if moved(cell, CHANGES[m]) in on_board] for cell in self.cells}
            for known in (MOVES, CHANGES)
        )

    def starts(self) -> list[tuple[float, Watch]]:
        """The intruder is in any row."""
        last = self.columns - 1
        guards = ((self.rows - 1) // 2, last), (self.rows // 2, last)
        return [(1.0 / self.rows, (guards, (row, 0))) for row in range(self.rows)]

    def legal_actions(self, state: Watch, player: int) -> list[str] | list[Pair]:
        """The moves of the intruder, or the pairs of moves of the guards."""
        (first, second), intruder = state
        if player == 1:
            return self._intruder_moves[intruder]
        return list(product(self._guard_moves[first], self._guard_moves[second]))

    def transitions(self, state: Watch, actions: tuple[Pair, str]) -> Transitions[Watch]:
        """All move at once."""
        (first, second), intruder = state
        target = moved(intruder, CHANGES[actions[1]])
        one, other = moved(first, MOVES[actions[0][0]]), moved(second, MOVES[actions[0][1]])
        swapped = (one, target) == (intruder, first) or (other, target) == (intruder, second)
        if target in (one, other) or swapped:
            return [(1.0, state, (1.0, -1.0), True)]
        if target[1] == self.columns - 1:
            return [(1.0, state, (-1.0, 1.0), True)]
        guards = (one, other) if one <= other else (other, one)
        return [(1.0, (guards, target), (0.0, 0.0), False)]

    def observe(self, state: Watch, player: int) -> NDArray[np.float32]:
        """[3 rows columns] float32: the cells of the first guard, of the second and of the
        intruder, row by row, one-hot; the same for both players."""
        guards, intruder = state
        return np.concatenate([one_hot(cell, self.cells) for cell in (*guards, intruder)])

    def draw(self, state: Watch) -> str:
        """The grid with guards G (2 where both are), the intruder I, and exits E."""
        marks = {(row, self.columns - 1): "E" for row in range(self.rows)}
        (first, second), intruder = state
        marks |= {first: "G", second: "2" if first == second else "G", intruder: "I"}
        return picture(self.rows, self.columns, marks, {})
