"""Games of OpenSpiel as small games: every value against the game tree, and what is refused."""

from __future__ import annotations

import re
import sys
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matrix_values import matrix_value

from scripted_agents.games import enumerate_game, equilibrium, respond, returns_of

PAGE = Path(__file__).parents[3].joinpath("docs/reference/openspiel_games.txt").read_text("utf-8")
TABLE: dict[str, list[str]] = {
    outcome.removeprefix("refused: "): games.split()
    for outcome, games in re.findall(
        r"^(solved|refused: .+)\n((?:  .+\n)+)", PAGE.replace("  all others\n", ""), re.MULTILINE
    )
}
"""Games by what the file, which docs/guides/own_games.md links, says of them."""

pyspiel = pytest.importorskip("pyspiel", exc_type=ImportError)
openspiel = pytest.importorskip("scripted_agents.games.openspiel", exc_type=ImportError)


class Tree:
    """The value for the first player after every history, by recursion over the game tree.

    Only positions with equal `same` are computed once; None for every history.
    """

    def __init__(self, same: Any = None, horizon: int | None = None) -> None:
        self.horizon = sys.maxsize if horizon is None else horizon
        self.same = same or (lambda position: tuple(position.history()))
        self.known: dict[Any, float] = {}
        self.found: list[tuple[int, Any, float]] = []
        """(moves, position, value from there on)"""

    def value(self, position: Any, moves: int = 0) -> float:
        if position.is_terminal() or (moves >= self.horizon and not position.is_chance_node()):
            return float(position.returns()[0])
        if position.is_chance_node():
            return sum(
                c * self.value(position.child(o), moves) for o, c in position.chance_outcomes()
            )
        key = self.same(position)
        if key not in self.known:
            self.known[key] = self.best(position, moves + 1)
            self.found.append((moves, position, self.known[key] - position.returns()[0]))
        return self.known[key]

    def best(self, position: Any, moves: int) -> float:
        if not position.is_simultaneous_node():
            values = [self.value(position.child(a), moves) for a in position.legal_actions()]
            return max(values) if position.current_player() == 0 else min(values)
        legal = [position.legal_actions(p) for p in range(position.num_players())]
        legal += [[None]] * (2 - len(legal))
        payoff = np.empty(tuple(map(len, legal)))
        for row, column in np.ndindex(payoff.shape):
            after = position.clone()
            after.apply_actions([a for a in (legal[0][row], legal[1][column]) if a is not None])
            payoff[row, column] = self.value(after, moves)
        return matrix_value(payoff)


@pytest.mark.parametrize(
    ("name", "horizon"),
    [
        ("hex(board_size=2,swap=true)", None),
        ("breakthrough(rows=4,columns=2)", None),
        ("clobber(rows=2,columns=4)", None),
        ("nim(pile_sizes=1;2;3)", None),
        ("y(board_size=3)", None),
        ("go(board_size=2,max_game_length=4)", None),
        ("dots_and_boxes(num_rows=1,num_cols=2,utility_margin=true)", None),
        ("catch(rows=4,columns=3)", None),
        ("cliff_walking(height=2,width=3,horizon=5)", 5),
        ("pathfinding(grid=A.a,horizon=4)", 4),
        ("pig(winscore=5,diceoutcomes=2,horizon=6)", 6),
        ("goofspiel(num_cards=3)", None),
        ("oshi_zumo(coins=3,size=1,horizon=4)", 4),
        ("markov_soccer(horizon=3,grid=.OB.\n.A..)", 3),
        ("repeated_game(stage_game=matrix_rps(),num_repetitions=2)", None),
    ],
)
def test_every_value_is_that_of_the_game_tree(name: str, horizon: int | None) -> None:
    game = pyspiel.load_game(name)
    small = enumerate_game(openspiel.OpenSpielGame(game, horizon))
    steps = game.max_game_length()

    def solved(left: int) -> Any:
        if game.num_players() == 1:
            return respond(small, "player_0", {}, 1.0, horizon=left).values
        return equilibrium(small, 1.0, horizon=left).values

    values = solved(steps)
    tree = Tree()
    tree.value(game.new_initial_state())
    reached = set()
    for moves, position, value in tree.found:
        legal = tuple(tuple(position.legal_actions(p)) for p in range(game.num_players()))
        step = 0 if horizon is None else moves
        state = small.number[str(position), step, int(position.current_player()), legal]
        assert values[state] == pytest.approx(value, abs=1e-7), position.history()
        reached.add(state)
    assert len(reached) == small.num_states


