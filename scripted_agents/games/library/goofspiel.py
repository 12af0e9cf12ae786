"""Goofspiel, the game of pure strategy, with open bids."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import one_of, whole
from scripted_agents.games.library.boards import Transitions

ORDERS, POINTS = ("random", "descending", "ascending"), ("difference", "win")
MOST, MOST_RANDOM = 10, 7
"""Cards: 184,756 states in a fixed order, 367,360 in random order, more with points="win"."""


class Table(NamedTuple):
    """A state of goofspiel.

    Attributes:
        hands: the cards of each player, ascending.
        prizes: those to come, ascending.
        prize: the one that is bid for.
        lead: the points of player_0 minus those of player_1; 0 if they are paid at once.
    """

    hands: tuple[tuple[int, ...], tuple[int, ...]]
    prizes: tuple[int, ...]
    prize: int
    lead: int


class Goofspiel:
    """Two players bid cards for prizes, zero-sum; all that was played is seen by both.

    Each player holds the cards 1 to `cards`; the prizes are the numbers 1 to `cards` too. In every
    round one prize is shown, and both players bid a card of their hand at once. The higher card
    wins the points of the prize; with equal cards no player does. Both cards and the prize leave
    the game, which ends after `cards` rounds, so solve it with discount 1 and that horizon. The
    value is 0, as the game is symmetric.

    Against uniformly random bids the best response bids the card that equals the prize (Ross,
    1971) and wins (cards**2 - 1) / 6 points in the mean. Sources: S. M. Ross, "Goofspiel: the game
    of pure strategy", Journal of Applied Probability 8 (1971); G. C. Rhoads and L. Bartholdi,
    "Computer solution to the game of pure strategy", Games 3 (2012), whose recursion over (both
    hands, prizes) is that of these states: points that are paid at once need not be remembered.

    Args:
        cards: of each player, 2 to `MOST`; in random order up to `MOST_RANDOM`.
        order: of the prizes: "random", each of the remaining ones is equally likely to be next;
            "descending" or "ascending".
        points: "difference": the winner of a round gets the points of the prize, the other the
            negative. "win": who has more points at the end gets 1, the other -1, both 0 if they
            have the same; the state then holds the difference so far.

    Raises:
        ValueError: an invalid argument.
    """

    players = ("player_0", "player_1")

    def __init__(self, cards: int = 4, order: str = "random", points: str = "difference") -> None:
        self.cards = whole("cards", cards, 2, MOST)
        self.order: str = one_of("order", order, ORDERS)
        self.points: str = one_of("points", points, POINTS)
        if self.order == "random" and self.cards > MOST_RANDOM:
            raise ValueError(
                f"cards={cards}, order='random'; it is at most {MOST_RANDOM} in random order: give "
                "fewer cards, or order='descending' or 'ascending'"
            )

    def starts(self) -> list[tuple[float, Table]]:
        """Full hands and the first prize."""
        every = tuple(range(1, self.cards + 1))
        return self._shown((every, every), every, 0)

    def _shown(
        self, hands: tuple[tuple[int, ...], tuple[int, ...]], prizes: tuple[int, ...], lead: int
    ) -> list[tuple[float, Table]]:
        """The probability of each next prize, and the state with it."""
        nexts = {"random": prizes, "descending": prizes[-1:], "ascending": prizes[:1]}[self.order]
        return [
            (1.0 / len(nexts), Table(hands, _without(prizes, prize), prize, lead))
            for prize in nexts
        ]

    def legal_actions(self, state: Table, player: int) -> tuple[int, ...]:
        """The cards of the player's hand."""
        return state.hands[player]

    def transitions(self, state: Table, actions: tuple[int, int]) -> Transitions[Table]:
        """One round, and the next prize."""
        won = state.prize * ((actions[0] > actions[1]) - (actions[0] < actions[1]))
        hands = _without(state.hands[0], actions[0]), _without(state.hands[1], actions[1])
        paid, lead = float(won), 0
        if self.points == "win":
            lead = state.lead + won
            paid = 0.0 if state.prizes else float(np.sign(lead))
        if not state.prizes:
            return [(1.0, state, (paid, -paid), True)]
        following = self._shown(hands, state.prizes, lead)
        return [(chance, after, (paid, -paid), False) for chance, after in following]

    def observe(self, state: Table, player: int) -> NDArray[np.float32]:
        """[4 cards + 1] float32: whether each card is in the player's hand, in the other's, a prize
        to come, the prize that is shown; then the player's lead over the sum of all prizes."""
        sets = state.hands[player], state.hands[1 - player], state.prizes, (state.prize,)
        seen = [card in each for each in sets for card in range(1, self.cards + 1)]
        lead = (1 - 2 * player) * state.lead / (self.cards * (self.cards + 1) / 2)
        return np.array([*seen, lead], dtype=np.float32)

    def draw(self, state: Table) -> str:
        """The prizes and hands in words."""
        lines = [f"prize {state.prize}, to come: {_listed(state.prizes)}"]
        for name, hand in zip(self.players, state.hands, strict=True):
            lines.append(f"{name} holds {_listed(hand)}")
        if self.points == "win":
            ahead = self.players[state.lead < 0]
            lines.append(f"{ahead} leads by {abs(state.lead)}" if state.lead else "equal points")
        return "\n".join(lines)


def _without(cards: tuple[int, ...], played: int) -> tuple[int, ...]:
    return tuple(card for card in cards if card != played)


def _listed(cards: tuple[int, ...]) -> str:
    return " ".join(map(str, cards)) or "none"
