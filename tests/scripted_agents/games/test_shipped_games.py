"""The shipped games: their rules against other implementations, known values, the page's table."""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from itertools import product
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from diagonals import diagonal
from matrix_values import matrix_value

from scripted_agents.games import (
    Game,
    SmallGame,
    enumerate_game,
    equilibrium,
    load_game,
    nash_conv,
    respond,
    returns_of,
)
from scripted_agents.games.agents import uniform_table
from scripted_agents.games.library import SHIPPED
from scripted_agents.games.library.border_control import BorderControl
from scripted_agents.games.library.goofspiel import Goofspiel
from scripted_agents.games.library.oshi_zumo import oshi_zumo
from scripted_agents.games.library.rock_paper_scissors import RockPaperScissors
from scripted_agents.games.library.soccer import Soccer
from scripted_agents.games.named import game_named

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "environments" / "small_games.md"
OURS = (BorderControl, Goofspiel, RockPaperScissors, Soccer)


def made(text: str) -> Any:
    """The game of a name with arguments, such as goofspiel(cards=4)."""
    name, _, arguments = text.partition("(")
    module, _, maker = SHIPPED[name].partition(":")
    return eval(f"make({arguments or ')'}", {"make": getattr(import_module(module), maker)})


@cache
def enumerated(text: str) -> SmallGame:
    game = made(text)
    return game if isinstance(game, SmallGame) else enumerate_game(game, progress=False)


def uniform(game: SmallGame) -> dict[str, Any]:
    return {name: uniform_table(game, name) for name in game.players}


# -- all games -------------------------------------------------------------------------------------


def names_in_results() -> set[str]:
    """The names of games in the rows of the results."""
    found: set[str] = set()
    for path in sorted((ROOT / "docs" / "results" / "data").rglob("*.csv")):
        with path.open(newline="", encoding="utf-8") as lines:
            found |= {row.get("game") or "" for row in csv.DictReader(lines)}
    return found - {""}


@pytest.mark.parametrize("text", sorted(names_in_results()))
def test_games_of_the_results_are_loaded_by_their_names(text: str) -> None:
    if text.startswith("oshi_zumo"):
        pytest.importorskip("pyspiel", exc_type=ImportError)
    assert isinstance(game_named(text), Game | SmallGame)


@pytest.mark.parametrize(
    "text",
    [
        "soccer(rows=4).x(columns=4)",
        "soccer(rows=4)(columns=4)",
        "soccer(rows=4)[0]",
        "soccer(rows=4) + 1",
        "soccer(rows=4) # tall",
        "soccer(rows=4",
        "soccer(4)",
        "soccer(*[4])",
        "soccer(**{'rows': 4})",
        "soccer(rows=4, rows=4)",
        "soccer(rows=2 * 2)",
        "soccer(rows=len('four'))",
        "soccer(rows=goofspiel(cards=3))",
        "soccer(rows=4 if 1 else 5)",
        "soccer(rows:=4)",
        f"soccer(rows={'-' * 3000}4)",
        f"soccer(rows={'(' * 3000}4{')' * 3000})",
        f"soccer(rows={'[' * 3000}4{']' * 3000})",
        "soccer(rows=4\0)",
        "soccer soccer",
        "(rows=4)",
    ],
)
def test_a_name_is_one_call_with_keywords(text: str) -> None:
    with pytest.raises(ValueError, match=r"game=.*; give (arguments as name=value|a name)") as told:
        load_game(text)
    assert len(str(told.value)) < 400


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_name_is_a_game(name: str) -> None:
    if name == "oshi_zumo":
        pytest.importorskip("pyspiel", exc_type=ImportError)
    assert isinstance(made(name), Game | SmallGame)