def test_dots_and_boxes_has_the_values_of_the_game_tree() -> None:
    """The second box of a side gives another turn, which the text does not show."""
    game = pyspiel.load_game("dots_and_boxes")
    small = enumerate_game(openspiel.OpenSpielGame(game))
    values = equilibrium(small, 1.0, horizon=12).values
    tree = Tree(lambda p: (frozenset(p.history()), p.current_player(), str(p)))
    tree.value(game.new_initial_state())
    assert len(tree.found) == small.num_states
    by_turn = {state[:3]: values[number] for state, number in small.number.items()}  # type: ignore[index]
    for _, position, value in tree.found:
        assert by_turn[str(position), 0, position.current_player()] == value


@pytest.mark.parametrize(
    "name",
    [
        "pathfinding(grid=A.b\na.B,horizon=4,players=2)",
        "oware(num_houses_per_player=2,num_seeds_per_house=1)",
        "go(board_size=2,max_game_length=6)",
        "morpion_solitaire",
    ],
)
def test_positions_of_one_text_that_go_on_in_different_ways_are_refused(name: str) -> None:
    """Earlier moves and lines and repeated positions count in these games, but do not show."""
    with pytest.raises(ValueError, match="go on in different ways"):
        enumerate_game(openspiel.OpenSpielGame(name), most_states=20_000)


@pytest.mark.parametrize(
    ("game", "message"),
    [
        (None, "give a pyspiel.Game"),
        (7, "give a pyspiel.Game"),
        (["tic_tac_toe"], "give a pyspiel.Game"),
        ("no_game", "Unknown game 'no_game'"),
        ("nim(piles=3)", "Unknown parameter 'piles'"),
        ("kuhn_poker", "hidden information"),
        ("mfg_garnet", "mean field"),
        ("stones_and_gems", "chance outcomes"),
        ("checkers(rows=4,columns=4)", "ends before the first move"),
        ("hex(board_size=1)", "Cannot choose"),
        ("hex (board_size=2)", "Unknown game 'hex '"),
        ("nim(", "Missing closing bracket"),
        ("misere", "Missing parameter game"),
        ("nim(pile_sizes=x)", "game='nim"),
        ("tic_tac_toe(horizon=0)", "horizon=0"),
        ("tic_tac_toe(horizon=x)", "horizon='x'"),
        ("connect_four(rows=0)", "ends the process"),
        ("backgammon(scoring_type=x)", "game='backgammon"),
    ],
)
def test_what_is_no_small_game_is_refused(game: Any, message: str, capfd: Any) -> None:
    with pytest.raises(ValueError, match=message):
        enumerate_game(openspiel.OpenSpielGame(game))
    assert capfd.readouterr().err == ""


class Histories:
    """Over all histories of a game, with uniform policies: the returns from every state on.

    Args:
        game: an OpenSpiel game.
        horizon: moves after which it ends.
        counted: whether moves are a part of the states.
    """

    def __init__(self, game: Any, horizon: int | None, counted: bool) -> None:
        self.players, self.counted = range(game.num_players()), counted
        self.horizon = sys.maxsize if horizon is None else horizon
        self.found: list[tuple[Any, Any, np.ndarray[Any, Any]]] = []
        """(history, state, returns from there on)"""
        self.start = self.returns(game.new_initial_state(), 0)

    def returns(self, position: Any, moves: int) -> np.ndarray[Any, Any]:
        now = np.array(position.returns())
        if position.is_chance_node():
            chances = position.chance_outcomes()
            return np.sum([c * self.returns(position.child(o), moves) for o, c in chances], axis=0)
        if position.is_terminal() or moves >= self.horizon:
            return now
        legal = tuple(tuple(position.legal_actions(p)) for p in self.players)
        following = []
        for actions in product(*(row or (0,) for row in legal)):
            after = position.clone()
            if position.is_simultaneous_node():
                after.apply_actions(actions)
            else:
                after.apply_action(actions[position.current_player()])
            following.append(self.returns(after, moves + 1))
        mean = np.mean(following, axis=0)
        key = str(position), moves * self.counted, int(position.current_player()), legal
        self.found.append((position.history(), key, mean - now))
        return np.asarray(mean)


