"""Small games in OpenSpiel: information states, saving and loading, and rewards at the end."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from pursuit.tasks.task import make_task
from scripted_agents.games import SmallGame, enumerate_game, equilibrium, game_of_task

pyspiel = pytest.importorskip("pyspiel", exc_type=ImportError)
openspiel = pytest.importorskip("scripted_agents.games.openspiel", exc_type=ImportError)


@cache
def chase(maze: str = "2x2-tree") -> SmallGame:
    return game_of_task(make_task("chase", maze=maze, rewards="zero_sum"))


class Signals:
    """A start by lot, simultaneous signals, and a guess that pays if it equals the first signal.

    States of the same step have names that differ in nothing but a number of the start.
    """

    players = ("sender", "guesser")

    def starts(self) -> list[Any]:
        return [(0.25, ("start", 0)), (0.75, ("start", 1))]

    def legal_actions(self, state: Any, player: int) -> list[str]:
        return ["a", "b", "c"] if state[0] == "start" or player == 1 else ["wait"]

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        if state[0] == "start":
            matched = float(actions[0] == actions[1])
            return [(1.0, (actions[0], state[1]), (-matched, matched), False)]
        paid = float(actions[1] == state[0]) * (1 + state[1])
        return [(0.5, None, (-paid, paid), True), (0.5, ("start", 1), (0.0, 0.0), False)]


def key_of(position: Any, player: int, form: str) -> Any:
    if form == "string":
        return position.information_state_string(player)
    return tuple(position.information_state_tensor(player))


def sequence_value(game: Any, form: str) -> float:
    """The value for the first player by the linear program over sequences (Koller et al., 1996).

    Von Stengel (1996): x >= 0 are the first player's realisation weights, v the second's values of
    its information sets.
    """
    sequences: list[dict[Any, int]] = [{(): 0}, {(): 0}]
    sets: list[dict[Any, tuple[int, list[int]]]] = [{}, {}]
    payoffs: dict[tuple[int, int], float] = {}

    def walk(position: Any, last: tuple[int, int], chance: float) -> None:
        if position.is_terminal():
            payoffs[last] = payoffs.get(last, 0.0) + chance * position.returns()[0]
        elif position.is_chance_node():
            for outcome, share in position.chance_outcomes():
                walk(position.child(outcome), last, chance * share)
        else:
            player = position.current_player()
            key = key_of(position, player, form)
            legal = position.legal_actions()
            if key not in sets[player]:
                numbers = [
                    sequences[player].setdefault((key, action), len(sequences[player]))
                    for action in legal
                ]
                sets[player][key] = last[player], numbers
            parent, numbers = sets[player][key]
            assert parent == last[player], "the player has forgotten how it came here"
            for action, number in zip(legal, numbers, strict=True):
                after = (number, last[1]) if player == 0 else (last[0], number)
                walk(position.child(action), after, chance)

    walk(game.new_initial_state(), (0, 0), 1.0)
    width, height = (len(sequences[player]) for player in (0, 1))
    count = 1 + len(sets[1])
    payoff = np.zeros((width, height))
    for (row, column), value in payoffs.items():
        payoff[row, column] = value
    constraints = []
    for player in (0, 1):
        matrix = np.zeros((1 + len(sets[player]), len(sequences[player])))
        matrix[0, 0] = 1.0
        for line, (parent, numbers) in enumerate(sets[player].values(), 1):
            matrix[line, parent], matrix[line, numbers] = -1.0, 1.0
        constraints.append(matrix)
    found = linprog(  # variables: x, v; maximise v of the empty sequence
        np.concatenate([np.zeros(width), [-1.0], np.zeros(count - 1)]),
        A_ub=np.hstack([-payoff.T, constraints[1].T]),
        b_ub=np.zeros(height),
        A_eq=np.hstack([constraints[0], np.zeros((len(constraints[0]), count))]),
        b_eq=np.append(1.0, np.zeros(len(sets[0]))),
        bounds=[(0.0, None)] * width + [(None, None)] * count,
    )
    return float(-found.fun)


@pytest.mark.parametrize(
    ("maze", "horizon", "form"),
    [
        ("2x2-tree", 1, "string"),
        ("2x2-tree", 2, "tensor"),
        ("2x2-open", 2, "string"),
        (None, 3, "string"),
        (None, 3, "tensor"),
    ],
)
def test_information_states_have_perfect_recall(maze: Any, horizon: int, form: str) -> None:
    """The linear program needs perfect recall, and its value is that of the stochastic game."""
    game = chase(maze) if maze else enumerate_game(Signals())
    turns = pyspiel.convert_to_turn_based(openspiel.to_openspiel(game, horizon))
    exact = equilibrium(game, 1.0, horizon=horizon).mean
    assert sequence_value(turns, form) == pytest.approx(exact, abs=1e-7)


def test_states_of_one_name_stay_apart() -> None:
    class Coin:
        def __init__(self, side: int) -> None:
            self.side = side

        def __repr__(self) -> str:
            return "a coin"

    class Guess:
        players = ("a", "b")
        coins = (Coin(0), Coin(1))

        def starts(self) -> list[Any]:
            return [(0.5, coin) for coin in self.coins]

        def legal_actions(self, state: Any, player: int) -> list[int]:
            return [0, 1] if player == 0 else [0]

        def transitions(self, state: Any, actions: Any) -> list[Any]:
            right = float(actions[0] == state.side)
            return [(1.0, state, (right, -right), True)]

    game = enumerate_game(Guess())
    turns = pyspiel.convert_to_turn_based(openspiel.to_openspiel(game, 1))
    assert sequence_value(turns, "string") == pytest.approx(1.0)


@pytest.fixture(params=[(False, True), (True, False)])
def exported(request: Any) -> Any:
    turns, terminal = request.param
    game = openspiel.to_openspiel(chase(), 3, terminal_rewards=terminal)
    return pyspiel.convert_to_turn_based(game) if turns else game


def play(game: Any, seed: int) -> Any:
    """A position in the middle of a game."""
    random, position = np.random.default_rng(seed), game.new_initial_state()
    for _ in range(3):
        if position.is_simultaneous_node():
            position.apply_actions([int(random.choice(position.legal_actions(p))) for p in (0, 1)])
        elif not position.is_terminal():
            position.apply_action(int(random.choice(position.legal_actions())))
    return position


def test_games_and_states_are_saved_and_loaded(exported: Any) -> None:
    for game in (
        pickle.loads(pickle.dumps(exported)),
        pyspiel.load_game(str(exported)),
        copy.deepcopy(exported),
    ):
        assert str(game) == str(exported)
        assert game.get_type().reward_model == exported.get_type().reward_model
    for seed in range(5):
        state = play(exported, seed)
        _, loaded = pyspiel.deserialize_game_and_state(
            pyspiel.serialize_game_and_state(exported, state)
        )
        for other in (loaded, copy.deepcopy(state), pickle.loads(pickle.dumps(state))):
            assert other.history() == state.history()
            assert str(other) == str(state)
            assert other.returns() == state.returns()
            assert other.is_terminal() == state.is_terminal()
            for player in (0, 1):
                assert key_of(other, player, "string") == key_of(state, player, "string")
                assert key_of(other, player, "tensor") == key_of(state, player, "tensor")


def test_openspiels_own_test_of_games_passes(exported: Any) -> None:
    pyspiel.random_sim_test(exported, 3, True, False)


def test_another_process_loads_the_game(tmp_path: Any) -> None:
    game = openspiel.to_openspiel(chase(), 2)
    (tmp_path / "state").write_bytes(pickle.dumps(play(game, 0)))
    code = (
        "import pickle, sys, scripted_agents.games.openspiel\n"
        "print(pickle.load(open(sys.argv[1], 'rb')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "state")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == f"{play(game, 0)}\n", done.stderr


def test_terminal_rewards_are_the_returns_at_the_end() -> None:
    """Both games in the same moves; what MCTS and other searches need is a reward at the end."""
    stepwise, at_end = (openspiel.to_openspiel(chase(), 4, terminal) for terminal in (False, True))
    assert at_end.get_type().reward_model == pyspiel.GameType.RewardModel.TERMINAL
    assert stepwise.get_type().reward_model == pyspiel.GameType.RewardModel.REWARDS
    random = np.random.default_rng(0)
    for _ in range(20):
        first, second = stepwise.new_initial_state(), at_end.new_initial_state()
        total = np.zeros(2)
        while not first.is_terminal():
            if first.is_chance_node():
                action = int(random.choice(len(first.chance_outcomes())))
                first.apply_action(action)
                second.apply_action(action)
            else:
                assert second.returns() == second.rewards() == [0.0, 0.0]
                actions = [int(random.choice(first.legal_actions(player))) for player in (0, 1)]
                first.apply_actions(actions)
                second.apply_actions(actions)
                total += first.rewards()
        assert second.is_terminal()
        assert second.rewards() == second.returns() == first.returns() == total.tolist()


def test_mcts_of_openspiel_plays_an_exported_game() -> None:
    """In a process of its own, as the Python part of OpenSpiel closes the streams that pytest reads
    (and the search in C++ crashes on every game in Python)."""
    done = subprocess.run([sys.executable, "-c", MCTS], capture_output=True, text=True, check=False)
    assert done.stdout == "1.0\n", done.stderr


MCTS = """
import numpy as np
import pyspiel
from open_spiel.python.algorithms import mcts
from pursuit.tasks.task import make_task
from scripted_agents.games import game_of_task
from scripted_agents.games.openspiel import to_openspiel

