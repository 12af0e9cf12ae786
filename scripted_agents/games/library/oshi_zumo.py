"""Oshi-zumo from OpenSpiel, in a size that is solved in seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pursuit.validation import whole
from scripted_agents.games.openspiel_optional import openspiel_game

if TYPE_CHECKING:
    from scripted_agents.games.openspiel_games import OpenSpielGame


def oshi_zumo(coins: int = 10, size: int = 2, min_bid: int = 1) -> OpenSpielGame:
    """Oshi-zumo (Buro, 2003): two players bid coins to push a wrestler off the other's end.

    The wrestler starts in the middle of 2 size + 1 places. In every round both bid coins at once,
    at least `min_bid`, or all that they have if that is less, and both pay. The higher bid pushes
    the wrestler one place towards the other player. Who pushes it off the end wins; when no coins
    are left, who has it in the other's half. The winner gets 1, the other -1, both 0 if it is in
    the middle. The players are player_0 and player_1, an action is a number of coins. With
    `min_bid=1` the game ends after at most `coins` rounds, so solve it with discount 1 and that
    horizon; with `min_bid=0` give a discount below 1. The value is 0, as the game is symmetric.
    Source: M. Buro, "Solving the Oshi-Zumo game", Advances in Computer Games 10 (2003).

    Args:
        coins: of each player at the start, 1 to 50.
        size: places on either side of the middle, 1 to 10.
        min_bid: 0 or 1.

    Raises:
        ValueError: an invalid argument, or OpenSpiel is not installed.
    """
    for name, value, least, most in (("coins", coins, 1, 50), ("size", size, 1, 10)):
        whole(name, value, least, most)
    whole("min_bid", min_bid, 0, 1)
    return openspiel_game(f"oshi_zumo(coins={coins},size={size},min_bid={min_bid})")
