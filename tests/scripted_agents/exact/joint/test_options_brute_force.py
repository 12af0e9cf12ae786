"""Exact solutions of games with options, against value iteration over rules in plain Python."""

from __future__ import annotations

import itertools
import zlib
from functools import lru_cache
from math import comb
from typing import Any

import numpy as np
import pytest
from matrix_values import matrix_value
from reference_options import Rulebook, State

from pursuit.mazes.maze import Maze, load_maze
from pursuit.rules.layout import Games
from pursuit.tasks.task import Rewards, Task
from scripted_agents import evaluate_joint, solve_in_turns, solve_joint, solve_joint_game
from scripted_agents.exact.graphs.cops_and_robbers import NEVER
from scripted_agents.exact.joint.nash_conv import joint_nash_conv

SQUARE = load_maze("2x2")
ROOM = Maze.from_text("+-+-+-+\n|     |\n+ + + +\n|     |\n+-+-+-+")  # 0 1 2 / 3 4 5
LOOP = Maze.from_text("+-+-+-+\n|     |\n+ +-+ +\n|     |\n+-+-+-+")
LINE = Maze.from_text("+-+-+-+-+\n|       |\n+-+-+-+-+")


def whim(key: Any, seat: int, actions: int) -> Any:
    """A distribution that depends on everything in a state."""
    rng = np.random.default_rng(zlib.crc32(repr((key, seat)).encode()))
    weights = rng.random(actions) * (rng.random(actions) < 0.7)
    weights[rng.integers(actions)] += 0.1
    return weights / weights.sum()


class Whimsical:
    """Plays by `whim`."""

    def act(self, view: Any) -> Any:
        raise NotImplementedError

    def distribution(self, task: Task, games: Games, seat: int) -> Any:
        rows = [
            whim(key_of(task, state_of(games, game)), seat, task.num_actions)
            for game in range(len(games.steps))
        ]
        return np.array(rows)


def state_of(games: Games, game: int) -> State:
    return State(
        tuple(games.position[game].tolist()),
        tuple(games.active[game].astype(bool).tolist()),
        tuple(games.goal[game].tolist()),
        tuple(games.exit[game].tolist()),
        int(games.steps[game]),
    )


def key_of(task: Task, state: State) -> State:
    """The same for states that differ in nothing that matters."""
    cells = tuple(c if on else 0 for c, on in zip(state.cells, state.active, strict=True))
    half = state.steps % 2 if task.move_order == "turns" else 0
    goals = tuple(sorted(state.goals, reverse=True))
    return State(cells, state.active, goals, tuple(sorted(state.exits)), half)


def starts_of(task: Task) -> dict[State, float]:
    """The probability of every start, agents and then exits and then goals being drawn."""
    cells, found = range(task.max_cells), {}
    seats = [i for i, role in enumerate(task.seat_roles) if role == "evader"]
    for agents in itertools.permutations(cells, task.num_agents):
        held = {agents[i] for i in seats}
        sets = [task.fixed_exits[0]]
        if task.num_exits:
            sets = list(itertools.combinations(cells, task.num_exits))
        for exits in sets:
            if held & set(exits):
                continue
            free = set(cells) - set(agents) - set(exits)
            for goals in itertools.combinations(sorted(free), task.num_goals):
                state = State(agents, (True,) * len(agents), goals, exits)
                found[key_of(task, state)] = 1.0 / comb(len(free), task.num_goals)
    total = sum(found.values())
    return {state: chance / total for state, chance in found.items()}


