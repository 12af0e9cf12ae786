"""Whole games solved exactly, against brute force over the rules in words, in dictionaries."""

from __future__ import annotations

import itertools
import zlib
from typing import Any

import numpy as np
import pytest
from reference_rules import Game, drawn, role_of
from reference_rules import step as step_by_words

from pursuit.tasks.task import Task, make_task
from scripted_agents import solve_joint


def key_of(task: Task, game: Game) -> Any:
    """What a state is: who is free and where, and where goals are, by numbers of cells."""
    numbers = {place: cell for cell, place in enumerate(drawn(task.mazes[0].to_text())[0])}
    free = {a: numbers[game.places[a]] for a in task.agent_names if a in game.active}
    return tuple(free.items()), tuple(sorted(numbers[place] for place in game.goals.values()))


def whim(key: Any, agent: str, actions: int) -> Any:
    """Some distribution that depends on all that is in a state, with actions never taken."""
    rng = np.random.default_rng(zlib.crc32(repr((key, agent)).encode()))
    weights = rng.random(actions) * (rng.random(actions) < 0.7)
    weights[rng.integers(actions)] += 0.1
    return weights / weights.sum()


class Whimsical:
    """Plays by `whim`."""

    def act(self, view: Any) -> Any:
        table = self.distribution(view.task, view.games, view.seat).cumsum(axis=1)
        return (view.uniform()[:, None] >= table[:, :-1]).sum(axis=1).astype(np.int32)

    def distribution(self, task: Task, games: Any, seat: int) -> Any:
        rows = []
        for game in range(len(games.steps)):
            free = [
                (name, int(games.position[game, at]))
                for at, name in enumerate(task.agent_names)
                if games.active[game, at]
            ]
            goals = tuple(sorted(int(cell) for cell in games.goal[game] if cell >= 0))
            rows.append(whim((tuple(free), goals), task.agent_names[seat], task.num_actions))
        return np.array(rows)


def all_games(task: Task) -> Any:
    """Every state that can stand between two steps, as games of the rules in words."""
    maze, names = task.mazes[0], task.agent_names
    cells = drawn(maze.to_text())[0]
    evaders = [name for name in names if role_of(name) == "evader"]
    for caught in itertools.product((False, True), repeat=len(evaders)):
        free = [n for n in names if n not in evaders or not caught[evaders.index(n)]]
        if evaders and not any(role_of(name) == "evader" for name in free):
            continue
        for places in itertools.product(cells, repeat=len(free)):
            where = {name: cells[0] for name in names} | dict(zip(free, places, strict=True))
            hunted = {where[name] for name in free if role_of(name) == "evader"}
            if hunted & {where[name] for name in free if role_of(name) == "chaser"}:
                continue
            taking = hunted | {where[name] for name in free if role_of(name) == "runner"}
            sizes = range(1, task.num_goals + 1) if task.num_goals else [0]
            for size in sizes:
                for goals in itertools.combinations(cells, size):
                    if not taking & set(goals):
                        yield Game(maze, where, frozenset(free), dict(enumerate(goals)))


def all_steps(task: Task) -> Any:
    """{state: {actions of who is free: rewards, and the next state, None for the end}}."""
    found: dict[Any, Any] = {}
    for game in all_games(task):
        free = [name for name in task.agent_names if name in game.active]
        here = found.setdefault(key_of(task, game), {})
        for joint in itertools.product(range(task.num_actions), repeat=len(free)):
            does = dict(zip(free, joint, strict=True))
            out = step_by_words(game, does, task.role_rewards, task.move_order, 10**9)
            here[joint] = out.rewards, None if out.terminated else key_of(task, out.game)
    return found


def by_hand(
    task: Task, steps: Any, deciding: tuple[str, ...], objective: str, horizon: int, discount: float
) -> dict[Any, float]:
    """{state: what is to come} by backward induction over plain dictionaries."""
    best_of: Any = max
    if objective == "steps" and "evader" not in {role_of(name) for name in deciding}:
        best_of = min
    options: dict[Any, dict[Any, list[Any]]] = {}
    for key, here in steps.items():
        found: dict[Any, list[Any]] = {}
        free = [name for name, _ in key[0]]
        chances = {n: whim(key, n, task.num_actions) for n in free if n not in deciding}
        for joint, (rewards, after) in here.items():
            does = dict(zip(free, joint, strict=True))
            chance = float(np.prod([chances[name][does[name]] for name in chances]))
            if chance > 0.0:
                worth = float(any(name in free for name in deciding))
                if objective == "return":
                    worth = sum(rewards[name] for name in deciding)
                ours = tuple(does.get(name) for name in deciding)
                found.setdefault(ours, []).append((chance, worth, after))
        options[key] = found
    values = dict.fromkeys(options, 0.0)
    values[None] = 0.0
    for _ in range(horizon):
        values = {
            key: best_of(
                sum(chance * (worth + discount * values[after]) for chance, worth, after in led_to)
                for led_to in found.values()
            )
            for key, found in options.items()
        } | {None: 0.0}
    return values


