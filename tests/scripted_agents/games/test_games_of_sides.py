"""Tasks as games of two sides, and the mixed share, against the other solvers and brute force."""

from __future__ import annotations

from collections import Counter
from itertools import product
from typing import Any

import networkx
import numpy as np
import pytest

import pursuit
from pursuit.mazes.maze import Maze
from pursuit.rules.layout import empty_games
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.rewards import Rewards
from pursuit.tasks.task import ACTIONS, Task, make_task
from scripted_agents import AStarEvader, solve_chase, solve_joint, solve_joint_game
from scripted_agents.games import (
    GameTask,
    SmallGame,
    enumerate_game,
    equilibrium,
    game_of_sides,
    game_of_task,
    load_game,
    mixed_share,
    nash_conv,
    respond,
    states_of_games,
    tasks,
)
from scripted_agents.games.library.goofspiel import Goofspiel
from scripted_agents.games.library.rock_paper_scissors import RockPaperScissors
from scripted_agents.games.mixing import apart

SLIPS = {"slip": {"chaser": 0.1, "evader": 0.3}}
TURNS = {"move_order": "turns", "stay_action": True}


# -- values ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {"maze": "3x3-open"},
        {"maze": "3x3-open", "move_order": "chasers_first"},
        {"maze": "3x3", "stay_action": True},
        {"maze": "2x2-tree", "num_chasers": 2},
    ],
)
def test_chases_have_the_values_of_solve_chase(settings: dict[str, Any]) -> None:
    task = make_task("chase", rewards="zero_sum", **settings)
    game = game_of_sides(task)
    values = equilibrium(game, 0.9).values
    known = solve_chase(
        task.mazes[0],
        0.9,
        task.stay_action,
        move_order=task.move_order,
        num_chasers=task.num_chasers,
    )
    for (cells, _), value in zip(game.states, values, strict=True):  # type: ignore[misc]
        assert value == pytest.approx(-known.values[cells], abs=1e-7)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("chase", {"rewards": "zero_sum", **SLIPS}),
        ("chase", {"rewards": "distance", "move_order": "chasers_first", "slip": 0.2}),
        ("escape", {"num_exits": 1, "capture": "adjacent"}),
        ("escape", {"num_exits": 1, **SLIPS}),
        ("heist", {"num_goals": 1, "slip": 0.2, "stay_action": True}),
        ("heist", {"num_goals": 1, "num_exits": 1, **SLIPS}),
        ("race", {"num_goals": 2, "slip": "runner_0=0.2"}),
        ("race", {"num_goals": 2, "collisions": "block", "slip": 0.1}),
    ],
)
def test_the_value_is_half_of_the_lead_of_the_joint_solver(name: str, settings: Any) -> None:
    task = make_task(name, maze="3x3-tree" if name == "race" else "2x2", **settings)
    game = game_of_sides(task)
    assert game.zero_sum and len({*game.states}) == game.num_states
    known = solve_joint_game(task, 0.9)
    found = equilibrium(game, 0.9)
    assert 2 * found.mean == pytest.approx(known.mean_over_starts, abs=1e-7)


def test_a_graph_with_one_way_streets_and_other_numbers_of_moves() -> None:
    graph = networkx.DiGraph([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (2, 0), (2, 1)])
    task = make_task("chase", maze=Maze.from_graph(graph), rewards="zero_sum", slip=0.3)
    known = solve_joint_game(task, 0.9)
    found = equilibrium(game_of_sides(task), 0.9)
    assert 2 * found.mean == pytest.approx(known.mean_over_starts, abs=1e-7)


def test_the_best_response_of_a_team_with_slips_is_that_of_the_joint_solver() -> None:
    task = Task(
        maze="2x2", num_chasers=2, num_evaders=1, n_catch=2, stay_action=True, slip=SLIPS["slip"],
        rewards="zero_sum",
    )  # fmt: skip
    game, evader = game_of_sides(task), AStarEvader(0.4)
    games = empty_games(game.num_states, 3, 0)
    games.position[:], games.active[:] = [cells for cells, _ in game.states], 1  # type: ignore[misc]
    rows: list[float] = []
    chances = evader.distribution(task, games, 2)
    for (cells, _), legal, row in zip(game.states, game.actions[1], chances, strict=True):  # type: ignore[misc]
        moves = task.mazes[0].neighbors[cells[2]]
        for word in legal:  # an action that is not listed leads to the same cell as one that is
            there = moves[ACTIONS.index(word)]  # type: ignore[arg-type]
            rows.append(sum(row[other] for other in range(5) if moves[other] == there))
    found = respond(game, "chaser", {"evader": np.array(rows)}, 0.9)
    known = solve_joint(task, "chaser", {"evader": evader}, None, 0.9, "steps")
    assert -found.mean == pytest.approx(known.mean_over_starts, abs=1e-7)