class Model:
    """All states that can be reached, with rewards and next states by the moves that are made."""

    def __init__(self, task: Task) -> None:
        self.task, self.rules = task, Rulebook(task)
        self.starts, self.turns = starts_of(task), task.move_order == "turns"
        self.steps: dict[State, Any] = {}
        waiting = list(self.starts)
        while waiting:
            state = waiting.pop()
            if state not in self.steps:
                self.steps[state] = self.explore(state)
                waiting += [after for after in self.steps[state][2] if after is not None]
        self.numbers = {state: i for i, state in enumerate(self.steps)} | {None: len(self.steps)}

    def explore(self, state: State) -> Any:
        """(movers, rewards [moves of each mover, agents], next states in the same order)."""
        task, movers = self.task, self.rules.movers(state)
        rewards, after = [], []
        for moves in itertools.product(range(task.num_actions), repeat=len(movers)):
            every = [task.num_moves] * task.num_agents
            for seat, move in zip(movers, moves, strict=True):
                every[seat] = move
            result = self.rules.step(state, tuple(every))
            rewards.append(result.rewards)
            after.append(None if result.terminated else key_of(task, result.state))
        return movers, np.array(rewards), after

    def worth(self, state: State, pays: Any, values: Any, discount: float) -> Any:
        """[action of each mover]: rewards and values to come, expected over slips."""
        movers, rewards, after = self.steps[state]
        if self.turns and state.steps % 2 == 0:
            discount = 1.0
        worth = pays(state, rewards, after)
        worth = worth + discount * values[[self.numbers[key] for key in after]]
        worth = worth.reshape((self.task.num_actions,) * len(movers))
        for axis, seat in enumerate(movers):
            matrix = np.zeros((self.task.num_actions,) * 2)
            for action in range(self.task.num_actions):
                chances = self.rules.slipped(state.cells[seat], action, self.task.slips[seat])
                for move, chance in chances.items():
                    matrix[action, move] += chance
            worth = np.moveaxis(np.tensordot(matrix, worth, axes=(1, axis)), 0, axis)
        return worth

    def solve(
        self, deciding: list[int], pays: Any, best: Any, horizon: int, discount: float
    ) -> dict[State, float]:
        """The value of the starts, `deciding` acting as one and all others by `whim`."""
        values = np.zeros(len(self.steps) + 1)
        for _ in range(horizon * (2 if self.turns else 1)):
            fresh = np.zeros_like(values)
            for state, number in self.numbers.items():
                if state is None:
                    continue
                worth = self.worth(state, pays, values, discount)
                movers = self.steps[state][0]
                for axis in reversed(range(len(movers))):
                    if movers[axis] not in deciding:
                        chances = whim(state, movers[axis], self.task.num_actions)
                        worth = np.tensordot(worth, chances, axes=(axis, 0))
                fresh[number] = best(worth)
            values = fresh
        return {state: float(values[self.numbers[state]]) for state in self.starts}

    def seats(self, role: str) -> list[int]:
        return [i for i, own in enumerate(self.task.seat_roles) if own == role]

    def returns(self, seats: list[int]) -> Any:
        return lambda state, rewards, after: rewards[:, seats].sum(axis=1)

    def rounds(self, seats: list[int]) -> Any:
        """1 for each round that begins with one of these agents in the game."""

        def pays(state: State, rewards: Any, after: Any) -> Any:
            begins = not self.turns or state.steps % 2 == 0
            return np.full(len(after), float(begins and any(state.active[i] for i in seats)))

        return pays

    def ends(self, state: State, rewards: Any, after: Any) -> Any:
        """1 for a step that ends the game."""
        return np.array([float(key is None) for key in after])

    def games(self) -> Games:
        """The starts, as games of the task."""
        rows = list(self.starts)
        position, active, goal, exits = (
            np.array([row[i] for row in rows], dtype=np.int32).reshape(len(rows), -1)
            for i in range(4)
        )
        zero = np.zeros(len(rows), dtype=np.int32)
        return Games(position, active, np.zeros_like(position), goal, zero, zero, exits)

    def mean(self, values: dict[State, float]) -> float:
        return sum(self.starts[state] * value for state, value in values.items())