@pytest.mark.parametrize("make", OURS)
def test_observations_tell_all_states_apart(make: Callable[[], Any]) -> None:
    game: Any = make() if make is not BorderControl else BorderControl(rows=3, columns=4)
    states = enumerate_game(game, progress=False).states
    for player in (0, 1):
        seen = np.array([game.observe(state, player) for state in states])
        assert seen.dtype == np.float32 and np.abs(seen).max() == 1.0
        assert len(np.unique(seen, axis=0)) == len(states)
    assert len({game.draw(state) for state in states}) == len(states)


ROWS = [
    [cell.strip(" `") for cell in line.strip("|").split("|")]
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line.startswith("| `") and line.count("|") == 10
]


def test_the_table_of_the_page_has_every_game() -> None:
    assert {row[0].partition("(")[0] for row in ROWS} == set(SHIPPED)


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, id=row[0], marks=[pytest.mark.slow] if float(row[4]) > 2.0 else [])
        for row in ROWS
    ],
)
def test_the_table_of_the_page_is_computed(row: list[str]) -> None:
    if row[0].startswith("oshi_zumo"):
        pytest.importorskip("pyspiel", exc_type=ImportError)
    text, players, states, joint, _, discount, horizon, value, mixed = row
    game = enumerated(text)
    solution = equilibrium(game, float(discount), None if horizon == "none" else int(horizon))
    assert players == ", ".join(game.players)
    assert states == f"{game.num_states:,}" and joint == f"{len(game.choices):,}"
    assert value == f"{round(solution.mean, 4) + 0.0:.4g}"
    assert mixed == f"{solution.mixed.mean():.1%}".replace("%", " %")


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: RockPaperScissors(memory=1), "memory=1"),
        (lambda: RockPaperScissors(rock_win=0.0), "above 0"),
        (lambda: RockPaperScissors(rock_win=float("nan")), "finite"),
        (lambda: RockPaperScissors(rock_win="2"), "rock_win='2'"),
        (lambda: Soccer(rows=1), "rows=1; it is at least 2"),
        (lambda: Soccer(columns=3), "columns=3; it is at least 4"),
        (lambda: Soccer(columns=1000), "at most 10"),
        (lambda: Soccer(rows=4.0), "rows=4.0"),
        (lambda: Goofspiel(cards=1), "at least 2"),
        (lambda: Goofspiel(cards=True), "cards=True"),
        (lambda: Goofspiel(cards=8), "at most 7 in random order"),
        (lambda: Goofspiel(cards=11, order="ascending"), "at most 10"),
        (lambda: Goofspiel(order="shuffled"), "random, descending, ascending"),
        (lambda: Goofspiel(points="total"), "difference, win"),
        (lambda: oshi_zumo(coins=0), "coins=0; it is at least 1"),
        (lambda: oshi_zumo(min_bid=2), "at most 1"),
        (lambda: BorderControl(columns=2), "at least 3"),
        (lambda: BorderControl(rows=9), "at most 8"),
    ],
)
def test_wrong_arguments_are_refused(make: Callable[[], Any], named: str) -> None:
    with pytest.raises(ValueError, match=re.escape(named)):
        make()


# -- rock-paper-scissors ---------------------------------------------------------------------------


@pytest.mark.parametrize("rock_win", [1.0, 2.5])
def test_the_equilibrium_of_rock_paper_scissors_is_the_closed_form(rock_win: float) -> None:
    game = enumerate_game(RockPaperScissors(rock_win=rock_win))
    assert game.num_states == 10
    solution = equilibrium(game, 0.9)
    row = np.array([1.0, rock_win, 1.0]) / (2.0 + rock_win)
    np.testing.assert_allclose(solution.values, 0.0, atol=1e-9)
    for player in game.players:
        np.testing.assert_allclose(solution.policies[player], np.tile(row, 10), atol=1e-9)
    conv = nash_conv(game, uniform(game), 0.9).nash_conv
    # Against uniform play, paper or rock: the better of 0 and (rock_win - 1) / 3 in every round.
    assert conv == pytest.approx(2 * (rock_win - 1) / 3 / (1 - 0.9), abs=1e-9)