# -- turns -----------------------------------------------------------------------------------------


def test_turns_have_the_values_of_a_value_iteration_over_moves() -> None:
    """Step rewards are paid after the evader's move, and a capture is paid in their place."""
    maze, gamma, slip = pursuit.load_maze("3x3-open"), 0.9, 0.2
    rewards = {"chaser": Rewards(step=-1.0, capture=5.0), "evader": Rewards(step=1.0, capture=-5.0)}
    task = make_task("chase", maze=maze, rewards=rewards, slip={"evader": slip}, **TURNS)
    game = game_of_sides(task)
    ways = [sorted({*row}) for row in maze.neighbors.tolist()]
    pairs = [pair for pair in product(range(9), range(9)) if pair[0] != pair[1]]
    value = {(pair, half): 0.0 for pair in pairs for half in (0, 1)}
    for _ in range(400):
        before = dict(value)
        for chaser, evader in pairs:
            value[(chaser, evader), 0] = max(
                5.0 if new == evader else gamma * before[(new, evader), 1] for new in ways[chaser]
            )
            worth = {
                new: 5.0 if new == chaser else -1.0 + gamma * before[(chaser, new), 0]
                for new in ways[evader]
            }
            slipped = np.mean([worth[new] for new in ways[evader] if new != evader])
            value[(chaser, evader), 1] = slip * slipped + (1 - slip) * min(worth.values())
    found = equilibrium(game, gamma)
    assert not found.mixed.any() and game.num_states == 2 * len(pairs)
    assert mixed_share(game, gamma) == 0.0
    halves = [state[-1] for state in game.states]  # type: ignore[index]
    assert GameTask(game).waiting.tolist() == [[half != side for half in halves] for side in (0, 1)]
    for (cells, _, half), each in zip(game.states, found.values, strict=True):  # type: ignore[misc]
        assert each == pytest.approx(value[cells, half], abs=1e-7)
        number = game.number[cells, (), half]
        assert game.actions[1 - half][number] == (None,) and game.start[number] * half == 0.0


# -- slips -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first", "turns"])
def test_transitions_with_slips_are_those_of_the_simulator(order: str) -> None:
    """Teams with captured evaders: shares of what follows in 4,000 games of each of some states."""
    task = Task(
        maze="2x2-open", num_chasers=1, num_evaders=2, move_order=order, stay_action=True,
        slip={"chaser": 0.5, "evader_0": 0.4, "evader_1": 0.9},
    )  # fmt: skip
    game, many, random = game_of_sides(task), 4000, np.random.default_rng(0)
    sim = Simulator(task, num_games=many, seed=1)
    captured = 0
    for _ in range(12):
        sim.reset()
        for _ in range(int(random.integers(0, 3))):
            sim.step(random.integers(0, 5, (many, 3)).astype(np.int32))
        names = [
            (*state, *([int(half) % 2] if order == "turns" else []))
            for state, half in zip(states_of_games(sim.view(0).games), sim.steps, strict=True)
        ]
        state, _ = Counter(names).most_common(1)[0]
        if random.random() < 0.5:
            state = next((one for one in names if -1 in one[0]), state)
        captured += -1 in state[0]
        chosen = [int(random.integers(len(rows[game.number[state]]))) for rows in game.actions]
        moves: list[Any] = [
            rows[game.number[state]][index]
            for rows, index in zip(game.actions, chosen, strict=True)
        ]
        words = [moves[0], *(("stay", "stay") if moves[1] is None else moves[1])]
        actions = [ACTIONS.index("stay" if word is None else word) for word in words]
        here = [index for index, name in enumerate(names) if name == state]
        sim.step(np.tile(np.array(actions, dtype=np.int32), (many, 1)))
        ended = sim.terminated[here]
        after = states_of_games(sim.view(0).games)
        halves = sim.steps
        shares: Counter[Any] = Counter()
        for index, over in zip(here, ended, strict=True):
            half = (int(halves[index]) % 2,) if order == "turns" else ()
            shares["end" if over else (*after[index], *half)] += 1 / len(here)
        numbers, exact = game.outcomes(game.joint_action(game.number[state], chosen))
        known = {game.states[n]: p for n, p in zip(numbers.tolist(), exact, strict=True)}
        known["end"] = 1.0 - sum(known.values())
        wide = 5.0 * 0.5 / np.sqrt(len(here)) + 1e-9
        for name in {*known, *shares}:
            assert shares[name] == pytest.approx(known.get(name, 0.0), abs=wide)
    assert captured > 0


