"""Small games in OpenSpiel, and OpenSpiel's games and policies here (`pip install '.[openspiel]'`).

OpenSpiel (Lanctot et al., 2019) has games as trees of limited depth, so a horizon is needed, and no
discount. An exported game is registered as "python_pursuit"; its parameters hold the whole game, so
that OpenSpiel can save and load games and states wherever this module is imported.
"""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from io import BytesIO
from math import prod
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np
import pyspiel
from numpy.typing import NDArray

from pursuit.memory import check_memory
from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from pursuit.validation import Plain, check_bool, shortened, text_of, whole
from scripted_agents.exact.joint.policy import drawn
from scripted_agents.games.game import Action
from scripted_agents.games.openspiel_games import OpenSpielGame as OpenSpielGame
from scripted_agents.games.openspiel_optional import openspiel_game as openspiel_game
from scripted_agents.games.small_game import ENDED, SmallGame, check_game
from scripted_agents.games.tasks import states_of_games

NAME = "python_pursuit"
PARAMETERS = {"game": "", "horizon": 1, "terminal_rewards": False}
ARRAYS, ROWS = ("begins", "choices", "rewards", "start"), ("data", "indices", "indptr")
"""The arrays of a game, and of its `following`."""


def to_openspiel(game: SmallGame, horizon: int, terminal_rewards: bool = False) -> pyspiel.Game:
    """A game in OpenSpiel: simultaneous moves, perfect information, chance nodes, `horizon` steps.

    Actions are indices in the legal actions of a state. For algorithms of games with turns use
    `pyspiel.convert_to_turn_based`. Information states hold the states that the player has seen and
    its own actions (perfect recall); observations the present state only.

    Args:
        game: from `enumerate_game` or `game_of_task`.
        horizon: number of steps, at least 1.
        terminal_rewards: pay all rewards at the end, as MCTS needs it; returns stay the same.

    Raises:
        ValueError: another kind of game, a horizon below 1, or `terminal_rewards` that is no bool.
    """
    check_game(game)
    return _Game({"game": _text(game), "horizon": horizon, "terminal_rewards": terminal_rewards})


def _text(game: SmallGame) -> str:
    """A game as text, with its states and actions by their names."""
    states = [text_of(state, repr) for state in game.states]
    if len(set(states)) < len(states):  # information states hold these names
        states = [f"{number}: {state}" for number, state in enumerate(states)]
    names = {
        "players": game.players,
        "states": states,
        "actions": [[[text_of(a) for a in row] for row in rows] for rows in game.actions],
    }
    arrays = {name: getattr(game, name) for name in ARRAYS}
    rows = {name: getattr(game.following, name) for name in ROWS}
    file, text = BytesIO(), np.frombuffer(json.dumps(names).encode(), np.uint8)
    np.savez_compressed(file, names=text, **arrays, **rows)
    return b64encode(file.getvalue(), b"-_").decode().rstrip("=")


def _small(text: str) -> SmallGame:
    """The game of a text; ValueError if it is none."""
    from scipy.sparse import csr_array  # slow to import

    try:
        with np.load(BytesIO(b64decode(text + "=" * (-len(text) % 4), b"-_"))) as file:
            data = dict(file)
        names = json.loads(data["names"].tobytes())
        shape = (len(data["choices"]), len(data["start"]))
        return SmallGame(
            tuple(names["players"]),
            names["states"],
            {state: number for number, state in enumerate(names["states"])},
            names["actions"],
            following=csr_array(tuple(data[name] for name in ROWS), shape=shape),
            **{name: data[name] for name in ARRAYS},
        )
    except (ValueError, KeyError, TypeError, OSError, EOFError, BadZipFile):
        raise ValueError(
            f"game={shortened(text)} is not the text of a game; take the parameters from "
            "to_openspiel(...).get_parameters()"
        ) from None


class _Tree(NamedTuple):
    """A small game to a horizon. It never changes, so a deep copy of a state keeps it."""

    small: SmallGame
    horizon: int
    terminal_rewards: bool


