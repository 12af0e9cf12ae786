"""Seats of one policy that act together: each does what it does alone, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from game_rows import rows_of
from numpy.typing import NDArray
from test_scripted_agents import Plain

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze
from pursuit.simulator.policy import GameView, Policy, play
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    RandomAgent,
    SearchingChaser,
    TourRunner,
    WaryEvader,
)
from scripted_agents.agents import known_kernels
from scripted_agents.agents.scripted import is_known_team

CHASER, EVADER = AStarChaser(0.2), AStarEvader(0.3, alert_distance=4)
RUNNER = NearestGoalRunner(0.1)
RANDOM = RandomAgent()
ROLES = {"chaser": CHASER, "evader": EVADER, "runner": RUNNER}
PARTS = Maze.from_text(
    "+-+-+-+-+\n|     | |\n+ + + + +\n|     | |\n+ + + + +\n|     |#|\n+-+-+-+-+"
)
LARGE = generate_maze("prim", 70, loops=0.3, seed=4)
CROWD = generate_maze("prim", 7, loops=0.3, seed=4)


@dataclass(frozen=True)
class Case:
    """A task, and who fills its seats: the agents of the roles where nobody is named."""

    task: dict[str, Any]
    policies: Sequence[Any] = ()
    tables: bool = True
    games: int = 12
    steps: int = 60


def team(chasers: int, evaders: int, maze: Any = "5x5", **rules: Any) -> dict[str, Any]:
    return {"maze": maze, "num_chasers": chasers, "num_evaders": evaders, **rules}


FIRST, STAY = {"move_order": "chasers_first"}, {"stay_action": True}
CASES = {
    "1v1": Case(team(1, 1)),
    "1v3": Case(team(1, 3)),
    "3v1": Case(team(3, 1, **FIRST)),
    "2v2": Case(team(2, 2, **FIRST, **STAY)),
    "8v8": Case(team(8, 8, "7x7")),
    "8v8, chasers first": Case(team(8, 8, "7x7", **FIRST)),
    "a crowd": Case(team(20, 24, CROWD), games=4),  # more pairs than are looked up one by one
    "a crowd, chasers first": Case(team(24, 20, CROWD, **FIRST, **STAY), games=4),
    "cells without paths": Case(team(3, 3, PARTS)),
    "several mazes": Case(team(3, 3, ("3x3", "5x5", PARTS))),
    "goals": Case(team(2, 2, num_runners=3, num_goals=4)),
    "random": Case(team(3, 3), [RANDOM] * 3 + [EVADER, RANDOM, RANDOM]),
    "some for others": Case(team(3, 3), [CHASER, None, CHASER, EVADER, RANDOM, EVADER]),
    "two policies of a kind": Case(team(4, 2), [CHASER, AStarChaser()] * 2 + [EVADER] * 2),
    "tours": Case({"maze": "5x5", "num_runners": 3, "num_goals": 5}, [TourRunner(0.1)] * 3),
    "limited sight": Case(
        team(3, 3, view_radius=2),
        [SearchingChaser(0.1), CHASER, CHASER, EVADER, WaryEvader(), EVADER],
    ),
    "large": Case(team(3, 1, LARGE, num_runners=3, num_goals=4), games=4, steps=45),
    "no tables": Case(team(3, 3), tables=False),
    "no tables, chasers first": Case(team(1, 3, **FIRST, **STAY), tables=False),
    "no tables, without paths": Case(team(3, 3, PARTS), tables=False),
    "tables for some": Case(team(3, 3, ("3x3", "5x5")), tables=False),
    "no tables, goals": Case(team(2, 2, num_runners=3, num_goals=4), tables=False),
}


def one_by_one(
    policies: Sequence[Policy | None], actions: NDArray[np.int32], games: Simulator
) -> None:
    for seat, policy in enumerate(policies):
        if policy is not None:
            actions[:, seat] = play(policy, games.view(seat))


def begun(case: Case) -> tuple[Simulator, list[Policy | None]]:
    """The games with an epsilon for each seat of each game, for some that of the agent."""
    task = Task(**{"max_steps": 40, **case.task})
    games = Simulator(task, case.games, seed=5, first_game=2)
    shares = np.random.default_rng(3).random((case.games, task.num_agents))
    games.epsilon = np.where(shares < 0.4, np.nan, np.where(shares < 0.6, 0.0, shares))
    return games, list(case.policies) or [ROLES[role] for role in task.seat_roles]


LONG = ("8v8", "several mazes", "cells without paths", "two policies of a kind")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in CASES]
)
def test_together_they_do_what_each_does_alone(
    name: str, without_tables: Callable[[], None]
) -> None:
    case = CASES[name]
    if not case.tables:
        without_tables()
    (games, policies), (others, _) = begun(case), begun(case)
    shape, captured = (case.games, games.num_agents), 0
    drawn = np.random.default_rng(1).integers(0, 4, (case.steps, *shape), dtype=np.int32)
    for actions in drawn:
        alone = actions.copy()
        games.act(policies, actions)
        one_by_one(policies, alone, others)
        np.testing.assert_array_equal(actions, alone)
        np.testing.assert_array_equal(games.streams, others.streams)
        games.step(actions)
        others.step(alone)
        np.testing.assert_array_equal(rows_of(games), rows_of(others))
        captured += int((games.active == 0).sum())
    assert captured or games.task.num_evaders < 2


@pytest.mark.parametrize("tables", [True, False])
@pytest.mark.parametrize("size", [(24, 24), (4, 4)])
def test_teams_choose_from_the_moves_of_the_definition(
    size: tuple[int, int], tables: bool, without_tables: Callable[[], None]
) -> None:
    """Few look whom they seek up one by one, many in one search: both against plain graphs."""
    maze = Maze.from_text(CROWD.to_text())
    plain = Plain(maze, stay=True)
    if not tables:
        without_tables()
    chasers, evaders = size
    runners = 5 if size == (4, 4) else 0
    task = Task(**team(chasers, evaders, maze), **STAY, num_runners=runners, num_goals=runners)
    games = Simulator(task, 6, seed=1)
    free = np.random.default_rng(2).random((6, evaders)) < 0.7
    games.active[:, chasers : chasers + evaders] = free
    agents = {"chaser": AStarChaser(), "evader": AStarEvader(), "runner": NearestGoalRunner()}
    seen = np.zeros((6, task.num_agents), dtype=np.int32)
    games.act([agents[role] for role in task.seat_roles], seen)
    for cells, active, goals, chosen in zip(
        games.positions.tolist(), games.active, games.goals.tolist(), seen.tolist(), strict=True
    ):
        prey = [cells[seat] for seat in range(chasers, chasers + evaders) if active[seat]]
        for seat in np.flatnonzero(active):
            own, role = cells[seat], task.seat_roles[seat]
            if role == "evader":
                expected = plain.fleeing(own, cells[:chasers])
            else:
                expected = plain.towards(own, prey if role == "chaser" else goals)
            assert chosen[seat] in expected, (task.agent_names[seat], own, cells)


@pytest.mark.parametrize("team_size", [2, 4])  # who is captured is looked at in 2v2, not in 4v4
def test_teams_with_few_or_nobody_left_to_chase(team_size: int) -> None:
    task = Task(**team(team_size, team_size, "7x7"))
    games, others = (Simulator(task, 40, seed=2, auto_restart=False) for _ in range(2))
    free = np.random.default_rng(2).random((40, team_size)) < 0.3
    assert not free.any(axis=1).all()
    for simulator in (games, others):
        simulator.active[:, team_size:] = free
    policies = [ROLES[role] for role in task.seat_roles]
    together, alone = np.zeros((2, 40, task.num_agents), dtype=np.int32)
    games.act(policies, together)
    one_by_one(policies, alone, others)
    np.testing.assert_array_equal(together, alone)


def test_how_many_are_known_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A team by the kernel for exactly so many, and by the one for any number."""
    case = Case(team(3, 3, "7x7"))
    (games, policies), (others, _) = begun(case), begun(case)
    assert is_known_team(CHASER.kind, games.view(0), (0, 1, 2))
    shape = (case.games, games.num_agents)
    known, general = np.zeros((2, *shape), dtype=np.int32)
    for _ in range(case.steps):
        games.act(policies, known)
        with monkeypatch.context() as patch:
            patch.setattr(known_kernels, "MOST_KNOWN", 0)
            others.act(policies, general)
        np.testing.assert_array_equal(known, general)
        games.step(known)
        others.step(general)
    np.testing.assert_array_equal(games.streams, others.streams)