# -- mixed share -----------------------------------------------------------------------------------


def random_game(seed: int, states: int = 6) -> SmallGame:
    """A zero-sum game whose states have different numbers of actions."""
    random = np.random.default_rng(seed)

    class Drawn:
        players = ("one", "two")

        def starts(self) -> list[Any]:
            return [(0.25, 0), (0.75, 1)]

        def legal_actions(self, state: int, player: int) -> range:
            return range(1 + (state * (player + 2)) % 4)

        def transitions(self, state: int, actions: Any) -> list[Any]:
            reward, chance = float(random.integers(-3, 4)), random.dirichlet(np.ones(states))
            return [
                (each, after, (reward, -reward), after == 0)
                for after, each in enumerate(chance.tolist())
            ]

    return enumerate_game(Drawn(), progress=False)


@pytest.mark.parametrize("seed", range(4))
def test_apart_is_that_of_the_matrices(seed: int) -> None:
    game = random_game(seed)
    values = np.random.default_rng(seed).normal(size=game.num_states)
    found = apart(game, values, 0.9)
    for state in range(game.num_states):
        rows, columns = (range(len(actions[state])) for actions in game.actions)
        matrix = np.zeros((len(rows), len(columns)))
        for cell in product(rows, columns):
            joint = game.joint_action(state, cell)
            numbers, chances = game.outcomes(joint)
            matrix[cell] = game.rewards[joint, 0] + 0.9 * chances @ values[numbers]
        known = matrix.max(axis=0).min() - matrix.min(axis=1).max()
        assert found[state] == pytest.approx(known, abs=1e-12)
    assert found.max() > 0.0


def test_the_mixed_share_of_rock_paper_scissors_is_one() -> None:
    game = enumerate_game(RockPaperScissors(), progress=False)
    assert mixed_share(game, 0.9) == 1.0
    assert mixed_share(game, 1.0, horizon=3) == 1.0


class Late:
    """Two steps without a choice, then matching pennies, which ends with probability 1/2."""

    players = ("one", "two")

    def starts(self) -> list[Any]:
        return [(1.0, "first")]

    def legal_actions(self, state: str, player: int) -> tuple[str, ...]:
        return ("heads", "tails") if state == "pennies" else ("wait",)

    def transitions(self, state: str, actions: Any) -> list[Any]:
        if state == "first":
            return [(1.0, "second", (0.0, 0.0), False)]
        if state == "second":
            return [(1.0, "pennies", (0.0, 0.0), False)]
        reward = 1.0 if actions[0] == actions[1] else -1.0
        return [(0.5, "pennies", (reward, -reward), False), (0.5, "pennies", (0.0, 0.0), True)]


def test_the_mixed_share_of_a_game_with_one_mixed_state() -> None:
    game = enumerate_game(Late(), progress=False)
    # Visits: 1, g, and g^2 (1 + g / 2 + (g / 2)^2 + ...).
    late = 0.8**2 / (1 - 0.4)
    assert mixed_share(game, 0.8) == pytest.approx(late / (1 + 0.8 + late), abs=1e-9)
    assert mixed_share(game, 1.0, horizon=4) == pytest.approx((1 + 0.5) / 3.5, abs=1e-12)
    assert mixed_share(game, 0.8, horizon=2) == 0.0
    assert mixed_share(game, 0.8, None, equilibrium(game, 0.8)) == mixed_share(game, 0.8)


class Apart:
    """One decision, in which only what follows tells the actions apart."""

    players = ("one", "two")

    def starts(self) -> list[Any]:
        return [(1.0, "bid")]

    def legal_actions(self, state: str, player: int) -> tuple[int, ...]:
        return (0, 1) if state == "bid" else (0,)

    def transitions(self, state: str, actions: Any) -> list[Any]:
        if state == "bid":
            return [(1.0, "won" if actions[0] == actions[1] else "lost", (0.0, 0.0), False)]
        reward = 1.0 if state == "won" else -1.0
        return [(1.0, "bid", (reward, -reward), False)]


def test_with_a_horizon_values_are_those_of_the_steps_that_are_left() -> None:
    game = enumerate_game(Apart(), progress=False)
    assert mixed_share(game, 1.0, horizon=1) == 0.0  # nothing is paid for the only bid
    assert mixed_share(game, 1.0, horizon=2) == 0.5