def test_who_wins_a_round() -> None:
    game, beats = RockPaperScissors(rock_win=3.0), {"rock": "scissors", "paper": "rock"}
    beats["scissors"] = "paper"
    for first, second in product(beats, beats):
        won = (beats[first] == second) * (3.0 if first == "rock" else 1.0)
        lost = (beats[second] == first) * (3.0 if second == "rock" else 1.0)
        ((_, after, rewards, ended),) = game.transitions(None, (first, second))
        assert (after, rewards, ended) == ((first, second), (won - lost, lost - won), False)
    assert enumerate_game(RockPaperScissors(memory=False)).num_states == 1


# -- soccer ----------------------------------------------------------------------------------------


def test_soccer_is_that_of_openspiel_in_all_states_with_the_ball_held() -> None:
    """There A attacks east, and the ball lies on the grid at first: the rest is the same."""
    pyspiel = pytest.importorskip("pyspiel", exc_type=ImportError)
    words = ("north", "south", "east", "west", "stand")  # of OpenSpiel's actions, mirrored

    def mirrored(position: Any) -> Any:
        """Our state; None while nobody has the ball."""
        lines = [line[::-1] for line in str(position).split("\n")[:4]]
        found = {c: (i, line.index(c)) for i, line in enumerate(lines) for c in "abAB" if c in line}
        if "a" in found and "b" in found:
            return None
        ball = 0 if "A" in found else 1
        return (found["Aa"[ball]], found["bB"[ball]], ball)

    game, start = Soccer(), pyspiel.load_game("markov_soccer").new_initial_state()
    todo, seen = [start.child(outcome) for outcome, _ in start.chance_outcomes()], set()
    compared = set()
    while todo:
        position = todo.pop()
        if str(position) in seen:
            continue
        seen.add(str(position))
        state = mirrored(position)
        for actions in product(range(5), range(5)):
            moved = position.clone()
            moved.apply_actions(list(actions))
            after = [moved.child(first) for first in (0, 1)]
            todo += [each for each in after if not each.is_terminal()]
            if state is not None:
                chosen = (words[actions[0]], words[actions[1]])
                for known, outcome in zip(after, game.transitions(state, chosen), strict=True):
                    chance, new, rewards, ended = outcome
                    assert (chance, list(rewards)) == (0.5, known.returns())
                    assert ended == known.is_terminal()
                    assert ended or new == mirrored(known)
        compared.add(state)
    assert compared - {None} == set(enumerated("soccer").states)


def test_values_of_soccer_change_sign_when_the_players_change_places() -> None:
    game = enumerated("soccer")
    values = equilibrium(game, 0.9).values
    for number, (a, b, ball) in enumerate(game.states):  # type: ignore[misc]
        turned = ((3 - b[0], 4 - b[1]), (3 - a[0], 4 - a[1]), 1 - ball)
        assert values[number] == pytest.approx(-values[game.number[turned]], abs=1e-9)
    assert values[game.number[(1, 0), (3, 4), 0]] == pytest.approx(1.0)  # one step from the goal


def test_soccer_on_other_grids() -> None:
    game = Soccer(rows=5, columns=6)
    assert game.starts() == [(0.5, ((2, 4), (2, 1), 0)), (0.5, ((2, 4), (2, 1), 1))]
    goals = [
        row for row in range(5) if game.transitions(((row, 0), (2, 3), 0), ("west", "stand"))[0][3]
    ]
    assert goals == [2]


def test_the_picture_of_soccer() -> None:
    assert Soccer().draw(((2, 3), (1, 1), 0)).splitlines() == [
        "+----------------+",
        "| .  .  .  .  .  |",
        "  .  B  .  .  .",
        "  .  .  .  A* .",
        "| .  .  .  .  .  |",
        "+----------------+",
        "A has the ball; A attacks west, B east",
    ]