small = game_of_task(make_task("chase", maze="2x2-tree", rewards="zero_sum"))
spiel = to_openspiel(small, 1, terminal_rewards=True)
turns = pyspiel.convert_to_turn_based(spiel)
random = np.random.RandomState(0)
bot = mcts.MCTSBot(turns, 2, 100, mcts.RandomRolloutEvaluator(4, random), random_state=random)
state = turns.new_initial_state()
state.apply_action(0)
while not state.is_terminal():
    state.apply_action(bot.step(state))
print(state.returns()[1])
"""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, 3), "is not enumerated"),
        ((Signals(), 3), "is not enumerated"),
        ((chase, 0), "horizon=0"),
        ((chase, 2.5), "horizon=2.5"),
        ((chase, None), "horizon=None"),
        ((chase, "3"), "horizon='3'"),
        ((chase, 3, "yes"), "terminal_rewards='yes'"),
    ],
)
def test_wrong_arguments_are_refused(arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        game, *others = arguments
        openspiel.to_openspiel(chase() if game is chase else game, *others)


@pytest.mark.parametrize("text", ["", "abc", "UEsDBA", "ä"])
def test_a_text_that_is_no_game_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not the text of a game"):
        pyspiel.load_game("python_pursuit", {"game": text, "horizon": 2})


def test_a_policy_of_information_states_cannot_play_in_a_seat() -> None:
    """States of a simulator have no history."""
    game = chase()
    spiel = openspiel.to_openspiel(game, 3)

    class Remembering:
        def action_probabilities(self, state: Any, player: int) -> dict[int, float]:
            return {len(state.information_state_string(player)): 1.0}

    policy = openspiel.OpenSpielPolicy(game, spiel, Remembering())
    with pytest.raises(ValueError, match="no history"):
        policy._probabilities(0, 1, 0)