class _Game(pyspiel.Game):
    """A small game as OpenSpiel sees it."""

    def __init__(self, params: Plain | None = None) -> None:
        given = {**PARAMETERS, **(params or {})}
        horizon = given["horizon"] = whole("horizon", given["horizon"], 1)
        terminal = check_bool("terminal_rewards", given["terminal_rewards"])
        given["terminal_rewards"] = terminal
        self.tree = _Tree(_small(given["game"]), horizon, terminal)
        small = self.tree.small
        starts = int((small.start > 0).sum())
        stochastic = starts > 1 or bool((np.diff(small.following.indptr) > 1).any())
        kind = _type(len(small.players), stochastic, small.zero_sum, terminal)
        info = pyspiel.GameInfo(
            num_distinct_actions=max(len(row) for actions in small.actions for row in actions),
            max_chance_outcomes=max(starts, 1 + small.num_states),
            num_players=len(small.players),
            min_utility=float(min(small.rewards.min() * horizon, 0.0)),
            max_utility=float(max(small.rewards.max() * horizon, 0.0)),
            utility_sum=0.0 if small.zero_sum else None,
            max_game_length=horizon,
        )
        super().__init__(kind, info, given)

    def new_initial_state(self) -> _State:
        """The start: a chance node if there are several start states."""
        return _State(self, self.tree)

    def make_py_observer(self, kind: Any = None, params: Any = None) -> _Observer:
        """The observer of information states (perfect recall) or of observations."""
        return _Observer(
            self.tree, self.num_distinct_actions(), kind is not None and kind.perfect_recall
        )


def _type(
    players: int, stochastic: bool, zero_sum: bool, terminal_rewards: bool
) -> pyspiel.GameType:
    kinds = pyspiel.GameType
    chance, utility, rewards = kinds.ChanceMode, kinds.Utility, kinds.RewardModel
    return kinds(
        short_name=NAME,
        long_name="A small game of pursuit",
        dynamics=kinds.Dynamics.SIMULTANEOUS,
        chance_mode=chance.EXPLICIT_STOCHASTIC if stochastic else chance.DETERMINISTIC,
        information=kinds.Information.PERFECT_INFORMATION,
        utility=utility.ZERO_SUM if zero_sum else utility.GENERAL_SUM,
        reward_model=rewards.TERMINAL if terminal_rewards else rewards.REWARDS,
        max_num_players=players,
        min_num_players=players,
        provides_information_state_string=True,
        provides_information_state_tensor=True,
        provides_observation_string=True,
        provides_observation_tensor=True,
        provides_factored_observation_string=False,
        parameter_specification=PARAMETERS,
        default_loadable=False,
    )


class _State(pyspiel.State):
    """A state: the number of one of the small game, or a lottery over the next."""

    def __init__(self, game: _Game, tree: _Tree) -> None:
        super().__init__(game)
        self.tree, small = tree, tree.small
        self.step, self.state = 0, ENDED
        self.past: tuple[tuple[int, tuple[int, ...]], ...] = ()
        """The state and the joint action of every step so far."""
        starts = np.flatnonzero(small.start > 0)
        self.lottery = [(int(s), float(small.start[s])) for s in starts]
        self._rewards = np.zeros(len(small.players))
        self._returns = np.zeros(len(small.players))
        self._resolve()

    def _resolve(self) -> None:
        """Without a choice of chance, go to the only next state."""
        if len(self.lottery) == 1:
            self.state, self.lottery = self.lottery[0][0], []

    def current_player(self) -> pyspiel.PlayerId:
        """Whose turn it is."""
        if self.lottery:
            return pyspiel.PlayerId.CHANCE
        over = self.state == ENDED or self.step >= self.tree.horizon
        return pyspiel.PlayerId.TERMINAL if over else pyspiel.PlayerId.SIMULTANEOUS

    def _legal_actions(self, player: int) -> list[int]:
        return list(range(len(self.tree.small.actions[player][self.state])))

    def chance_outcomes(self) -> list[tuple[int, float]]:
        """Indices in the lottery, with their probabilities."""
        return [(index, chance) for index, (_, chance) in enumerate(self.lottery)]

    def _apply_action(self, action: int) -> None:
        self.state, self.lottery = self.lottery[action][0], []

    def _apply_actions(self, actions: list[int]) -> None:
        small = self.tree.small
        joint = small.joint_action(self.state, actions)
        self._rewards = small.rewards[joint]
        self._returns = self._returns + self._rewards
        states, chances = small.outcomes(joint)
        self.lottery = list(zip(states.tolist(), chances.tolist(), strict=True))
        ends = 1.0 - sum(chances.tolist())
        if ends > 1e-12:
            self.lottery.append((ENDED, ends))
        self.past += ((self.state, tuple(map(int, actions))),)
        self.step += 1
        self._resolve()

    def _action_to_string(self, player: int, action: int) -> str:
        if player == pyspiel.PlayerId.CHANCE:
            return str(self.lottery[action][0])
        return str(self.tree.small.actions[player][self.state][action])

    def is_terminal(self) -> bool:
        """Whether the game is over."""
        return bool(self.current_player() == pyspiel.PlayerId.TERMINAL)

    def rewards(self) -> list[float]:
        """The rewards of the last step; with terminal rewards those of all steps, at the end."""
        return self.returns() if self.tree.terminal_rewards else list(self._rewards)

    def returns(self) -> list[float]:
        """The sum of the rewards so far; with terminal rewards 0 until the end."""
        paid = not self.tree.terminal_rewards or self.is_terminal()
        return list(self._returns * paid)

    def __str__(self) -> str:
        name = "end" if self.state == ENDED else self.tree.small.states[self.state]
        return f"{'chance after ' if self.lottery else ''}step {self.step}: {name}"