def as_dictionary(response: Any) -> dict[Any, float]:
    """{state: value} of a solution, for every state that can be."""
    task, found = response.states.task, {}
    names, count = task.agent_names, response.states.count
    games, real = response.states.games(0, count)
    for number in np.flatnonzero(real).tolist():
        free = [(n, int(games.position[number, i])) for i, n in enumerate(names)]
        free = [pair for i, pair in enumerate(free) if games.active[number, i]]
        goals = tuple(int(cell) for cell in games.goal[number] if cell >= 0)
        found[tuple(free), goals] = float(response.values[number])
    return found


SMALL = {
    "two chasers": make_task("chase", maze="2x2", num_chasers=2),
    "two chasers, in turn": make_task(
        "chase", maze="2x2", num_chasers=2, move_order="chasers_first"
    ),
    "two evaders": make_task("chase", maze="2x2", num_evaders=2),
    "two evaders, in turn": make_task(
        "chase", maze="2x2", num_evaders=2, move_order="chasers_first", stay_action=True
    ),
    "race": make_task("race", maze="2x2", num_goals=2),
    "race to completion": make_task(
        "race", maze="2x2", num_goals=2, rewards="completion", stay_action=True
    ),
    "heist": make_task("heist", maze="2x2", num_goals=2),
    "heist, in turn": make_task("heist", maze="2x2", num_goals=2, move_order="chasers_first"),
    "all at once": Task(
        maze="2x2", num_chasers=1, num_evaders=1, num_runners=1, num_goals=1, rewards="distance"
    ),
}
LARGER = {
    "two chasers": make_task("chase", maze="3x3", num_chasers=2),
    "two evaders": make_task("chase", maze="3x3", num_evaders=2, move_order="chasers_first"),
    "race": make_task("race", maze="3x3", num_goals=2),
    "heist": make_task("heist", maze="3x3", num_goals=2),
}


def zero_sum_steps(task: Task) -> Any:
    """As `all_steps`, paid by the definition of `zero_sum` without goals."""
    found = all_steps(task)
    for key, here in found.items():
        free = {name for name, _ in key[0] if role_of(name) == "evader"}
        paid = {n: 1.0 if n in free else -1.0 * len(free) for n in task.agent_names}
        paid |= {n: 0.0 for n in task.agent_names if role_of(n) == "evader" and n not in free}
        found[key] = {joint: (paid, after) for joint, (_, after) in here.items()}
    return found


def compare_with_brute_force(task: Task, steps: Any = None) -> None:
    """Every agent by itself, and every side, in both objectives."""
    steps = steps or all_steps(task)
    teams: list[tuple[str, ...]] = [(name,) for name in task.agent_names]
    for role in dict.fromkeys(task.seat_roles):
        teams.append(tuple(name for name in task.agent_names if role_of(name) == role))
    for team in dict.fromkeys(teams):
        others = {name: Whimsical() for name in task.agent_names if name not in team}
        for objective, horizon, discount in (("steps", 5, 1.0), ("return", 6, 0.8)):
            if objective == "steps" and task.num_goals and task.num_evaders:
                continue
            found = solve_joint(task, team, others, horizon, discount, objective)  # type: ignore[arg-type]
            truth = by_hand(task, steps, team, objective, horizon, discount)
            del truth[None]
            mine = as_dictionary(found)
            assert mine.keys() == truth.keys()
            np.testing.assert_allclose(
                [mine[key] for key in truth], list(truth.values()), atol=1e-6
            )


QUICK = ("two chasers", "two evaders", "race", "heist, in turn")


@pytest.mark.parametrize("name", QUICK)
def test_best_responses_are_those_of_brute_force_over_the_rules_in_words(name: str) -> None:
    compare_with_brute_force(SMALL[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SMALL if name not in QUICK])
def test_so_are_they_in_other_games(name: str) -> None:
    compare_with_brute_force(SMALL[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGER)
def test_so_are_they_in_larger_mazes(name: str) -> None:
    compare_with_brute_force(LARGER[name])


@pytest.mark.parametrize(
    ("chasers", "evaders"), [(2, 1), (1, 2), pytest.param(2, 2, marks=pytest.mark.slow)]
)
def test_zero_sum_pays_by_the_evaders_that_were_free(chasers: int, evaders: int) -> None:
    task = make_task(
        "chase", maze="2x2", num_chasers=chasers, num_evaders=evaders, rewards="zero_sum"
    )
    compare_with_brute_force(task, zero_sum_steps(task))
