"""Games of OpenSpiel by name, refused with the remedy where it is not installed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pursuit.plugins import OPENSPIEL
from pursuit.validation import shortened

if TYPE_CHECKING:
    from scripted_agents.games.openspiel_games import OpenSpielGame


def openspiel_game(text: str) -> OpenSpielGame:
    """A game of OpenSpiel by its text, such as "pig(horizon=5,winscore=10)"; see `OpenSpielGame`.

    A horizon is OpenSpiel's own where the game has such a parameter, else steps after which the
    game ends.

    Raises:
        ValueError: as of `OpenSpielGame`, or OpenSpiel is not installed.
    """
    try:
        from scripted_agents.games.openspiel_games import OpenSpielGame
    except ImportError as error:
        raise ValueError(
            f"game={shortened(OPENSPIEL + text)} needs OpenSpiel, which is not installed "
            f"({error.name}); pip install 'pursuit[openspiel]'"
        ) from None
    return OpenSpielGame(text)
