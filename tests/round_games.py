"""Small games with known values, and policies and a sampling rule for them, for the tests."""

from __future__ import annotations

from typing import Any

MOVES = ("rock", "paper", "scissors")


class Rounds:
    """Rock, paper, scissors, so many times, without memory; the state is the round."""

    players = ("row", "column")

    def __init__(self, rounds: int = 1) -> None:
        self.rounds = rounds

    def starts(self) -> Any:
        return [(1.0, 0)]

    def legal_actions(self, state: int, player: int) -> Any:
        return MOVES

    def transitions(self, state: int, actions: Any) -> Any:
        won = (0.0, 1.0, -1.0)[(MOVES.index(actions[0]) - MOVES.index(actions[1])) % 3]
        return [(1.0, state + 1, (won, -won), state + 1 == self.rounds)]


class Clash:
    """The battle of the sexes."""

    players = ("one", "two")

    def starts(self) -> Any:
        return [(1.0, 0)]

    def legal_actions(self, state: int, player: int) -> Any:
        return ("ballet", "fight")

    def transitions(self, state: int, actions: Any) -> Any:
        both = {("ballet", "ballet"): (2.0, 1.0), ("fight", "fight"): (1.0, 2.0)}
        return [(1.0, None, both.get(actions, (0.0, 0.0)), True)]


class OddOneOut:
    """Three players choose 0 or 1; who is alone wins 1. It may be played again."""

    players = ("a", "b", "c")

    def starts(self) -> Any:
        return [(1.0, 0)]

    def legal_actions(self, state: int, player: int) -> Any:
        return (0, 1)

    def transitions(self, state: int, actions: Any) -> Any:
        rewards = [float(list(actions).count(action) == 1) for action in actions]
        return [(0.5, 1 - state, rewards, False), (0.5, None, rewards, True)]


def rock(state: int) -> dict[str, float]:
    return {"rock": 1.0}


def paper(state: int) -> dict[str, float]:
    return {"paper": 1.0}


def scissors(state: int) -> dict[str, float]:
    return {"scissors": 1.0}


def ballet(state: int) -> dict[str, float]:
    return {"ballet": 1.0}


def newest(pool: Any, payoffs: Any, progress: float) -> list[float]:
    """Mostly the newest member."""
    return [float(number + 1) for number in range(len(pool.members))]


def by_payoff(pool: Any, payoffs: Any, progress: float) -> list[float]:
    """A rule that asks for payoffs."""
    payoffs.matrix()
    return [1.0] * len(pool.members)
