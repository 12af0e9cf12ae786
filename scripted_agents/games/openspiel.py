"""Small games in OpenSpiel, and OpenSpiel's games and policies here (`pip install '.[openspiel]'`).

OpenSpiel (Lanctot et al., 2019) has games as trees of limited depth, so a horizon is needed, and no
discount.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import product
from random import Random
from typing import Any

import numpy as np
import pyspiel
from numpy.typing import NDArray

from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from pursuit.validation import whole
from scripted_agents.games.enumeration import SmallGame
from scripted_agents.games.tasks import states_of_games
from scripted_agents.joint.policy import drawn

NAME = "python_pursuit"
ENDED = -1
"""The state after the end of a game."""
COMPARED_MOVES = 20
"""Moves by which two positions of the same text are compared."""


def to_openspiel(game: SmallGame, horizon: int) -> Any:
    """A game in OpenSpiel: simultaneous moves, perfect information, chance nodes, `horizon` steps.

    Actions are indices in the legal actions of a state. For algorithms of games with turns use
    `pyspiel.convert_to_turn_based`.

    Raises:
        ValueError: a horizon below 1.
    """
    whole("horizon", horizon, 1)
    sums = game.rewards.sum(axis=1)
    zero_sum = len(game.players) == 2 and bool(np.abs(sums).max() < 1e-9)
    kinds = pyspiel.GameType
    stochastic = bool((np.diff(game.following.indptr) > 1).any()) or bool(
        (game.start > 0).sum() > 1
    )
    kind = kinds(
        short_name=NAME,
        long_name="A small game of pursuit",
        dynamics=kinds.Dynamics.SIMULTANEOUS,
        chance_mode=kinds.ChanceMode.EXPLICIT_STOCHASTIC
        if stochastic
        else kinds.ChanceMode.DETERMINISTIC,
        information=kinds.Information.PERFECT_INFORMATION,
        utility=kinds.Utility.ZERO_SUM if zero_sum else kinds.Utility.GENERAL_SUM,
        reward_model=kinds.RewardModel.REWARDS,
        max_num_players=len(game.players),
        min_num_players=len(game.players),
        provides_information_state_string=True,
        provides_information_state_tensor=True,
        provides_observation_string=True,
        provides_observation_tensor=True,
        provides_factored_observation_string=False,
        parameter_specification={},
    )
    info = pyspiel.GameInfo(
        num_distinct_actions=max(len(row) for actions in game.actions for row in actions),
        max_chance_outcomes=max(int((game.start > 0).sum()), 1 + game.num_states),
        num_players=len(game.players),
        min_utility=float(min(game.rewards.min() * horizon, 0.0)),
        max_utility=float(max(game.rewards.max() * horizon, 0.0)),
        utility_sum=0.0 if zero_sum else None,
        max_game_length=horizon,
    )
    return _Game(game, horizon, kind, info)


class _Game(pyspiel.Game):
    """A small game as OpenSpiel sees it."""

    def __init__(self, small: SmallGame, horizon: int, kind: Any, info: Any) -> None:
        super().__init__(kind, info, {})
        self.small, self.horizon = small, horizon

    def new_initial_state(self) -> _State:
        """The start: a chance node if there are several start states."""
        return _State(self)

    def make_py_observer(self, kind: Any = None, params: Any = None) -> _Observer:
        """The observer; all players see the same."""
        return _Observer(self.small.num_states)


class _State(pyspiel.State):
    """A state: the number of one of the small game, or a lottery over the next."""

    def __init__(self, game: _Game) -> None:
        super().__init__(game)
        self.small, self.horizon = game.small, game.horizon
        self.step, self.state = 0, ENDED
        starts = np.flatnonzero(self.small.start > 0)
        self.lottery = [(int(s), float(self.small.start[s])) for s in starts]
        self._rewards = np.zeros(len(self.small.players))
        self._returns = np.zeros(len(self.small.players))
        self._resolve()

    def _resolve(self) -> None:
        """Without a choice of chance, go to the only next state."""
        if len(self.lottery) == 1:
            self.state, self.lottery = self.lottery[0][0], []

    def current_player(self) -> Any:
        """Whose turn it is."""
        if self.lottery:
            return pyspiel.PlayerId.CHANCE
        over = self.state == ENDED or self.step >= self.horizon
        return pyspiel.PlayerId.TERMINAL if over else pyspiel.PlayerId.SIMULTANEOUS

    def _legal_actions(self, player: int) -> list[int]:
        return list(range(len(self.small.actions[player][self.state])))

    def chance_outcomes(self) -> list[tuple[int, float]]:
        """Indices in the lottery, with their probabilities."""
        return [(index, chance) for index, (_, chance) in enumerate(self.lottery)]

    def _apply_action(self, action: int) -> None:
        self.state, self.lottery = self.lottery[action][0], []

    def _apply_actions(self, actions: list[int]) -> None:
        joint = 0
        for player, action in enumerate(actions):
            joint = joint * len(self.small.actions[player][self.state]) + action
        joint += int(self.small.begins[self.state])
        self._rewards = self.small.rewards[joint]
        self._returns = self._returns + self._rewards
        row = self.small.following
        some = slice(row.indptr[joint], row.indptr[joint + 1])
        chances = row.data[some].tolist()
        self.lottery = list(zip(row.indices[some].tolist(), chances, strict=True))
        if 1.0 - sum(chances) > 1e-12:
            self.lottery.append((ENDED, 1.0 - sum(chances)))
        self.step += 1
        self._resolve()

    def _action_to_string(self, player: int, action: int) -> str:
        if player == pyspiel.PlayerId.CHANCE:
            return str(self.lottery[action][0])
        return str(self.small.actions[player][self.state][action])

    def is_terminal(self) -> bool:
        """Whether the game is over."""
        return bool(self.current_player() == pyspiel.PlayerId.TERMINAL)

    def rewards(self) -> list[float]:
        """The rewards of the last step."""
        return list(self._rewards)

    def returns(self) -> list[float]:
        """The sum of the rewards so far."""
        return list(self._returns)

    def __str__(self) -> str:
        name = "end" if self.state == ENDED else repr(self.small.states[self.state])
        return f"{'chance after ' if self.lottery else ''}step {self.step}: {name}"


class _Observer:
    """The number of the state as a one-hot vector, and the step as the last number."""

    def __init__(self, states: int) -> None:
        self.tensor = np.zeros(states + 1, np.float32)
        self.dict = {"state": self.tensor}

    def set_from(self, state: _State, player: int) -> None:
        """Write what a player sees."""
        self.tensor.fill(0.0)
        if state.state != ENDED:
            self.tensor[state.state] = 1.0
        self.tensor[-1] = state.step / state.horizon

    def string_from(self, state: _State, player: int) -> str:
        """The state and the step as text."""
        return str(state)


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

    def __init__(self, game: Any, horizon: int | None = None) -> None:
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
        self._positions: dict[Any, Any] = {}
        self._met: Counter[Any] = Counter()
        self._random = Random(0)

    def starts(self) -> list[tuple[float, Any]]:
        """The positions after the first moves of chance."""
        found = _resolved(self.spiel.new_initial_state())
        if any(position.is_terminal() for _, position in found):
            raise ValueError(f"{self.spiel} ends before the first move; give a larger game")
        return [(chance, self._name(position, 0)) for chance, position in found]

    def legal_actions(self, state: Any, player: int) -> list[Any]:
        """The legal actions; None for a player that is not to move."""
        return list(state[3][player]) or [None]

    def transitions(self, state: Any, actions: tuple[Any, ...]) -> list[Any]:
        """The positions after these actions and the moves of chance, with the gained returns."""
        position = self._positions[state]
        step = state[1] + 1 if self.horizon is not None else 0
        outcomes = []
        for chance, after in _resolved(_moved(position, actions)):
            over = after.is_terminal() or (self.horizon is not None and step >= self.horizon)
            name = None if over else self._name(after, step)
            outcomes.append((chance, name, _gained(position, after).tolist(), over))
        return outcomes

    def _name(self, position: Any, step: int) -> tuple[Any, ...]:
        legal = self._legal(position)
        name = (str(position), step, int(position.current_player()), legal)
        known = self._positions.setdefault(name, position)
        if known is not position:
            self._met[name] += 1
            left = COMPARED_MOVES if self.horizon is None else self.horizon - step
            if self._met[name] == 1 and left:
                for actions in product(*(row or (None,) for row in legal)):
                    self._compare(known, position, 1, actions)
            if self._met[name].bit_count() == 1:  # a power of two: often enough, and fast
                self._compare(known, position, min(left, COMPARED_MOVES))
        return name

    def _legal(self, position: Any) -> tuple[tuple[int, ...], ...]:
        return tuple(tuple(position.legal_actions(p)) for p in range(len(self.players)))

    def _compare(self, first: Any, second: Any, moves: int, actions: Any = None) -> None:
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


def _gained(start: Any, end: Any) -> NDArray[np.float64]:
    return np.subtract(end.returns(), start.returns())


def _loaded(game: Any) -> Any:
    """A game of OpenSpiel, by its name or as it is."""
    try:
        loaded = pyspiel.load_game(game) if isinstance(game, str) else game
    except pyspiel.SpielError as error:
        raise ValueError(f"game={game!r}: {str(error).splitlines()[0]}") from None
    if not isinstance(loaded, pyspiel.Game):
        raise ValueError(f"game={game!r}; give a pyspiel.Game, or the name of one")
    return loaded


def _moved(position: Any, actions: Sequence[Any]) -> Any:
    """The position after these actions, before any move of chance."""
    after = position.clone()
    if after.is_simultaneous_node():
        after.apply_actions(list(actions))
    else:
        after.apply_action(actions[after.current_player()])
    return after


def _resolved(position: Any) -> list[tuple[float, Any]]:
    """The positions after all moves of chance, with their probabilities."""
    if not position.is_chance_node():
        return [(1.0, position)]
    return [
        (chance * rest, after)
        for outcome, chance in position.chance_outcomes()
        for rest, after in _resolved(position.child(outcome))
    ]


class OpenSpielPolicy:
    """A policy of OpenSpiel in the seat of an agent.

    Args:
        game: the task as a small game, from `game_of_task`.
        spiel: the same game from `to_openspiel`; its horizon is the `max_steps` of the task.
        policy: with `action_probabilities(state, player)`, as OpenSpiel's `Policy`, for this game;
            one for `pyspiel.convert_to_turn_based` of it is not supported.

    Raises:
        ValueError: from `act` and `distribution`, if the games are not those of the task.
    """

    def __init__(self, game: SmallGame, spiel: Any, policy: Any) -> None:
        self.game, self.spiel, self.policy = game, spiel, policy

    def __repr__(self) -> str:
        return f"OpenSpielPolicy({type(self.policy).__name__})"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, actions drawn with the agent's random numbers."""
        rows = self.distribution(view.task, view.games, view.seat)
        return drawn(view.uniform(), rows.cumsum(axis=1)).astype(np.int32)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, at the steps of these games."""
        rows = np.zeros((len(games.steps), task.num_actions))
        for row, (state, step) in enumerate(
            zip(states_of_games(games), games.steps.tolist(), strict=True)
        ):
            if state not in self.game.number:
                raise ValueError(f"the state {state} is not in the game of {self!r}; use its task")
            number = self.game.number[state]
            for action, chance in self._probabilities(number, step, seat).items():
                played: Any = self.game.actions[seat][number][action]
                rows[row, played] += chance
        return rows

    def _probabilities(self, number: int, step: int, seat: int) -> dict[int, float]:
        position = _State(self.spiel)
        position.state, position.lottery, position.step = number, [], step
        return dict(self.policy.action_probabilities(position, seat))