@pytest.mark.parametrize("seats", [(0, 2), (1, 0), (0, 0)])
def test_seats_that_are_no_neighbours_are_no_known_team(seats: tuple[int, ...]) -> None:
    games = Simulator(Task(**team(3, 2)), 5)
    assert not is_known_team(CHASER.kind, games.view(seats[0]), seats)
    assert not is_known_team(RUNNER.kind, games.view(0), (0, 1))


class Northward:
    """Whoever has it goes north, whatever else it inherits."""

    def act(self, view: GameView) -> NDArray[np.int32]:
        return np.zeros(view.num_games, dtype=np.int32)


class NorthernChaser(Northward, AStarChaser):
    """Acts in a way that it inherits."""


class Beginner(AStarChaser):
    """Counts its episodes."""

    begun = 0

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        self.begun += len(games)


def test_who_acts_in_a_way_of_its_own_is_asked_seat_by_seat() -> None:
    games, actions = Simulator(Task(**team(2, 1)), 5), np.ones((5, 3), dtype=np.int32)
    games.act([NorthernChaser()] * 2 + [None], actions)
    assert actions.tolist() == [[0, 0, 1]] * 5
    beginner = Beginner()
    games.act([beginner, beginner, EVADER], actions)
    assert beginner.begun == 2 * 5


def test_a_policy_of_ones_own_may_act_together() -> None:
    class Numbered(Northward):
        def act_together(
            self, view: GameView, seats: tuple[int, ...], actions: NDArray[np.int32]
        ) -> None:
            actions[:, seats] = seats

    games, actions = Simulator(Task(**team(2, 2)), 3), np.zeros((3, 4), dtype=np.int32)
    several = Numbered()
    games.act([several, None, several, several], actions)
    assert actions.tolist() == [[0, 0, 2, 3]] * 3