class _Observer:
    """What a player sees: the state and the step.

    With perfect recall also the player, and the states and its own actions of all earlier steps.
    The tensor holds one-hot vectors of them (zeros for what has not happened yet), and the step
    divided by the horizon.
    """

    def __init__(self, tree: _Tree, actions: int, perfect_recall: bool) -> None:
        players, states, steps = len(tree.small.players), tree.small.num_states, tree.horizon
        self.perfect_recall = perfect_recall
        shapes: dict[str, tuple[int, ...]] = {"state": (states,)}
        if perfect_recall:
            shapes = {"player": (players,), "states": (steps + 1, states)}
            shapes["actions"] = (steps, actions)
        shapes["step"] = (1,)
        size = sum(map(prod, shapes.values()))
        check_memory("an information state", 4 * size, "give a shorter horizon")
        self.tensor = np.zeros(size, np.float32)
        parts = np.split(self.tensor, np.cumsum([prod(shape) for shape in shapes.values()])[:-1])
        self.dict = {
            name: part.reshape(shape)
            for (name, shape), part in zip(shapes.items(), parts, strict=True)
        }

    def set_from(self, state: _State, player: int) -> None:
        """Write what a player sees."""
        self.tensor.fill(0.0)
        self.dict["step"][0] = state.step / state.tree.horizon
        if not self.perfect_recall:
            self.dict["state"][state.state] = state.state != ENDED
            return
        self.dict["player"][player] = 1.0
        for step, (seen, actions) in enumerate(_past(state)):
            self.dict["states"][step, seen] = self.dict["actions"][step, actions[player]] = 1.0
        if not state.lottery and state.state != ENDED:
            self.dict["states"][state.step, state.state] = 1.0

    def string_from(self, state: _State, player: int) -> str:
        """What a player sees, as text."""
        if not self.perfect_recall:
            return str(state)
        names = state.tree.small.states
        past = [f"{names[seen]} action {actions[player]}" for seen, actions in _past(state)]
        return "; ".join([f"player {player}", *past, str(state)])


def _past(state: _State) -> tuple[tuple[int, tuple[int, ...]], ...]:
    if len(state.past) < state.step:
        raise ValueError(
            f"{state} has no history, so it has no information state; give OpenSpielPolicy a "
            "policy of the legal actions and observations of a state"
        )
    return state.past


pyspiel.register_game(_type(2, True, False, False), _Game)


class OpenSpielPolicy:
    """A policy of OpenSpiel in the seat of an agent.

    Args:
        game: the task as a small game, from `game_of_task`.
        spiel: the same game from `to_openspiel`; its horizon is the `max_steps` of the task.
        policy: with `action_probabilities(state, player)`, as OpenSpiel's `Policy`, for this game.
            The states it gets have no history, so it must decide by their observations; one for
            `pyspiel.convert_to_turn_based` of the game is not supported.

    Raises:
        ValueError: from `act` and `distribution`, if the games are not those of the task.
    """

    def __init__(self, game: SmallGame, spiel: pyspiel.Game, policy: Any) -> None:
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
                played: Action = self.game.actions[seat][number][action]
                rows[row, played] += chance
        return rows

    def _probabilities(self, number: int, step: int, seat: int) -> dict[int, float]:
        position = self.spiel.new_initial_state()
        position.state, position.lottery, position.step = number, [], step
        return dict(self.policy.action_probabilities(position, seat))