@pytest.mark.parametrize("text", TABLE["solved"])
def test_loadable_games_are_solved_right(text: str) -> None:
    """Returns from every history on; the value of the start where there is one."""
    game = openspiel.openspiel_game(text)
    small = enumerate_game(game, most_states=3000)
    steps = game.horizon or 50  # max_game_length of hex with a swap is one move short
    uniform = {
        name: lambda state, index=index: np.full(n := max(len(state[3][index]), 1), 1.0 / n)
        for index, name in enumerate(game.players)
    }
    returns = returns_of(small, uniform, 1.0, horizon=steps)
    histories = Histories(game.spiel, game.horizon, game.counts_steps)
    for history, state, expected in histories.found:
        assert returns[small.number[state]] == pytest.approx(expected, abs=1e-8), history
    assert len({state for _, state, _ in histories.found}) == small.num_states
    assert small.start @ returns == pytest.approx(histories.start, abs=1e-8)
    if len(game.players) == 1 or np.abs(small.rewards.sum(axis=1)).max() > 1e-9:
        return
    if len(game.players) == 2:
        value = Tree(horizon=game.horizon).value(game.spiel.new_initial_state())
        assert equilibrium(small, 1.0, horizon=steps).mean == pytest.approx(value, abs=1e-7)


def test_the_page_names_every_loadable_game() -> None:
    kinds = {g.short_name: g for g in pyspiel.registered_games() if g.default_loadable}
    hidden = pyspiel.GameType.Information.IMPERFECT_INFORMATION
    seen = [text.split("(")[0] for games in TABLE.values() for text in games]
    assert sorted(seen) == sorted(n for n, g in kinds.items() if g.information != hidden)
    for name, kind in kinds.items():
        if kind.information == hidden:
            with pytest.raises(ValueError, match=f"{name} has hidden information"):
                openspiel.openspiel_game(name)


@pytest.mark.parametrize(
    ("text", "message"),
    [(text, outcome) for outcome in TABLE if outcome != "solved" for text in TABLE[outcome]],
)
def test_loadable_games_are_refused_with_the_reason_on_the_page(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        enumerate_game(openspiel.openspiel_game(text), most_states=3000)
    assert text.split("(")[0] in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({text.split("(")[0] for text in TABLE["solved"]}))
