"""Rock-paper-scissors, repeated without an end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import check_bool, number
from scripted_agents.games.library.boards import Transitions, one_hot

ACTIONS = ("rock", "paper", "scissors")
"""Each is beaten by the next, the last by the first."""

Last = tuple[str, str] | None
"""What both played before, player_0 first; None at the start, and always without a memory."""


class RockPaperScissors:
    """Repeated rock-paper-scissors, zero-sum; the state is what both players did in the last round.

    In every round both choose rock, paper or scissors at once. Paper beats rock, scissors beat
    paper, rock beats scissors. The winner of the round gets 1 (`rock_win` if it won by rock), the
    other the negative, both 0 if they chose the same. The game never ends: give the solver a
    discount or a horizon, and training a limit on steps.

    The value is 0, and in an equilibrium both play paper with probability
    rock_win / (2 + rock_win), and rock and scissors with 1 / (2 + rock_win), in every state: this
    is the only equilibrium of one round, and earlier rounds change nothing. With `rock_win=1` that
    is uniform play, with which an untrained policy begins; another `rock_win` shows whether a
    learner finds an equilibrium.

    Args:
        memory: whether the state holds the last round (10 states); else there is one state.
        rock_win: the reward of a win by rock, above 0.

    Raises:
        ValueError: an invalid argument.
    """

    players = ("player_0", "player_1")

    def __init__(self, memory: bool = True, rock_win: float = 1.0) -> None:
        self.memory = check_bool("memory", memory)
        self.rock_win = number("rock_win", rock_win)
        if self.rock_win <= 0.0:
            raise ValueError(f"rock_win={rock_win}; give a reward above 0, such as 2")

    def starts(self) -> list[tuple[float, Last]]:
        """No round was played."""
        return [(1.0, None)]

    def legal_actions(self, state: Last, player: int) -> tuple[str, ...]:
        """All three."""
        return ACTIONS

    def transitions(self, state: Last, actions: tuple[str, str]) -> Transitions[Last]:
        """One round."""
        first, second = map(ACTIONS.index, actions)
        ahead = (0, 1, -1)[(first - second) % 3]
        paid = ahead * (self.rock_win if actions[ahead < 0] == "rock" else 1.0)
        return [(1.0, actions if self.memory else None, (paid, -paid), False)]

    def observe(self, state: Last, player: int) -> NDArray[np.float32]:
        """[6] float32: what the player did last, what the other did, one-hot; 0 at the start."""
        shown = state or (None, None)
        return np.concatenate([one_hot(shown[seat], ACTIONS) for seat in (player, 1 - player)])

    def draw(self, state: Last) -> str:
        """The last round in words."""
        if state is None:
            return "no round is remembered"
        return "\n".join(
            f"{name}: {action}" for name, action in zip(self.players, state, strict=True)
        )
