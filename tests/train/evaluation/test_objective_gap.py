"""The floor of a training objective against brute force, and where it is not known."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Rewards, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    RandomAgent,
    TourRunner,
    best_response,
    why_not_optimal,
)
from scripted_agents.exact.tours import objective
from scripted_agents.exact.tours.objective import tour_objective_gap
from train.evaluation.contest import GameContest
from train.evaluation.scores import optimality_gap
from train.teaching.optimum import optimum_of


def by_every_order(maze: Maze, num_goals: int, discount: float, most: int) -> float:
    """The same by all orders of all placements: the return of each, step by step."""
    long = short = 0
    for goals in itertools.combinations(range(maze.num_cells), num_goals):
        for start in set(range(maze.num_cells)) - set(goals):
            tours = []
            for order in itertools.permutations(goals):
                ways = [int(maze.distances[a, b]) for a, b in itertools.pairwise((start, *order))]
                times = np.cumsum(ways).tolist()
                paid = sum(
                    (1.0 if step in times else -0.1) * discount ** (step - 1)
                    for step in range(1, times[-1] + 1)
                )
                tours.append((paid, times[-1]))
            best = max(paid for paid, _ in tours)
            long += min(min(steps for paid, steps in tours if paid >= best - 1e-9), most)
            short += min(min(steps for _, steps in tours), most)
    return long / short - 1.0


@pytest.mark.parametrize(
    ("maze", "goals", "discount"), [("3x3", 4, 0.8), ("4x4", 3, 0.95), ("3x3-open", 2, 0.5)]
)
def test_the_floor_of_tours_is_that_of_every_order(maze: str, goals: int, discount: float) -> None:
    for most in (200, 7):
        expected = by_every_order(load_maze(maze), goals, discount, most)
        found = tour_objective_gap(load_maze(maze), goals, discount, max_steps=most)
        assert found == pytest.approx(expected, abs=1e-12)


def test_floors_as_the_documents_have_them() -> None:
    """0.49 % on 5x5 at 0.95, none at 0.99; 1.26 % with 5 goals."""
    maze = load_maze("5x5")
    found = [
        tour_objective_gap(maze, *given) for given in ((3, 0.95), (3, 0.99), (5, 0.95), (3, 1.0))
    ]
    assert found == pytest.approx([0.004907965, 0.0, 0.012559874, 0.0], abs=1e-9)


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_the_floor_of_a_duel_is_the_gap_of_a_discounted_best_response(
    role: Any, order: Any
) -> None:
    task = make_task("chase", maze="7x7", move_order=order)
    others: Any = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
    contest = GameContest(task, role, others, 2)
    floor, table = contest.objective_gap(0.8).gap, contest.opponent_table()
    policy = best_response(role, task.mazes[0], table, None, 0.8, None, order).policy

    class Discounted:
        def act(self, view: Any) -> Any:
            return policy[view.positions[:, view.seat], view.positions[:, 1 - view.seat]].argmax(1)

        def action_probabilities(self, maze: Maze, stay_action: bool = False) -> Any:
            return policy

    best = contest.optimal()
    assert best is not None and floor is not None
    gap = contest.score("discounted", Discounted()).mean_steps / best.mean_steps - 1.0
    # Of equally good policies the floor takes the best in steps, a best response the first.
    if role == "chaser":
        assert -1e-9 <= floor <= gap + 1e-9 and gap < floor + 0.002
    else:
        assert gap - 1e-9 <= floor <= 1e-9


def contest_of(name: str, role: str, **settings: Any) -> GameContest:
    others: Any = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
    task = make_task(name, **settings)
    return GameContest(task, role, {r: p for r, p in others.items() if r in task.seat_roles}, 2)


def test_rewards_that_pay_for_the_length_alone_have_no_floor() -> None:
    for rewards in ("completion", "zero_sum"):
        assert contest_of("maze", "runner", rewards=rewards).objective_gap(0.9).gap == 0.0


@pytest.mark.parametrize(
    ("name", "role", "settings"),
    [
        ("maze", "runner", {"rewards": "distance"}),
        ("maze", "runner", {"rewards": {"runner": Rewards(step=0.1, goal=1.0)}}),
        ("maze", "runner", {"maze": ["3x3", "5x5"]}),
        ("maze", "runner", {"start": "marks"}),
        ("maze", "runner", {"maze": "9x9", "num_goals": 12}),
        ("chase", "chaser", {"rewards": "distance"}),
        ("chase", "chaser", {"num_chasers": 2, "num_evaders": 2}),
        ("chase", "chaser", {"rewards": {"chaser": Rewards(step=0.1, capture=-1.0)}}),
        ("heist", "chaser", {}),
    ],
)
def test_where_a_floor_is_not_known_nothing_is_said(name: str, role: str, settings: Any) -> None:
    assert contest_of(name, role, **settings).objective_gap(0.95) == (None, None)


def test_nothing_is_said_of_what_masks_or_a_function_change() -> None:
    for name, role in (("chase", "chaser"), ("maze", "runner")):
        paid = contest_of(name, role, rewards=lambda before, actions, after: after.positions)
        assert paid.objective_gap(0.95) == (None, None)
    free = contest_of("chase", "chaser")
    assert free.objective_gap(0.95).gap is not None
    assert replace(free, mask_bumps=True).objective_gap(0.95) == (None, None)


@pytest.mark.parametrize(("name", "role"), [("maze", "runner"), ("chase", "chaser")])
def test_nothing_is_said_where_nothing_ahead_counts(name: str, role: str) -> None:
    contest = contest_of(name, role, maze="3x3")
    assert contest.objective_gap(0.0) == (None, None)
    assert contest.objective_gap(0.01).gap is not None


def test_what_would_take_too_long_or_too_much_memory_is_not_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    maze = load_maze("3x3")
    monkeypatch.setattr(objective, "MAX_TOUR_WORK", 10)
    assert tour_objective_gap(maze, 3, 0.95) is None
    with pytest.raises(ValueError, match="num_goals=9"):
        tour_objective_gap(maze, 9, 0.95)
    with pytest.raises(ValueError, match=r"discount=1\.5"):
        tour_objective_gap(maze, 3, 1.5)


def test_a_heuristic_tour_is_never_called_optimal() -> None:
    """Above 18 goals there is no optimum: not in results, not as what a curriculum goes by."""
    for goals in (3, 19):
        contest = contest_of("maze", "runner", maze="5x5", num_goals=goals)
        known = goals <= 18
        assert (contest.optimal() is not None) == known
        assert ("optimal" in [score.name for score in contest.baselines()]) == known
        assert (optimum_of(contest.task, "runner", {}) is not None) == known
        assert (why_not_optimal(contest.task, "runner") is None) == known


class OftenLost(TourRunner):
    """Walks the best tours, or from some starts into a wall for ever."""

    def act(self, view: GameView) -> NDArray[np.int32]:
        actions = super().act(view).copy()
        wall = (view.task.mazes[0].neighbors[:, :4] == np.arange(9)[:, None]).argmax(1)
        lost = view.goals.sum(axis=1) % 3 == 0  # the goals of a start do not change in this game
        actions[lost] = wall[view.positions[lost, view.seat]]
        return actions


def test_the_gap_of_the_solved_leaves_out_what_ran_out_of_time() -> None:
    task = make_task("maze", maze="3x3", num_goals=1, max_steps=50)
    contest = GameContest(task, "runner", {}, 300)
    score = contest.score("lost", OftenLost())
    assert 0.5 < score.success_rate < 0.8 and score.solved_gap == 0.0
    gap = optimality_gap(score, contest.optimal())
    assert gap is not None and gap > 1.0
    nearest = contest.score("random", RandomAgent())
    lengths, won = contest.play(RandomAgent())
    best = contest.optimal_lengths()
    assert best is not None
    assert nearest.solved_gap == pytest.approx(lengths[won].sum() / best[won].sum() - 1)