def test_games_of_the_usual_size_are_enumerated_or_refused(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = sys.modules["scripted_agents.games.openspiel_games"]
    monkeypatch.setattr(module, "TREE", 500)
    monkeypatch.setattr(module, "CHECKED", 500)
    try:
        small = enumerate_game(openspiel.openspiel_game(name), most_states=50)
    except ValueError as error:
        assert re.search(r"more than 50 states|go on in different ways", str(error))
    else:
        assert small.num_states <= 50


@pytest.mark.parametrize(
    ("text", "counted"),
    [
        ("markov_soccer(horizon=20)", True),
        ("markov_soccer", False),
        ("cliff_walking", True),
        ("pig(winscore=10)", False),
        ("tic_tac_toe(horizon=3)", True),
        ("tic_tac_toe", False),
    ],
)
def test_steps_are_counted_where_a_limit_is_near(text: str, counted: bool) -> None:
    assert openspiel.openspiel_game(text).counts_steps is counted


class Recall(pyspiel.Game):  # type: ignore[misc]
    """Two moves, then `WAIT` moves without effect, then the first move pays; the text hides it."""

    WAIT = 0

    def __init__(self, params: Any = None) -> None:
        super().__init__(
            KIND, pyspiel.GameInfo(2, 0, 1, 0.0, 1.0, 0.0, self.WAIT + 2), params or {}
        )

    def new_initial_state(self) -> Any:
        return RecallState(self)


class RecallState(pyspiel.State):  # type: ignore[misc]
    def __init__(self, game: Any) -> None:
        super().__init__(game)
        self.moves: list[int] = []

    def current_player(self) -> int:
        return int(pyspiel.PlayerId.TERMINAL) if self.is_terminal() else 0

    def _legal_actions(self, player: int) -> list[int]:
        return [0, 1]

    def _apply_action(self, action: int) -> None:
        self.moves.append(action)

    def is_terminal(self) -> bool:
        return len(self.moves) == Recall.WAIT + 2

    def returns(self) -> list[float]:
        return [float(self.is_terminal() and self.moves[0])]

    def __str__(self) -> str:
        return f"move {len(self.moves)}"


KIND = pyspiel.GameType(
    "recall", "recall", pyspiel.GameType.Dynamics.SEQUENTIAL,
    pyspiel.GameType.ChanceMode.DETERMINISTIC, pyspiel.GameType.Information.PERFECT_INFORMATION,
    pyspiel.GameType.Utility.GENERAL_SUM, pyspiel.GameType.RewardModel.TERMINAL,
    1, 1, False, False, False, False, {},
)  # fmt: skip


@pytest.mark.parametrize("wait", [0, 1, 5])
def test_what_shows_only_later_is_found(wait: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Recall, "WAIT", wait)
    with pytest.raises(ValueError, match="go on in different ways: the gained returns"):
        enumerate_game(openspiel.OpenSpielGame(Recall()))


def test_steps_are_counted_where_positions_differ_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Recall, "WAIT", 3)
    monkeypatch.setattr(RecallState, "__str__", lambda state: "")
    monkeypatch.setattr(RecallState, "returns", lambda state: [float(state.is_terminal())])
    game = openspiel.OpenSpielGame(Recall())
    assert game.counts_steps
    small = enumerate_game(game)
    assert small.num_states == 5
    assert respond(small, "player_0", {}, 1.0, horizon=9).mean == 1.0


def test_what_was_compared_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    module = sys.modules["scripted_agents.games.openspiel_games"]
    small, large = (openspiel.openspiel_game(f"hex(board_size={size})") for size in (2, 3))
    enumerate_game(small)
    assert small.proven
    monkeypatch.setattr(module, "TREE", 1000)
    monkeypatch.setattr(module, "CHECKED", 5000)
    enumerate_game(large)
    assert large.sampled
    assert not large.proven


def test_observations_and_text_are_those_of_openspiel() -> None:
    game = openspiel.openspiel_game("breakthrough(rows=4,columns=2)")
    small = enumerate_game(game)
    position = game.spiel.new_initial_state()
    while not position.is_terminal():
        legal = tuple(tuple(position.legal_actions(p)) for p in range(2))
        state = str(position), 0, position.current_player(), legal
        assert state in small.number
        assert game.draw(state) == str(position)
        for player in range(2):
            seen = game.observe(state, player)
            assert seen.dtype == np.float32
            assert seen.tolist() == position.observation_tensor(player)
        position = position.child(position.legal_actions()[-1])


def test_a_tensor_that_is_no_function_of_the_state_is_refused() -> None:
    """That of dots_and_boxes shows which player made a box, on which nothing depends."""
    game = openspiel.openspiel_game("dots_and_boxes(num_rows=1,num_cols=1)")
    small = enumerate_game(game)
    with pytest.raises(ValueError, match="other observation tensors after"):
        game.observe(small.states[0], 0)
    assert not hasattr(openspiel.OpenSpielGame(Recall()), "observe")