MIXED = {
    "chaser": Rewards(step=-0.1, capture=1.0, escape=-2.0, touch=0.3),
    "evader": Rewards(step=0.2, capture=-1.5, escape=1.0, goal=0.7),
}
TWO: dict[str, Any] = {"num_chasers": 2, "num_evaders": 1}
DUEL: dict[str, Any] = {"num_chasers": 1, "num_evaders": 1}
GAMES: dict[str, dict[str, Any]] = {
    "adjacent, n_catch": {"maze": SQUARE, **TWO, "capture": "adjacent", "n_catch": 2},
    "adjacent, block": {"maze": ROOM, **DUEL, "capture": "adjacent", "collisions": "block"},
    "n_catch": {"maze": SQUARE, **TWO, "n_catch": 2, "stay_action": True},
    "n_catch, chasers first": {
        "maze": SQUARE, **TWO, "n_catch": 2, "move_order": "chasers_first", "slip": {"evader": 0.3},
    },
    "surround": {"maze": SQUARE, **TWO, "capture": "surround", "stay_action": True},
    "surround, block, after chasers": {
        "maze": SQUARE, **TWO, "capture": "surround", "collisions": "block", "stay_action": True,
        "move_order": "chasers_first", "capture_check": "after_chasers",
    },
    "exits": {"maze": ROOM, **DUEL, "exits": [0, 5], "rewards": "win_loss"},
    "drawn exits": {"maze": SQUARE, **DUEL, "num_exits": 2, "rewards": "goal"},
    "drawn exits, two evaders": {
        "maze": SQUARE, "num_chasers": 1, "num_evaders": 2, "num_exits": 1, "rewards": "win_loss",
        "collisions": "block",
    },
    "exits, goals": {"maze": ROOM, **DUEL, "exits": [5], "num_goals": 1, "rewards": MIXED},
    "slips": {"maze": ROOM, **DUEL, "slip": {"chaser": 0.3, "evader": 0.1}, "rewards": "zero_sum"},
    "slips, block": {
        "maze": SQUARE, **TWO, "slip": 0.4, "collisions": "block", "capture": "adjacent",
        "n_catch": 2, "rewards": MIXED,
    },
    "turns": {"maze": LOOP, **DUEL, "move_order": "turns", "rewards": "zero_sum"},
    "turns, exits, slips": {
        "maze": ROOM, **DUEL, "move_order": "turns", "exits": [0], "slip": 0.25, "rewards": MIXED,
    },
    "turns, drawn exits, after chasers": {
        "maze": SQUARE, **DUEL, "move_order": "turns", "num_exits": 1, "rewards": "win_loss",
        "capture_check": "after_chasers",
    },
    "turns, two chasers, block": {
        "maze": SQUARE, **TWO, "move_order": "turns", "capture": "adjacent", "n_catch": 2,
        "collisions": "block", "rewards": "goal",
    },
}  # fmt: skip


@lru_cache(maxsize=2)
def model_of(name: str) -> Model:
    settings = GAMES[name]
    return Model(Task(**{"stay_action": settings.get("move_order") == "turns", **settings}))


