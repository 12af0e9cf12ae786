"""Games of OpenSpiel as small games."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from itertools import product
from operator import sub
from random import Random
from typing import Any, TypeAlias

import numpy as np
import pyspiel
from numpy.typing import NDArray

from pursuit.validation import shortened, whole
from scripted_agents.games.enumeration import enumerate_game
from scripted_agents.games.game import Action, State, Transition
from scripted_agents.games.openspiel_loading import loaded_game

COUNTED_STEPS = 100
"""A limit of at most so many steps is a rule of the small game, also where the text hides it."""
LOOKED = 100
"""States in which it is looked for whether steps must be counted."""
TREE, PART = 50_000, 5_000
"""Outcomes up to which all histories are compared: of a game, and after one known position."""
CHECKED = 4_000_000
"""Outcomes up to which positions of one state are compared for every joint action."""
LINES, DRAWS = 200, 5
"""Of n positions that are known, about LINES log(n / LINES) are compared by a random line, in which
an action is drawn up to DRAWS times until the game does not end."""
MOST_OUTCOMES = 100_000
"""Of a step."""
REMEDIES = (
    "Give a horizon if they differ by their steps, else write it as a Game with states that tell "
    "them apart",
    "Steps are counted already; write it as a Game with states that tell them apart",
)

Found: TypeAlias = tuple[float, "State | None", tuple[float, ...], pyspiel.State]
"""An outcome: probability, state (None at the end), gained returns, position."""
Pair: TypeAlias = tuple[State, pyspiel.State, pyspiel.State]
"""A state and two positions of it."""


class _Different(ValueError):
    """Two positions of one state go on in different ways."""


class OpenSpielGame:
    """A game of OpenSpiel with perfect information as a `Game`.

    Sequential or simultaneous, with or without chance. A state is (text, steps, player to move,
    legal actions of each player); steps are 0 where they are not counted. Positions that agree in
    these are one state, whatever their history, and must have the same future:

    - Whenever the enumeration meets a position of a known state, both are compared: for every joint
      action the next states, their probabilities, the gained returns, and whether the game ends.
      With counted steps this is done once for each joint action between two texts. It proves equal
      futures if what a text hides depends on nothing but the last move. Beyond `CHECKED` outcomes
      (half a minute) one joint action is drawn for each comparison, and `sampled` is true.
    - The histories that follow are compared as well, up to `TREE` outcomes in all. If `proven` is
      true after the enumeration, these were all histories of the game, and all futures are equal.
    - Else some of these positions are compared by random lines. What a text hides for longer, and
      what rarely shows, can be missed.

    Steps are counted with a `horizon`, in games of OpenSpiel with a parameter "horizon" that is
    given or at most `COUNTED_STEPS`, and if positions were found to differ and the game lasts at
    most so many moves. Otherwise OpenSpiel's own limit of steps is no rule of the small game.

    Args:
        game: a `pyspiel.Game`, or its name, with parameters as in "nim(pile_sizes=1;2)".
        horizon: steps after which the game ends; None for none. Also a parameter "horizon" of the
            text, if OpenSpiel's game has none of this name.

    Attributes:
        players: "player_0", "player_1", ...
        horizon: as given.
        counts_steps: whether steps are a part of the state.
        zero_sum: whether OpenSpiel says that the sum of the rewards is 0.
        proven: whether all histories so far were compared.
        sampled: whether positions were compared by drawn joint actions only.

    Raises:
        ValueError: an unknown game or parameter, one without perfect information, one that draws
            its chance moves itself, or one that OpenSpiel cannot play. While it is enumerated:
            positions of one state that differ.
    """

    def __init__(self, game: pyspiel.Game | str, horizon: int | None = None) -> None:
        self.spiel, in_text = loaded_game(game)
        if horizon is not None and in_text is not None:
            raise ValueError(f"game={game!r} with horizon={horizon}; give one horizon")
        horizon = in_text if horizon is None else horizon
        self.horizon = None if horizon is None else whole("horizon", horizon, 1)
        kind, known = self.spiel.get_type(), pyspiel.GameType
        if kind.dynamics == known.Dynamics.MEAN_FIELD:
            raise ValueError(f"{kind.short_name} is a mean field game; give one of few players")
        if kind.information == known.Information.IMPERFECT_INFORMATION:
            raise ValueError(
                f"{kind.short_name} has hidden information; small games have perfect information. "
                "OpenSpiel's own algorithms, such as CFR, solve it"
            )
        if kind.chance_mode == known.ChanceMode.SAMPLED_STOCHASTIC:
            raise ValueError(
                f"{kind.short_name} does not list its chance outcomes; small games need their "
                "probabilities: write it as a Game"
            )
        self.players = tuple(f"player_{i}" for i in range(self.spiel.num_players()))
        self.zero_sum = kind.utility == known.Utility.ZERO_SUM or (
            kind.utility == known.Utility.CONSTANT_SUM and self.spiel.utility_sum() == 0.0
        )
        self._indices, self._nothing = range(len(self.players)), (0.0,) * len(self.players)
        own, length = self.spiel.get_parameters().get("horizon"), self.spiel.max_game_length()
        given = "horizon" in pyspiel.game_parameters_from_string(str(self.spiel))
        short = isinstance(own, int) and own <= COUNTED_STEPS
        self.counts_steps = given or short or self.horizon is not None
        # A long limit must not show in the comparisons where it is no rule of the small game.
        unlimited = not self.counts_steps and max(length, own or 0) > COUNTED_STEPS
        self._deepest = COUNTED_STEPS if unlimited else sys.maxsize
        self._clear()
        if not self.counts_steps and length <= COUNTED_STEPS:
            try:
                enumerate_game(self, LOOKED, progress=False)
            except _Different:
                self.counts_steps = True
            except ValueError:  # more states, or what is refused again
                pass
            self._clear()
        if kind.provides_observation_tensor:
            self.observe: Callable[[State, int], NDArray[np.float32]] = self._tensor

    def _clear(self) -> None:
        self.proven, self.sampled = True, False
        self._positions: dict[State, pyspiel.State] = {}
        self._signs: dict[State, int] = {}
        self._compared: set[int] = set()
        self._unlike: tuple[list[int], list[int]] | None = None
        self._outcomes = self._met = 0
        self._random = Random(0)

    def starts(self) -> list[tuple[float, State]]:
        """The positions after the first moves of chance."""
        found = _resolved(self.spiel.new_initial_state())
        if any(position.is_terminal() for _, position in found):
            raise ValueError(f"{self.spiel} ends before the first move; give a larger game")
        if any(any(position.returns()) for _, position in found):
            raise ValueError(
                f"{self.spiel} pays before the first move, which has no place in a small game; "
                "write it as a Game"
            )
        starts = [(chance, self._state(position, 0), position) for chance, position in found]
        for _, state, position in starts:
            self._meet(state, position, None)
        return [(chance, state) for chance, state, _ in starts]

    def legal_actions(self, state: State, player: int) -> list[Action]:
        """The legal actions; None for a player that is not to move."""
        return list(state[3][player]) or [None]

    def transitions(self, state: State, actions: tuple[Action, ...]) -> list[Transition]:
        """The positions after these actions and the moves of chance, with the gained returns."""
        found = self._after(state, self._positions[state], actions)
        for _, following, _, position in found:
            if following is not None:
                self._meet(following, position, (state, actions))
        return [(chance, after, gains, after is None) for chance, after, gains, _ in found]

    def draw(self, state: State) -> str:
        """The text of the position."""
        return str(state[0])

    def _tensor(self, state: State, player: int) -> NDArray[np.float32]:
        """OpenSpiel's observation tensor of a player, by its index, [size] float32.

        Counted steps are not in it, unless OpenSpiel has them there.

        Raises:
            ValueError: it is no function of the state, as far as the enumeration has found.
        """
        if self._unlike:
            raise ValueError(
                f"{self.spiel} has other observation tensors after {self._unlike[0]} than after "
                f"{self._unlike[1]}, which are one state; observe its number instead"
            )
        return np.array(self._positions[state].observation_tensor(player), dtype=np.float32)

    def _state(self, position: pyspiel.State, step: int) -> State:
        legal = tuple([tuple(position.legal_actions(p)) for p in self._indices])
        return str(position), step, position.current_player(), legal

    def _after(
        self, state: State, position: pyspiel.State, actions: tuple[Action, ...]
    ) -> list[Found]:
        """What follows a position of this state."""
        step, before, found = state[1] + self.counts_steps, position.returns(), []
        for chance, after in _resolved(_moved(position, actions)):
            over = after.is_terminal() or (self.horizon is not None and step >= self.horizon)
            returns = after.returns()
            gains = self._nothing if returns == before else tuple(map(sub, returns, before))
            found.append((chance, None if over else self._state(after, step), gains, after))
        self._outcomes += len(found)
        return found

    def _meet(
        self, state: State, position: pyspiel.State, origin: tuple[State, tuple[Action, ...]] | None
    ) -> None:
        """Note a position of a state, and compare it with the one that is known.

        Raises:
            ValueError: they go on in different ways.
        """
        known = self._positions.setdefault(state, position)
        if known is position:
            return
        self._met += 1
        if hasattr(self, "observe") and not self._unlike:
            for player in self._indices:
                if known.observation_tensor(player) != position.observation_tensor(player):
                    self._unlike = known.history(), position.history()
        pair, before = (state, known, position), self._outcomes
        move = None
        if self.counts_steps and origin is not None:
            move = hash((origin[0][0], origin[0][2:], origin[1], state[0], state[2:]))
        again = before >= TREE and move in self._compared
        self.sampled = self.sampled or (before >= CHECKED and not again)
        todo: list[Pair] = []
        if again or self.sampled:
            self._play(pair, 1)
        else:
            if move is not None:
                self._compared.add(move)
            todo = self._compare(pair)
        while todo and self._outcomes < min(before + PART, TREE):
            pair = todo.pop()
            if pair[2].move_number() >= self._deepest:
                self.proven = False
            else:
                todo += self._compare(pair)
        self.proven = self.proven and not todo and self._outcomes < TREE
        if not self.proven and self._random.random() < LINES / (LINES + self._met):
            self._play((state, known, position), COUNTED_STEPS)

    def _compare(self, pair: Pair) -> list[Pair]:
        """What follows two positions of a state, which must be the same for every joint action.

        The positions that follow are given only while histories are compared, up to `TREE`.
        """
        state, known, position = pair
        joint = list(_joint(state))
        mine = [self._after(state, position, actions) for actions in joint]
        sign = hash(tuple([outcome[:3] for found in mine for outcome in found]))
        if self._outcomes >= TREE and self._signs.get(state) == sign:
            return []
        pairs = []
        for actions, found in zip(joint, mine, strict=True):
            pairs += self._same(pair, actions, found)
        if self._positions.get(state) is known:
            self._signs[state] = sign
        return pairs if self._outcomes < TREE else []

    def _play(self, pair: Pair, moves: int) -> None:
        """Compare two positions of a state by a random line of so many joint actions."""
        for _ in range(moves):
            state, _, position = pair
            pairs: list[Pair] = []
            for _ in range(DRAWS):
                actions = tuple(self._random.choice(row or (None,)) for row in state[3])
                pairs = self._same(pair, actions, self._after(state, position, actions))
                if pairs:
                    break
            if not pairs or position.move_number() >= self._deepest:
                return
            pair = self._random.choice(pairs)

    def _same(self, pair: Pair, actions: tuple[Action, ...], found: list[Found]) -> list[Pair]:
        """The states that follow two positions with the same actions, with both positions.

        Raises:
            ValueError: something else follows the first than what was found for the second.
        """
        state, known, position = pair
        theirs = self._after(state, known, actions)
        for column, what in enumerate(("probabilities", "next states", "gained returns")):
            one: Any = [row[column] for row in theirs]
            two: Any = [row[column] for row in found]
            if one == two or (column == 2 and np.allclose(one, two, rtol=0.0, atol=1e-9)):
                continue
            if column == 1:  # those that differ; None is the end
                one, two = next([a, b] for a, b in zip(one, two, strict=True) if a != b)
            raise _Different(
                f"{self.spiel}: the histories {known.history()} and {position.history()} lead to "
                f"{str(position)!r}, with the same player to move and legal actions, but go on in "
                f"different ways: the {what} after {actions} are {shortened(one)} and "
                f"{shortened(two)}. {REMEDIES[self.counts_steps]}"
            )
        return [
            (after, self._positions.get(after, first), second)
            for (_, after, _, first), (*_, second) in zip(theirs, found, strict=True)
            if after is not None
        ]


def _joint(state: State) -> Iterable[tuple[Action, ...]]:
    return product(*(row or (None,) for row in state[3]))


def _moved(position: pyspiel.State, actions: tuple[Action, ...]) -> pyspiel.State:
    """The position after these actions, before any move of chance."""
    after = position.clone()
    if after.is_simultaneous_node():
        # Players without actions do not choose, but need a number.
        after.apply_actions([0 if action is None else action for action in actions])
        return after
    action = actions[after.current_player()]
    if action is None:
        raise ValueError(
            f"{position.get_game()}: no player can move in {str(position)!r}, which is no end"
        )
    after.apply_action(action)
    return after


def _resolved(position: pyspiel.State) -> list[tuple[float, pyspiel.State]]:
    """The positions after all moves of chance, with their probabilities."""
    if not position.is_chance_node():
        return [(1.0, position)]
    found = []
    for outcome, chance in position.chance_outcomes():
        found += [(chance * rest, last) for rest, last in _resolved(position.child(outcome))]
        if len(found) > MOST_OUTCOMES:
            raise ValueError(
                f"{position.get_game()}: the moves of chance after {shortened(position.history())} "
                f"have more than {MOST_OUTCOMES:,} outcomes; give a smaller game"
            )
    return found
