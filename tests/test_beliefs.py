"""Beliefs of where an evader is: against a filter of plain numpy, and against games."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pursuit import Simulator, Task, make_task
from scripted_agents import AStarChaser, AStarEvader
from scripted_agents.beliefs import BeliefFilter

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
    radius, games = 1, 12
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
    for _ in range(60):
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
    assert unseen > 200