def test_the_mixed_share_of_goofspiel_is_that_of_simulated_play() -> None:
    game = enumerate_game(Goofspiel(cards=4), progress=False)
    solution = equilibrium(game, 1.0, 4)
    mixed = apart(game, solution.values, 1.0) > 1e-6
    random, mixes = np.random.default_rng(0), []
    for _ in range(3000):
        state: int | None = int(random.choice(game.num_states, p=game.start))
        while state is not None:
            mixes.append(mixed[state])
            chosen = []
            for seat, name in enumerate(game.players):
                first, last = game.offsets(seat)[state : state + 2]
                chances = solution.policies[name][first:last]
                chosen.append(int(random.choice(len(chances), p=chances / chances.sum())))
            numbers, chances = game.outcomes(game.joint_action(state, chosen))
            state = int(random.choice(numbers, p=chances / chances.sum())) if len(numbers) else None
    assert mixed_share(game, 1.0, 4) == pytest.approx(np.mean(mixes), abs=0.02)
    assert 0.1 < np.mean(mixes) < 0.9


# -- by name ---------------------------------------------------------------------------------------


def test_a_game_by_name_is_that_of_its_task() -> None:
    text = "maze_game(maze='2x2', stay_action=true, slip='evader=0.1')"
    game = load_game(text)
    assert load_game(text) is game
    task = make_task(
        "chase", maze="2x2", stay_action=True, slip={"evader": 0.1}, rewards="zero_sum"
    )
    assert game.digest == game_of_sides(task).digest
    assert nash_conv(game, equilibrium(game).policies).nash_conv < 1e-8


def test_what_is_seen_of_states_tells_them_apart() -> None:
    for text in (
        "maze_game(task=escape, maze='2x2', num_exits=1, move_order=turns, stay_action=True)",
        "maze_game(task=heist, maze='2x2', num_goals=1, num_evaders=2, num_chasers=1)",
    ):
        game = load_game(text)
        source: Any = game.source
        for player in (0, 1):
            seen = np.array([source.observe(state, player) for state in game.states])
            assert len(np.unique(seen, axis=0)) == game.num_states
    escape = load_game("maze_game(task=escape, maze='2x2', num_exits=1, move_order=turns, "
                       "stay_action=True)")  # fmt: skip
    drawing: Any = escape.source
    assert drawing.draw(((0, 3), (), (1,), 1)).splitlines()[1::2] == [
        "|C X|",
        "|  E|",
        "others to move",
    ]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ("maze='3x3', view_radius=1", "view of chaser_0 is limited"),
        ("maze='3x3-open', line_of_sight='evader'", "view of evader_0 is limited"),
        ("maze='3x3', num_runners=1, num_goals=1", "agents of two roles, or two agents"),
        ("task=maze, maze='3x3'", "has agents runner_0; give agents of two roles"),
        ("task=race, maze='3x3', num_runners=3", "two roles, or two agents"),
        ("maze='suite:5x5-train'", "1000 mazes"),
        ("maze='3x3', rewards=pursuit_v5", "custom reward function"),
        ("maze='15x15', num_chasers=2", "at most 200,000 are solved"),
        ("maze='3x3', max_steps=20", "max_steps=20: a small game has no limit on steps"),
        ("maze='3x3', size=3", "unexpected keyword argument 'size'"),
    ],
)
def test_what_is_no_game_of_two_sides_is_refused(arguments: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as raised:
        load_game(f"maze_game({arguments})")
    assert "\n" not in str(raised.value)


def test_slips_with_too_many_outcomes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is that of all joint actions times the moves that each agent can slip to."""
    monkeypatch.setattr(tasks, "MAX_STORE_BYTES", 40 * 1000)
    maze = pursuit.load_maze("2x2-open")  # in each of 12 states 3 * 3 joint actions, 3 * 3 outcomes
    game_of_sides(make_task("chase", maze=maze, stay_action=True, slip=0.1))
    monkeypatch.setattr(tasks, "MAX_STORE_BYTES", 40 * 12 * 81 - 1)
    with pytest.raises(ValueError, match="12 states with slips: 972 outcomes needs"):
        game_of_sides(make_task("chase", maze=maze, stay_action=True, slip=0.1))


def test_more_joint_actions_than_numbers_are_refused() -> None:
    star = Maze.from_graph(networkx.star_graph(9))
    with pytest.raises(ValueError, match="59,049 joint actions"):
        game_of_task(make_task("chase", maze=star, num_chasers=4))
