"""Small games: enumeration, values, best responses and equilibria, against plain recursions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from matrix_values import matrix_value
from numpy.typing import NDArray
from trained_games import Chase

import pursuit
from pursuit import chase_v0
from pursuit.tasks.task import Task
from scripted_agents import AStarEvader, best_response, solve_chase, solve_joint
from scripted_agents.games import (
    ParallelGame,
    SmallGameEnv,
    enumerate_game,
    equilibrium,
    nash_conv,
    respond,
    returns_of,
)
from scripted_agents.games.agents import uniform_table

LINES = (
    (0, 1, 2), (3, 4, 5), (6, 7, 8), (0, 3, 6), (1, 4, 7), (2, 5, 8), (0, 4, 8), (2, 4, 6)
)  # fmt: skip


class RandomGame:
    """A game with random transitions, rewards and numbers of actions."""

    def __init__(self, players: int, states: int, seed: int, zero_sum: bool = False) -> None:
        self.players = tuple(f"p{i}" for i in range(players))
        random = np.random.default_rng(seed)
        self.sizes = random.integers(1, 4, (states, players)).tolist()
        self.table: dict[Any, list[Any]] = {}
        for state in range(states):
            for actions in product(*map(range, self.sizes[state])):
                after = random.choice(states, 3, replace=False).tolist()
                chances = random.dirichlet(np.ones(3)).tolist()
                rewards = random.normal(size=(3, players))
                if zero_sum:
                    rewards[:, 1] = -rewards[:, 0]
                ends = (random.random(3) < 0.2).tolist()
                self.table[state, actions] = list(
                    zip(chances, after, rewards.tolist(), ends, strict=True)
                )

    def starts(self) -> list[tuple[float, int]]:
        return [(1.0 / len(self.sizes), state) for state in range(len(self.sizes))]

    def legal_actions(self, state: int, player: int) -> Sequence[int]:
        return range(self.sizes[state][player])

    def transitions(self, state: int, actions: Any) -> list[Any]:
        return self.table[state, actions]


def recursion(
    game: RandomGame, choose: Callable[[int, dict[Any, NDArray[np.float64]]], Any], steps: int,
    discount: float,
) -> Any:  # fmt: skip
    """Backward induction: `choose` makes the values of a state from those of joint actions."""
    values: Any = [0.0] * len(game.sizes)
    for _ in range(steps):
        new = []
        for state, sizes in enumerate(game.sizes):
            worth = {
                actions: sum(
                    chance * (np.array(rewards) + discount * (0.0 if ended else values[after]))
                    for chance, after, rewards, ended in game.transitions(state, actions)
                )
                for actions in product(*map(range, sizes))
            }
            new.append(choose(state, worth))
        values = new
    return values


@pytest.mark.parametrize("seed", range(5))
def test_values_and_best_responses_of_random_games(seed: int) -> None:
    game = RandomGame(3, 6, seed)
    small, random = enumerate_game(game), np.random.default_rng(seed)
    policies = {
        player: [random.dirichlet(np.ones(sizes[i])).tolist() for sizes in game.sizes]
        for i, player in enumerate(game.players)
    }
    tables = {player: rows.__getitem__ for player, rows in policies.items()}
    chance: Callable[..., float] = lambda state, actions, players: float(  # noqa: E731
        np.prod([policies[f"p{i}"][state][actions[i]] for i in players])
    )
    for steps, discount in ((4, 1.0), (120, 0.8)):
        horizon = steps if discount == 1.0 else None

        def played(state: int, worth: Any) -> Any:
            return sum(chance(state, a, (0, 1, 2)) * value for a, value in worth.items())

        known = recursion(game, played, steps, discount)
        found = returns_of(small, tables, discount, horizon)
        np.testing.assert_allclose(found, known, atol=1e-9)
        for team in ((1,), (0, 2)):
            others = tuple({0, 1, 2} - set(team))

            def best(state: int, worth: Any, team: Any = team, others: Any = others) -> Any:
                options: dict[Any, Any] = {}
                for actions, value in worth.items():
                    own = tuple(actions[i] for i in team)
                    part = chance(state, actions, others) * value
                    options[own] = options.get(own, 0.0) + part
                return max(options.values(), key=lambda value: float(value[list(team)].sum()))

            known = np.array(recursion(game, best, steps, discount))[:, list(team)].sum(axis=1)
            response = respond(small, [f"p{i}" for i in team], tables, discount, horizon)
            np.testing.assert_allclose(response.values, known, atol=1e-9)
            if horizon is None:
                both = {**tables, **response.tables}
                reached = returns_of(small, both, discount)[:, list(team)].sum(axis=1)
                np.testing.assert_allclose(reached, known, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_equilibria_of_random_games_by_linear_programs(seed: int) -> None:
    game = RandomGame(2, 5, seed, zero_sum=True)
    small, mixed = enumerate_game(game), {}

    def solved(state: int, worth: Any) -> Any:
        m, n = game.sizes[state]
        payoff = np.array([[worth[i, j][0] for j in range(n)] for i in range(m)])
        value = matrix_value(payoff)
        mixed[state] = bool(payoff.max(axis=0).min() - payoff.min(axis=1).max() > 1e-7)
        return np.array([value, -value])

    for steps, discount, horizon in ((5, 1.0, 5), (3, 0.9, 3), (120, 0.8, None)):
        found = equilibrium(small, discount, horizon)
        known = [value[0] for value in recursion(game, solved, steps, discount)]
        np.testing.assert_allclose(found.values, known, atol=1e-8)
        if horizon is None:
            assert found.mixed.tolist() == [mixed[state] for state in range(5)]
            assert abs(nash_conv(small, found.tables, discount).nash_conv) < 1e-8


class TicTacToe:
    """In turns: the other player has the action None."""

    players = ("cross", "nought")

    def starts(self) -> list[tuple[float, str]]:
        return [(1.0, "." * 9)]

    def legal_actions(self, state: str, player: int) -> list[int | None]:
        moves = [None] if (9 - state.count(".")) % 2 != player else []
        return moves or [at for at, mark in enumerate(state) if mark == "."]

    def transitions(self, state: str, actions: Any) -> list[Any]:
        turn = (9 - state.count(".")) % 2
        at, mark = actions[turn], "xo"[turn]
        after = state[:at] + mark + state[at + 1 :]
        won = any(all(after[cell] == mark for cell in line) for line in LINES)
        reward = (1.0 if turn == 0 else -1.0) if won else 0.0
        return [(1.0, after, (reward, -reward), won or "." not in after)]


def test_tic_tac_toe_is_a_draw_with_the_known_number_of_states() -> None:
    small = enumerate_game(TicTacToe())
    assert small.num_states == 4520  # of 5478 positions 958 are over
    found = equilibrium(small, 1.0, horizon=9)
    assert found.mean == 0.0 and not found.mixed.any()
    random = {"nought": uniform_table(small, "nought")}
    best = respond(small, "cross", random, 1.0, horizon=9)
    assert best.mean == pytest.approx(_against_random("." * 9), abs=1e-12)


@cache
def _against_random(state: str) -> float:
    """The value for crosses against random noughts."""
    free = [at for at, mark in enumerate(state) if mark == "."]
    turn = (9 - len(free)) % 2
    values = []
    for at in free:
        after = state[:at] + "xo"[turn] + state[at + 1 :]
        if any(all(after[cell] == "xo"[turn] for cell in line) for line in LINES):
            values.append(1.0 - 2.0 * turn)
        else:
            values.append(_against_random(after) if "." in after else 0.0)
    return max(values) if turn == 0 else sum(values) / len(values)


def test_the_chase_as_a_small_game_equals_the_solvers_of_tasks() -> None:
    maze = pursuit.load_maze("4x4")
    small = enumerate_game(Chase("4x4"))
    pairs = tuple(np.array(small.states).T)
    game = solve_chase(maze, 0.95)
    np.testing.assert_allclose(-equilibrium(small, 0.95).values, game.values[pairs], atol=1e-9)
    table = AStarEvader(0.2).action_probabilities(maze)
    found = respond(small, "chaser", {"evader": lambda s: table[s[1], s[0]]}, 1.0, horizon=50)
    known = best_response("chaser", maze, table, horizon=50)
    np.testing.assert_allclose(-found.values, known.values[pairs], atol=1e-9)
    task = Task(maze=maze, num_chasers=1, num_evaders=1)
    joint = solve_joint(task, "chaser", {"evader": AStarEvader(0.2)}, horizon=50)
    assert -found.mean == pytest.approx(joint.mean_over_starts, abs=1e-9)


def test_a_parallel_environment_as_a_small_game() -> None:
    """The chase of PettingZoo, restored from the cells of its agents."""
    env = chase_v0.parallel_env(
        maze="3x3", rewards="zero_sum", max_steps=10**6, observation="positions"
    )

    def save(env: Any) -> Any:
        return tuple(env.simulator.positions[0].tolist())

    def restore(env: Any, state: Any) -> None:
        env.reset(seed=0, options={"positions": list(state)})

    small = enumerate_game(ParallelGame(env, save, restore, seeds=range(40)))
    maze = pursuit.load_maze("3x3")
    apart = maze.num_cells * (maze.num_cells - 1)
    assert small.num_states == apart
    values = equilibrium(small, 0.95).values
    known = solve_chase(maze, 0.95).values[tuple(np.array([s[0] for s in small.states]).T)]
    np.testing.assert_allclose(-values, known, atol=1e-9)


class Broken(Chase):
    """A chase of which some functions return something else."""

    def __init__(self, **returned: Any) -> None:
        super().__init__(pursuit.load_maze("2x2"))
        self.players, self.returned = returned.get("players", self.players), returned

    def starts(self) -> list[Any]:
        return self.returned.get("starts", super().starts())

    def legal_actions(self, state: Any, player: int) -> Sequence[int]:
        return self.returned.get("actions", super().legal_actions(state, player))

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        if "endless" in self.returned:
            return [(1.0, (state[0] + 1, state[1]), EVEN, False)]
        return self.returned.get("transitions", [(1.0, (0, 1), EVEN, False)])


EVEN = (0.0, 0.0)


@pytest.mark.parametrize(
    ("returned", "problem"),
    [
        ({"players": ()}, r"players=\(\); give the name of each"),
        ({"players": ("a", "a")}, "all different"),
        ({"starts": [(0, 1)]}, "add up to 0"),
        ({"starts": [7]}, r"starts\(\) returned \[7\]; give a list of \(probability, state\)"),
        ({"starts": [(0.5, (0, 1))]}, r"starts\(\): the probabilities .* add up to 0.5"),
        ({"starts": []}, "is empty"),
        ({"actions": []}, r"returned \[\]; give chaser a list of .* at least one"),
        ({"actions": [1, 1]}, r"returned \[1, 1\]; give chaser a list of hashable actions"),
        ({"actions": None}, r"legal_actions\(\(0, 1\), 0\) returned None; give a list of hashable"),
        ({"actions": [[1]]}, r"returned \[\[1\]\]; give chaser a list of hashable actions"),
        ({"endless": True}, "more than 1,000 states"),
        *(
            ({"transitions": outcomes}, problem)
            for outcomes, problem in (
                ([(1.0, (0, 1), EVEN)], r"a list of \(probability, next state, rewards, ended\)"),
                (None, "returned None; give a list"),
                ([("1", (0, 1), EVEN, False)], r"the probabilities \['1'\] are not numbers"),
                ([(1.0, (0, 1), EVEN, "no")], "ended='no'; give True or False"),
                (
                    [(0.7, (0, 1), EVEN, False)],
                    r"transitions\(\(0, 1\), \(0, 0\)\): the probabilities \[0.7\] add up to 0.7",
                ),
                ([(1.5, 0, EVEN, False), (-0.5, 0, EVEN, False)], "non-negative"),
                ([(1.0, [0, 1], EVEN, False)], r"the state \[.*\] is not hashable; give a tuple"),
                *(
                    (
                        [(1.0, (0, 1), rewards, False)],
                        "one finite number for each of chaser, evader",
                    )
                    for rewards in ((1.0,), {"chaser": 1.0, "evader": 0.0}, (float("nan"), 0.0))
                ),
            )
        ),
    ],
)
def test_faulty_games_are_refused(returned: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        enumerate_game(Broken(**returned), most_states=1000)


def test_an_error_of_the_game_names_the_call_and_one_step_can_end_it() -> None:
    class Once(Chase):
        def transitions(self, state: Any, actions: Any) -> Any:
            yield 1.0, None, (int(actions[0]), -int(actions[0])), True

        def legal_actions(self, state: Any, player: int) -> Sequence[Any]:
            return (0, 1) if player else (2, self.best)

    game = Once(pursuit.load_maze("2x2"))
    game.best = 5
    assert equilibrium(enumerate_game(game)).mean == 5.0
    game.best = "high"
    with pytest.raises(ValueError, match="invalid literal") as raised:
        enumerate_game(game)
    assert raised.value.__notes__ == ["in transitions((0, 1), ('high', 0)) of the game"]


def test_invalid_questions_are_refused() -> None:
    small = enumerate_game(Chase(pursuit.load_maze("2x2")))
    even = {player: lambda state: [0.25] * 4 for player in small.players}
    for discount, horizon in ((1.0, None), (0.0, 3), (1.2, 3), (0.9, 0)):
        with pytest.raises(ValueError, match=r"discount|horizon"):
            returns_of(small, even, discount, horizon)
    with pytest.raises(ValueError, match="player evader has no policy"):
        respond(small, "chaser", {})
    with pytest.raises(ValueError, match="several different ones"):
        respond(small, ["chaser", "chaser"], even)
    with pytest.raises(ValueError, match="player 'thief'; the players are"):
        returns_of(small, {**even, "thief": even["chaser"]})
    with pytest.raises(ValueError, match="give enumerate_game"):
        equilibrium(Chase(pursuit.load_maze("2x2")))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="give an object with players"):
        enumerate_game(Chase)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="player 'runner'; the players are chaser, evader"):
        respond(small, "runner", even)
    for wrong, problem in (
        (lambda state: [0.5, 0.5], "give 4 probabilities"),
        (lambda state: {"left": 1.0}, "plays 'left' in"),
        (lambda state: [1.0, 1.0, 0.0, 0.0], "non-negative ones with sum 1"),
        (lambda state: [float("nan")] * 4, "non-negative ones with sum 1"),
        (np.ones(3), "has shape"),
        ({(0, 1): [1.0]}, "give a function of a state"),
    ):
        with pytest.raises(ValueError, match=problem):
            returns_of(small, {**even, "chaser": wrong})
    with pytest.raises(ValueError, match="two players with opposite rewards"):
        equilibrium(enumerate_game(Broken(transitions=[(1.0, (0, 1), (1.0, 1.0), False)])))
    with pytest.raises(ValueError, match="3 players; equilibria are computed for two"):
        equilibrium(enumerate_game(RandomGame(3, 4, 0)))


def test_a_player_as_a_gymnasium_environment_has_the_exact_return() -> None:
    game = RandomGame(2, 6, 3)
    small, random = enumerate_game(game), np.random.default_rng(0)
    rows = [random.dirichlet(np.ones(sizes[1])).tolist() for sizes in game.sizes]
    env = SmallGameEnv(small, "p0", {"p1": rows.__getitem__}, max_steps=60)
    check_env(SmallGameEnv(enumerate_game(Chase(pursuit.load_maze("2x2"))), "chaser",
                           {"evader": lambda state: [0.25] * 4}))  # fmt: skip
    first = [[1.0, *[0.0] * (sizes[0] - 1)] for sizes in game.sizes]
    policies = {"p0": first.__getitem__, "p1": rows.__getitem__}
    known = float((small.start @ returns_of(small, policies, 0.8))[0])
    totals = []
    for episode in range(1000):
        env.reset(seed=episode)
        total, discount, over = 0.0, 1.0, False
        while not over:
            assert env.action_masks().sum() == game.sizes[int(str(small.states[env.state]))][0]
            first_legal = small.actions[0][env.state][0]  # in the order of the game
            number = small.action_lists[0].index(first_legal)
            _, reward, ended, truncated, _ = env.step(number)
            total, discount, over = total + discount * reward, 0.8 * discount, ended or truncated
        totals.append(total)
    assert abs(np.mean(totals) - known) < 4 * np.std(totals) / len(totals) ** 0.5
    assert env.observations().shape == (6, 6)
    with pytest.raises(ValueError, match="the actions of p0 are numbers from 0 to 2"):
        env.step(7)
    with pytest.raises(ValueError, match="player p1 has no policy"):
        SmallGameEnv(small, "p0", {})
