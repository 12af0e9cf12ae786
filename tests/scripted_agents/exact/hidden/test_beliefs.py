"""Beliefs of where an evader is: against a filter of plain numpy, and against games."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit import Simulator, Task, load_maze, make_task
from pursuit.simulator.policy import MemoryPolicy, pairs_of_cells, play
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    BeliefChaser,
    BeliefFilter,
    best_response,
    solve_hidden_chase,
)

EVADER = AStarEvader(epsilon=0.3)


def plain_filter(
    task: Task, own: list[int], seen: list[int], radius: int, role: str
) -> NDArray[np.float64]:
    """The belief after these own cells, in each of which the other was seen in a cell, or not (-1):
    the whole joint of cells, summed over all that the other may have done."""
    maze = task.mazes[0]
    cells, distances = maze.num_cells, maze.distances
    other = EVADER if role == "chaser" else AStarChaser(epsilon=0.3)
    table = other.action_probabilities(maze, task.stay_action)
    belief = (distances[own[0]] >= task.min_start_distance).astype(float)
    for t, here in enumerate(own):
        if t:
            after = np.zeros(cells)
            before = own[t - 1]
            for theirs in range(cells):
                for action in range(task.num_actions):
                    then = maze.neighbors[theirs, action]
                    if task.move_order == "simultaneous":
                        caught = here == then or (here == theirs and then == before)
                    elif role == "chaser":
                        caught = here in (theirs, then)
                    else:
                        caught = then in (before, here)
                    if not caught:
                        after[then] += belief[theirs] * table[theirs, before, action]
            belief = after
        out_of_view = distances[here] > radius
        belief = np.eye(cells)[seen[t]] if seen[t] >= 0 else belief * out_of_view
        belief = belief / belief.sum()
    return belief


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_the_filter_equals_a_plain_one(role: Any, order: str) -> None:
    task = make_task(
        "chase", maze="4x4", move_order=order, stay_action=True, min_start_distance=3, max_steps=25
    )
    other: Any = EVADER if role == "chaser" else AStarChaser(epsilon=0.3)
    radius, games = 1, 8
    filter_ = BeliefFilter(other, view_radius=radius)
    policies: Any = [AStarChaser(epsilon=0.8), EVADER]
    if role == "evader":
        policies = [AStarChaser(epsilon=0.3), AStarEvader(epsilon=0.8)]
    simulator = Simulator(task, games, seed=3)
    view, seat = simulator.view(role), task.seat(role)
    distances = task.mazes[0].distances
    own: list[list[int]] = [[] for _ in range(games)]
    seen: list[list[int]] = [[] for _ in range(games)]
    actions = np.zeros((games, 2), dtype=np.int32)
    unseen = 0
    for _ in range(40):
        filter_.begin(view, np.flatnonzero(view.steps == 0))
        belief, rows = filter_.update(view)
        again, _ = filter_.update(view)
        assert (belief == again).all()
        for game in range(games):
            if view.steps[game] == 0:
                own[game], seen[game] = [], []
            here, theirs = view.positions[game, seat], view.positions[game, 1 - seat]
            own[game].append(int(here))
            seen[game].append(int(theirs) if distances[here, theirs] <= radius else -1)
            unseen += seen[game][-1] < 0
            expected = plain_filter(task, own[game], seen[game], radius, role)
            np.testing.assert_allclose(belief[rows[game]], expected, atol=1e-12)
            assert belief[rows[game], theirs] > 0
        simulator.act(policies, actions)
        simulator.step(actions)
    assert unseen > 80


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
@pytest.mark.parametrize("response", ["most_likely", "expected"])
def test_with_everything_in_view_it_is_the_best_response(response: Any, order: Any) -> None:
    task = make_task("chase", maze="4x4", move_order=order, stay_action=True)
    maze, size = task.mazes[0], task.max_cells
    table = EVADER.action_probabilities(maze, True)
    best = best_response("chaser", maze, table, None, 0.95, move_order=order)
    later = best.values
    chaser = BeliefChaser(EVADER, response)  # without limits of its own it sees what the task lets
    games = pairs_of_cells(task, maze, "chaser")
    simulator = Simulator(task, size * size, seed=1, auto_restart=False)
    simulator.positions[:] = games.position
    for _ in range(5):  # drawn among all that are best
        simulator.steps[:] = 0
        actions = play(chaser, simulator.view("chaser"))
        for game in np.flatnonzero(games.position[:, 0] != games.position[:, 1]):
            own, other = games.position[game]
            mine, expected = maze.neighbors[own, actions[game]], 1.0
            for reply in range(5):
                theirs = maze.neighbors[other, reply]
                caught = mine == theirs or (mine == other and (theirs == own or order[0] == "c"))
                expected += 0.0 if caught else 0.95 * table[other, own, reply] * later[mine, theirs]
            assert expected == pytest.approx(best.values[own, other], rel=1e-7)
            if best.actions[own, other] != actions[game]:
                assert expected <= best.values[own, other] * (1 + 1e-7)


def test_it_answers_what_it_believes() -> None:
    task = make_task("chase", maze="5x5")
    maze = task.mazes[0]
    table = EVADER.action_probabilities(maze)
    best = best_response("chaser", maze, table, None, 0.95)
    worth = np.ones((25, 25, 4))
    for own in range(25):
        for other in range(25):
            for action, reply in np.ndindex(4, 4):
                mine, theirs = maze.neighbors[own, action], maze.neighbors[other, reply]
                if mine != theirs and (mine != other or theirs != own):
                    chance = table[other, own, reply]
                    worth[own, other, action] += 0.95 * chance * best.values[mine, theirs]
    policies: dict[str, Any] = {
        response: BeliefChaser(EVADER, response, view_radius=1)  # type: ignore[arg-type]
        for response in ("expected", "most_likely")
    }
    simulator = Simulator(task, 60, seed=5)
    view, actions = simulator.view("chaser"), np.zeros((60, 2), dtype=np.int32)
    for _ in range(60):
        simulator.act([policies["expected"], EVADER], actions)
        answers = play(policies["most_likely"], view)
        belief, rows = policies["expected"].filter.update(view)
        expected = np.einsum("ge,gea->ga", belief[rows], worth[view.positions[:, 0]])
        chosen = expected[np.arange(60), actions[:, 0]]
        np.testing.assert_allclose(chosen, expected.min(axis=1), rtol=1e-7)
        for game, own in enumerate(view.positions[:, 0]):
            likely = np.flatnonzero(belief[game] >= belief[game].max() * (1 - 1e-9))
            of = worth[own, likely]
            assert (of[:, answers[game]] <= of.min(axis=1) * (1 + 1e-7)).any()
        simulator.step(actions)


def test_a_belief_is_right_about_games() -> None:
    """The share of games in which the evader is where it is believed with probability p is p."""
    task = make_task("chase", maze="4x4", view_radius={"chaser": 1})
    filter_, policies = BeliefFilter(EVADER), [AStarChaser(epsilon=1.0), EVADER]
    simulator = Simulator(task, 20_000, seed=9)
    view, actions = simulator.view("chaser"), np.zeros((20_000, 2), dtype=np.int32)
    for _ in range(6):
        filter_.begin(view, np.flatnonzero(view.steps == 0))
        belief, rows = filter_.update(view)
        simulator.act(policies, actions)
        kept = belief[rows].copy(), view.positions[:, 1].copy()
        simulator.step(actions)
    believed, theirs = kept
    there = np.eye(16)[theirs]
    for low, high in ((0.01, 0.1), (0.1, 0.2), (0.2, 0.35), (0.35, 0.7)):
        of = (believed >= low) & (believed < high)
        error = np.sqrt(believed[of].mean() / of.sum())
        assert of.sum() > 300 and abs(there[of].mean() - believed[of].mean()) < 4 * error


def test_only_exact_opponents_are_believed_in() -> None:
    assert isinstance(BeliefChaser(), MemoryPolicy)
    for wrong in ({"response": "worst"}, {"discount": 0.0}, {"view_radius": -1}, {"epsilon": 2}):
        with pytest.raises(ValueError):
            BeliefChaser(EVADER, **wrong)


@pytest.mark.slow
def test_the_filter_agrees_with_that_of_certified_policies() -> None:
    solution = solve_hidden_chase(
        "3x3", EVADER.action_probabilities(load_maze("3x3")), 1, seconds=2
    )
    certified, filter_ = solution.policy, BeliefFilter(EVADER, view_radius=1)
    task = make_task("chase", maze="3x3", view_radius={"chaser": 1}, max_steps=40)
    simulator = Simulator(task, 50, seed=4)
    view, actions = simulator.view("chaser"), np.zeros((50, 2), dtype=np.int32)
    for _ in range(60):
        filter_.begin(view, np.flatnonzero(view.steps == 0))
        belief, rows = filter_.update(view)
        simulator.act([certified, EVADER], actions)
        np.testing.assert_allclose(certified.memory.of(view)["belief"], belief[rows], atol=1e-9)
        simulator.step(actions)