# -- goofspiel -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cards", "order", "points"),
    diagonal([3, 4, 5] * 2, ["random", "descending", "ascending"], ["difference", "win"]),
)
def test_goofspiel_is_that_of_openspiel(cards: int, order: str, points: str) -> None:
    """Random games. There the last cards are played at once, and a difference counts half."""
    pyspiel = pytest.importorskip("pyspiel", exc_type=ImportError)
    paid = {"difference": "point_difference", "win": "win_loss"}[points]
    theirs = pyspiel.load_game(
        f"goofspiel(imp_info=False,num_cards={cards},points_order={order},returns_type={paid})"
    )
    game, random = Goofspiel(cards, order, points), Random(0)
    totals = set()
    for _ in range(60):
        state, total, ended = None, 0.0, False
        position, options = theirs.new_initial_state(), game.starts()
        while not ended:
            if position.is_chance_node():
                known = {card + 1: chance for card, chance in position.chance_outcomes()}
                assert {after.prize: chance for chance, after in options} == known
            _, state = random.choice(options)
            if position.is_chance_node():
                position.apply_action(state.prize - 1)
            actions = tuple(random.choice(game.legal_actions(state, seat)) for seat in (0, 1))
            if not position.is_terminal():
                legal = [[card + 1 for card in position.legal_actions(seat)] for seat in (0, 1)]
                assert legal == [list(hand) for hand in state.hands]
                position.apply_actions([card - 1 for card in actions])
            found = game.transitions(state, actions)
            total, ended = total + found[0][2][0], found[0][3]
            options = [(chance, after) for chance, after, _, _ in found]
        assert position.is_terminal()
        assert position.returns()[0] == total / (2 if points == "difference" else 1)
        totals.add(total)
    assert len(totals) > 2


@pytest.mark.parametrize("cards", [3, 4])
def test_values_of_goofspiel_are_those_of_the_recursion(cards: int) -> None:
    """f[k](V, Y, P) of Rhoads and Bartholdi (2012)."""
    game = enumerated(f"goofspiel(cards={cards})")
    values = equilibrium(game, 1.0, cards).values

    @cache
    def value(first: frozenset[int], second: frozenset[int], prizes: frozenset[int]) -> float:
        return sum(shown(first, second, prizes - {k}, k) for k in prizes) / max(1, len(prizes))

    @cache
    def shown(
        first: frozenset[int], second: frozenset[int], prizes: frozenset[int], k: int
    ) -> float:
        return matrix_value(
            [
                [k * np.sign(a - b) + value(first - {a}, second - {b}, prizes) for b in second]
                for a in first
            ]
        )

    for number, state in enumerate(game.states):
        parts: Any = state
        known = shown(*map(frozenset, (*parts.hands, parts.prizes)), parts.prize)
        assert values[number] == pytest.approx(known, abs=1e-8)


@pytest.mark.parametrize("text", ["goofspiel(cards=4)", "goofspiel(cards=5, order='descending')"])
def test_matching_the_prize_is_best_against_random_bids(text: str) -> None:
    """Ross (1971)."""
    game, cards = enumerated(text), int(re.findall(r"\d", text)[0])
    policies = uniform(game)
    best = respond(game, "player_0", policies, 1.0, cards)
    assert best.mean == pytest.approx((cards**2 - 1) / 6, abs=1e-9)

    def matching(state: Any) -> Any:
        hand = state.hands[0]
        bid = state.prize if state.prize in hand else hand[0]
        return {bid: 1.0}

    played = returns_of(game, {**policies, "player_0": matching}, 1.0, cards)
    assert game.start @ played[:, 0] == pytest.approx(best.mean, abs=1e-9)


def test_the_picture_of_goofspiel() -> None:
    game = Goofspiel(3, points="win")
    state = next(s for _, s in game.starts() if s.prize == 2)
    after = game.transitions(state, (1, 3))[0][1]
    assert game.draw(after).splitlines() == [
        "prize 1, to come: 3",
        "player_0 holds 2 3",
        "player_1 holds 1 2",
        "player_1 leads by 2",
    ]


# -- oshi-zumo -------------------------------------------------------------------------------------


