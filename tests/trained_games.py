"""Small games for tests of training: chases, matrix games, and others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import pursuit


class Chase:
    """One chaser and one evader in a maze, with the rewards `zero_sum`."""

    players = ("chaser", "evader")

    def __init__(self, maze: str = "3x3") -> None:
        loaded = pursuit.load_maze(maze)
        self.moves, self.cells = loaded.neighbors.tolist(), loaded.num_cells

    def starts(self) -> list[Any]:
        pairs = [(c, e) for c in range(self.cells) for e in range(self.cells) if c != e]
        return [(1.0 / len(pairs), pair) for pair in pairs]

    def legal_actions(self, state: Any, player: int) -> Sequence[int]:
        return range(4)

    def observe(self, state: Any, player: int) -> Any:
        """The own cell and that of the other, as the encoding `index` of mazes."""
        return np.eye(self.cells)[[state[player], state[1 - player]]].ravel()

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        c, e = (self.moves[cell][action] for cell, action in zip(state, actions, strict=True))
        caught = c == e or (c, e) == (state[1], state[0])
        return [(1.0, (c, e), (-1.0, 1.0), caught)]


class Matrix:
    """A zero-sum game of one step."""

    players = ("row", "column")

    def __init__(self, name: str) -> None:
        self.payoff = PAYOFFS[name]

    def starts(self) -> list[Any]:
        return [(1.0, "only")]

    def legal_actions(self, state: Any, player: int) -> Sequence[int]:
        return range(self.payoff.shape[player])

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        paid = float(self.payoff[actions])
        return [(1.0, state, (paid, -paid), True)]


PAYOFFS = {
    "rock_paper_scissors": np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]]),
    "biased": np.array([[0, -1, 2], [1, 0, -3], [-2, 3, 0]]),
    "pennies": np.array([[3, -1], [-1, 1]]),
}
"""The equilibria are uniform, (3, 2, 1) / 6, and (1, 2) / 3, of both players."""


class Stones:
    """Players take 1, 2 or 3 stones in turn; the last stone wins. A hand can tremble: one less.

    It has several starts, chance, turns, and legal actions that depend on the state.
    """

    def __init__(self, stones: int = 6, num_players: int = 2, prize: float = 1.0) -> None:
        self.stones, self.players, self.prize = stones, tuple("abcd"[:num_players]), prize

    def starts(self) -> list[Any]:
        return [(0.75, (self.stones, 0)), (0.25, (self.stones - 1, 1))]

    def legal_actions(self, state: Any, player: int) -> Sequence[Any]:
        left, mover = state
        return range(1, min(left, 3) + 1) if mover == player else (None,)

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        left, mover = state
        taken = actions[mover]
        chances = [(0.8, taken), (0.2, taken - 1)] if taken > 1 else [(1.0, taken)]
        return [(chance, *self._after(left - number, mover)) for chance, number in chances]

    def _after(self, left: int, mover: int) -> tuple[Any, Any, bool]:
        count = len(self.players)
        ended = left == 0
        rewards = [-self.prize / (count - 1)] * count if ended else [0.0] * count
        if ended:
            rewards[mover] = self.prize
        return (left, (mover + 1) % count), rewards, ended


class Crowd:
    """Three choose a number; who is alone wins 1, and the third player 1 more with 2 as the third
    number, which it has in the first state only. The game goes on by chance. General sum.
    """

    players = ("a", "b", "c")

    def starts(self) -> list[Any]:
        return [(1.0, 0)]

    def legal_actions(self, state: Any, player: int) -> Sequence[int]:
        return (0, 1, 2) if player == 2 and state == 0 else (0, 1)

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        paid = [float(actions.count(own) == 1) for own in actions]
        paid[0] += 0.5 * state
        return [(0.5, 0, paid, False), (0.3, 1, paid, False), (0.2, 2, paid, True)]


def take_one(state: Any) -> dict[int, float]:
    """A policy of player b of `Stones`."""
    return {1 if state[1] == 1 else None: 1.0}
