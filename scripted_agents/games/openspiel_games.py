"""Games of OpenSpiel as small games."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import product
from random import Random

import numpy as np
import pyspiel
from numpy.typing import NDArray

from pursuit.validation import whole
from scripted_agents.games.game import Action, Outcome, State

COMPARED_MOVES, COMPARED_TIMES = 20, 3
"""Moves by which two positions of the same text are compared, and how often for each text."""


class OpenSpielGame:
    """A game of OpenSpiel with perfect information as a `Game`.

    Sequential or simultaneous, with or without chance. A state is (text, steps, player to move,
    legal actions of each player); steps are 0 without a horizon. Positions that agree in these are
    one state, whatever their history, and random moves from them are compared: rewards and legal
    actions must be the same for up to `COMPARED_MOVES` moves.

    Args:
        game: a `pyspiel.Game`, or its name.
        horizon: steps after which the game ends; None for none. Games that count their steps
            without showing them (cliff_walking, pig) need it.

    Raises:
        ValueError: an unknown game, one without perfect information, or one that draws its chance
            moves itself. While it is enumerated: positions of one state that differ.
    """

    def __init__(self, game: pyspiel.Game | str, horizon: int | None = None) -> None:
        self.spiel = _loaded(game)
        self.horizon = None if horizon is None else whole("horizon", horizon, 1)
        kind, known = self.spiel.get_type(), pyspiel.GameType
        if kind.information not in (
            known.Information.PERFECT_INFORMATION,
            known.Information.ONE_SHOT,
        ):
            raise ValueError(
                f"{kind.short_name} has hidden information; small games have perfect information"
            )
        if kind.chance_mode == known.ChanceMode.SAMPLED_STOCHASTIC:
            raise ValueError(
                f"{kind.short_name} does not list its chance outcomes; small games need their "
                "probabilities"
            )
        if kind.dynamics == known.Dynamics.MEAN_FIELD:
            raise ValueError(f"{kind.short_name} is a mean field game; give one of few players")
        self.players = tuple(f"player_{i}" for i in range(self.spiel.num_players()))
        self._positions: dict[State, pyspiel.State] = {}
        self._met: Counter[State] = Counter()
        self._random = Random(0)

    def starts(self) -> list[tuple[float, State]]:
        """The positions after the first moves of chance."""
        found = _resolved(self.spiel.new_initial_state())
        if any(position.is_terminal() for _, position in found):
            raise ValueError(f"{self.spiel} ends before the first move; give a larger game")
        return [(chance, self._name(position, 0)) for chance, position in found]

    def draw(self, state: State) -> str:
        """The position as OpenSpiel writes it."""
        return str(state[0])

    def legal_actions(self, state: State, player: int) -> list[Action]:
        """The legal actions; None for a player that is not to move."""
        return list(state[3][player]) or [None]

    def transitions(self, state: State, actions: tuple[Action, ...]) -> list[Outcome]:
        """The positions after these actions and the moves of chance, with the gained returns."""
        position = self._positions[state]
        step = state[1] + 1 if self.horizon is not None else 0
        outcomes = []
        for chance, after in _resolved(_moved(position, actions)):
            over = after.is_terminal() or (self.horizon is not None and step >= self.horizon)
            name = None if over else self._name(after, step)
            outcomes.append((chance, name, _gained(position, after).tolist(), over))
        return outcomes

    def _name(self, position: pyspiel.State, step: int) -> State:
        legal = self._legal(position)
        name = (str(position), step, int(position.current_player()), legal)
        known = self._positions.setdefault(name, position)
        if known is not position:
            self._met[name] += 1
            left = COMPARED_MOVES if self.horizon is None else self.horizon - step
            if self._met[name] == 1 and left:
                for actions in product(*(row or (None,) for row in legal)):
                    self._compare(known, position, 1, actions)
            if self._met[name] <= COMPARED_TIMES:
                self._compare(known, position, min(left, COMPARED_MOVES))
        return name

    def _legal(self, position: pyspiel.State) -> tuple[tuple[int, ...], ...]:
        return tuple(tuple(position.legal_actions(p)) for p in range(len(self.players)))

    def _compare(
        self,
        first: pyspiel.State,
        second: pyspiel.State,
        moves: int,
        actions: Sequence[Action] | None = None,
    ) -> None:
        """Move in the same way from two positions, at random without `actions`.

        Raises:
            ValueError: they go on in different ways.
        """
        now, other = first, second
        for _ in range(moves):
            played = actions or [self._random.choice(row or (None,)) for row in self._legal(now)]
            after, others = (_resolved(_moved(position, played)) for position in (now, other))
            chances = [chance for chance, _ in after]
            pairs = [(a, b) for (_, a), (_, b) in zip(after, others, strict=False)]
            if chances != [chance for chance, _ in others] or not all(
                a.current_player() == b.current_player()
                and self._legal(a) == self._legal(b)
                and np.abs(_gained(first, a) - _gained(second, b)).max() < 1e-9
                for a, b in pairs
            ):
                raise ValueError(
                    f"{self.spiel}: the histories {first.history()} and {second.history()} lead to "
                    f"{str(first)!r}, with the same legal actions, but go on in different ways "
                    f"(with {played} after {now.history()} and {other.history()}); give a horizon "
                    "if the game counts its steps, else write it as a Game with states that tell "
                    "them apart"
                )
            now, other = self._random.choice(pairs)
            if now.is_terminal():
                return


def _gained(start: pyspiel.State, end: pyspiel.State) -> NDArray[np.float64]:
    return np.subtract(end.returns(), start.returns())


def _loaded(game: pyspiel.Game | str) -> pyspiel.Game:
    """A game of OpenSpiel, by its name or as it is."""
    try:
        loaded = pyspiel.load_game(game) if isinstance(game, str) else game
    except pyspiel.SpielError as error:
        raise ValueError(f"game={game!r}: {str(error).splitlines()[0]}") from None
    if not isinstance(loaded, pyspiel.Game):
        raise ValueError(f"game={game!r}; give a pyspiel.Game, or the name of one")
    return loaded


def _moved(position: pyspiel.State, actions: Sequence[Action]) -> pyspiel.State:
    """The position after these actions, before any move of chance."""
    after = position.clone()
    if after.is_simultaneous_node():
        after.apply_actions(list(actions))
    else:
        after.apply_action(actions[after.current_player()])
    return after


def _resolved(position: pyspiel.State) -> list[tuple[float, pyspiel.State]]:
    """The positions after all moves of chance, with their probabilities."""
    if not position.is_chance_node():
        return [(1.0, position)]
    return [
        (chance * rest, after)
        for outcome, chance in position.chance_outcomes()
        for rest, after in _resolved(position.child(outcome))
    ]


def openspiel_game(text: str) -> OpenSpielGame:
    """The game of OpenSpiel in a name with arguments, such as "tic_tac_toe"."""
    return OpenSpielGame(text)