def test_oshi_zumo_needs_openspiel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyspiel", None)
    monkeypatch.delitem(sys.modules, "scripted_agents.games.openspiel_games", raising=False)
    with pytest.raises(ValueError, match=re.escape("pip install 'pursuit[openspiel]'")):
        oshi_zumo()


def test_values_of_oshi_zumo_are_those_of_its_rules() -> None:
    """The rules of its docstring, as a recursion."""
    pytest.importorskip("pyspiel", exc_type=ImportError)

    @cache
    def value(first: int, second: int, place: int) -> float:
        if abs(place) > 2 or not first + second:
            return float(np.sign(place))
        bids = [range(1, coins + 1) if coins else [0] for coins in (first, second)]
        return matrix_value(
            [
                [value(first - a, second - b, place + (a > b) - (a < b)) for b in bids[1]]
                for a in bids[0]
            ]
        )

    game = enumerate_game(oshi_zumo(coins=6, size=2), progress=False)
    values = equilibrium(game, 1.0, 6).values
    for state, found in zip(game.states, values, strict=True):
        words = state[0].split()  # type: ignore[index]
        place = words[4].index("W") - 3
        known = value(int(words[1]), int(words[2].strip(",")), place)
        assert found == pytest.approx(known, abs=1e-8)


# -- border control --------------------------------------------------------------------------------


def test_the_moves_of_border_control_are_those_of_its_rules() -> None:
    """Cells as complex numbers, the south and the east positive."""
    steps = {"north": -1j, "south": 1j, "west": -1, "east": 1, "stand": 0}
    wide = {**steps, **{f"{a}-{b}": steps[a] + steps[b] for a in ("north", "south")
                        for b in ("east", "west")}}  # fmt: skip
    game, random = BorderControl(), Random(0)
    grid = {column + 1j * row for row in range(4) for column in range(5)}
    ends: set[Any] = set()
    for _ in range(300):
        cells = sorted(random.choices(sorted(game.cells), k=2))
        free = [cell for cell in game.cells if cell not in cells and cell[1] < 4]
        state: Any = ((cells[0], cells[1]), random.choice(free))
        one, two, thief = (column + 1j * row for row, column in (*cells, state[1]))
        pairs = {(a, b) for a in steps for b in steps if {one + steps[a], two + steps[b]} <= grid}
        assert set(game.legal_actions(state, 0)) == pairs
        ways = {name for name, step in wide.items() if thief + step in grid}
        assert set(game.legal_actions(state, 1)) == ways
        for (a, b), way in product(pairs, ways):
            new, to = [one + steps[a], two + steps[b]], thief + wide[way]
            swaps = (new[0], to) == (thief, one) or (new[1], to) == (thief, two)
            caught = to in new or swaps
            outcome = 1.0 if caught else -1.0 if to.real == 4 else 0.0
            ((chance, after, rewards, ended),) = game.transitions(state, ((a, b), way))
            assert (chance, rewards, ended) == (1.0, (outcome, -outcome), outcome != 0.0)
            if not ended:
                new = sorted(new, key=lambda cell: (cell.imag, cell.real))
                places = [(int(cell.imag), int(cell.real)) for cell in (*new, to)]
                assert after == ((places[0], places[1]), places[2])
            ends.add(outcome)
    assert ends == {1.0, -1.0, 0.0}


def test_border_control_is_solved_by_mixed_play() -> None:
    game = enumerated("border_control(rows=3, columns=4)")
    solution = equilibrium(game, 0.95)
    assert nash_conv(game, solution.policies, 0.95).nash_conv < 1e-8
    assert 0.1 < solution.mixed.mean() < 1.0


def test_the_picture_of_border_control() -> None:
    game = BorderControl(rows=3, columns=4)
    assert game.draw((((0, 1), (1, 3)), (2, 0))).splitlines() == [
        "+---------+",
        "| . G . E |",
        "| . . . G |",
        "| I . . E |",
        "+---------+",
    ]
    assert "2" in game.draw((((0, 1), (0, 1)), (2, 0)))
