"""Games of OpenSpiel as small games: every value against the game tree, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from scripted_agents.games import enumerate_game, equilibrium, respond

pyspiel = pytest.importorskip("pyspiel", exc_type=ImportError)
openspiel = pytest.importorskip("scripted_agents.games.openspiel", exc_type=ImportError)


def matrix_value(payoff: Any) -> float:
    """The value of a matrix game by a linear program."""
    rows, columns = payoff.shape
    found = linprog(
        np.append(np.zeros(rows), -1.0),
        A_ub=np.c_[-payoff.T, np.ones(columns)],
        b_ub=np.zeros(columns),
        A_eq=[[*[1.0] * rows, 0.0]],
        b_eq=[1.0],
        bounds=[(0.0, None)] * rows + [(None, None)],
    )
    return float(-found.fun)


class Tree:
    """The value for the first player after every history, by recursion over the game tree.

    Only positions with equal `same` are computed once; None for every history.
    """

    def __init__(self, same: Any = None) -> None:
        self.same = same or (lambda position: tuple(position.history()))
        self.known: dict[Any, float] = {}
        self.found: list[tuple[int, Any, float]] = []
        """(moves, position, value from there on)"""

    def value(self, position: Any, moves: int = 0) -> float:
        if position.is_terminal():
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
        "cliff_walking(height=2,width=3,horizon=5)",
        "pig(winscore=4,diceoutcomes=3,horizon=6)",
        "oware(num_houses_per_player=2,num_seeds_per_house=1)",
        "go(board_size=2,max_game_length=6)",
        "morpion_solitaire",
    ],
)
def test_positions_of_one_text_that_go_on_in_different_ways_are_refused(name: str) -> None:
    """Steps, repeated positions and earlier lines count in these games, and the text omits them."""
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
    ],
)
def test_what_is_no_small_game_is_refused(game: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        enumerate_game(openspiel.OpenSpielGame(game))