def compare(response: Any, model: Model, expected: dict[State, float]) -> None:
    wanted = list(expected.values())
    np.testing.assert_allclose(response.values_of(model.games()), wanted, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(response.mean_over_starts, model.mean(expected), rtol=1e-9)


@pytest.mark.parametrize("role", ["chaser", "evader"])
@pytest.mark.parametrize("name", GAMES)
def test_best_responses_are_those_of_brute_force(name: str, role: str) -> None:
    model = model_of(name)
    task, seats, policy = model.task, model.seats(role), Whimsical()
    other = {"chaser": "evader", "evader": "chaser"}[role]
    for horizon, discount in ((3, 1.0), (2, 0.7)):
        best = solve_joint(task, role, {other: policy}, horizon, discount, "return")
        compare(best, model, model.solve(seats, model.returns(seats), np.max, horizon, discount))
    if not task.num_goals:
        pick = np.min if role == "chaser" else np.max
        best = solve_joint(task, role, {other: policy}, 3, 0.9, "steps")
        rounds = model.rounds(seats if role == "evader" else list(range(task.num_agents)))
        compare(best, model, model.solve(seats, rounds, pick, 3, 0.9))


@pytest.mark.parametrize("name", GAMES)
def test_values_of_policies_are_those_of_brute_force(name: str) -> None:
    model = model_of(name)
    task, policies = model.task, {"chaser": Whimsical(), "evader": Whimsical()}
    for horizon, discount in ((4, 1.0), (3, 0.8)):
        values = evaluate_joint(task, policies, horizon, discount)
        every = list(range(task.num_agents))

        def mean(pays: Any, horizon: int = horizon, discount: float = discount) -> float:
            return model.mean(model.solve([], pays, float, horizon, discount))

        assert values.length == pytest.approx(mean(model.rounds(every)))
        assert values.ended == pytest.approx(mean(model.ends))
        for seat, agent in enumerate(task.agent_names):
            assert values.returns[agent] == pytest.approx(mean(model.returns([seat])))
            assert values.steps[agent] == pytest.approx(mean(model.rounds([seat])))


@pytest.mark.parametrize("name", ["drawn exits", "slips", "turns, exits, slips", "exits, goals"])
def test_nash_conv_is_the_sum_of_the_gains_of_brute_force(name: str) -> None:
    model = model_of(name)
    result = joint_nash_conv(model.task, {"chaser": Whimsical(), "evader": Whimsical()}, 3, 0.9)
    for seat, agent in enumerate(model.task.agent_names):
        best, fixed = (
            model.mean(model.solve(deciding, model.returns([seat]), pick, 3, 0.9))
            for deciding, pick in (([seat], np.max), ([], float))
        )
        assert result.gains[agent] == pytest.approx(best - fixed)


# -- equilibria ------------------------------------------------------------------------------------


def equilibrium_values(model: Model, discount: float, sweeps: int) -> dict[State, float]:
    """The lead of the chaser from the starts, by Shapley's iteration."""
    values = np.zeros(len(model.steps) + 1)

    def lead(state: State, rewards: Any, after: Any) -> Any:
        return rewards[:, 0] - rewards[:, 1]

    for _ in range(sweeps):
        fresh = np.zeros_like(values)
        for state in model.steps:
            worth = model.worth(state, lead, values, discount)
            if worth.ndim == 1:
                number = worth.max() if model.steps[state][0] == [0] else worth.min()
            else:
                number = matrix_value(worth)
            fresh[model.numbers[state]] = number
        values = fresh
    return {state: float(values[model.numbers[state]]) for state in model.starts}


EQUILIBRIA: dict[str, dict[str, Any]] = {
    "adjacent, block": {"maze": ROOM, "capture": "adjacent", "collisions": "block"},
    "exits, slips": {"maze": LINE, "exits": [0], "slip": 0.2, "rewards": "win_loss"},
    "drawn exits": {"maze": SQUARE, "num_exits": 1, "rewards": "win_loss"},
    "slip of one": {"maze": SQUARE, "slip": {"evader": 0.5}, "rewards": "zero_sum"},
    "turns": {"maze": LOOP, "move_order": "turns", "rewards": "zero_sum"},
    "turns, slips, exits": {
        "maze": ROOM, "move_order": "turns", "slip": {"chaser": 0.3}, "exits": [0, 5],
    },
}  # fmt: skip


@pytest.mark.parametrize("name", EQUILIBRIA)
def test_equilibria_are_those_of_brute_force(name: str) -> None:
    settings = EQUILIBRIA[name]
    task = Task(**DUEL, stay_action="move_order" in settings, **settings)
    model, discount = Model(task), 0.3
    solved = solve_joint_game(task, discount)
    expected = equilibrium_values(model, discount, 32 if model.turns else 16)
    numbers = solved.states.numbers(model.games())
    np.testing.assert_allclose(solved.values[numbers], list(expected.values()), atol=1e-6)
    assert solved.mean_over_starts == pytest.approx(model.mean(expected), abs=1e-6)


@pytest.mark.parametrize(("maze", "captured"), [("3x3-tree", True), (LOOP, False)], ids=str)
def test_equilibria_in_turns_have_the_capture_times_of_cops_and_robbers(
    maze: Any, captured: bool
) -> None:
    """The return of `zero_sum` in t rounds is minus 1 + d + ... + d**(t - 1)."""
    task = Task(maze, **DUEL, move_order="turns", stay_action=True, rewards="zero_sum")
    solved, times = solve_joint_game(task, 0.9), solve_in_turns(task.mazes[0]).times
    assert times is not None
    model = Model(task)
    for state, number in zip(
        model.starts, solved.states.numbers(model.games()).tolist(), strict=True
    ):
        time = int(times[state.cells])
        assert time != NEVER or not captured
        rounds = np.inf if time == NEVER else time
        wanted = -2.0 * (1.0 - 0.9**rounds) / (1.0 - 0.9)
        assert solved.values[number] == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(("maze", "chasers"), [("2x2", 2), (LOOP, 2), ("3x3-tree", 1)], ids=str)
def test_best_play_of_a_team_in_turns_attains_the_capture_time(maze: Any, chasers: int) -> None:
    """Against any evader, the best response needs no more rounds than the worst case."""
    task = Task(maze, chasers, 1, move_order="turns", stay_action=True)
    times = solve_in_turns(task.mazes[0], chasers).times
    assert times is not None
    best = solve_joint(task, "chaser", {"evader": Whimsical()}, 50, 1.0, "steps")
    games, real = best.states.games(0, best.states.count)
    chosen = np.flatnonzero(real & (games.steps == 0))
    limits = times[tuple(games.position[chosen].T)]
    assert (best.values[chosen] <= limits + 1e-9).all() and (best.values[chosen] >= 1.0).all()
