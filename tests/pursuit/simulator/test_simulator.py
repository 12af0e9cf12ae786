"""The simulator of mazes: starts, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from game_rows import rows_of
from simulated import TASKS, play, refused

from pursuit.mazes.maze import Maze, load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import RandomAgent, TablePolicy, best_response


@pytest.mark.parametrize("auto_restart", [True, False])
def test_the_constructor_starts_every_game(auto_restart: bool) -> None:
    """A reset of one game does not change the others."""
    simulator = Simulator(TASKS["crowd"], 4, seed=1, auto_restart=auto_restart)
    seen = simulator.observe("positions")
    assert (seen[..., :-1] > 0).all() and simulator.active.all()
    rows = rows_of(simulator)
    simulator.reset(games=[0])
    np.testing.assert_array_equal(rows_of(simulator)[1:], rows[1:])
    assert len(np.unique(simulator.positions[1])) == 6
    play(simulator, 1)
    assert (simulator.steps[~simulator.ended] == 1).all()


# -- invalid input ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "actions",
    [
        [0, 1],
        [[0, 1]],
        [[0, 1, 2]] * 3,
        [[[0, 1]] * 3],
        [[0.0, 1.0]] * 3,
        [[True, False]] * 3,
        [["north", "south"]] * 3,
        [[0, 1], [0, 4], [0, 0]],
        [[0, 1], [0, 0], [-1, 0]],
        [[0, 1], [0, 0], [0, 2**32]],
        [[0, 1], [0, 0], [0, 2**63 - 1]],
        [[0, 1], [0, 0], [0, 2**64 - 1]],
        [[0, 1], [0, 0], [0, 2**70]],
        [[0, 1], [0, 0], [0, -(2**32)]],
        [[0, 1], [0, 0], [0]],
        None,
        np.full((3, 2), 255, dtype=np.uint8),
        np.full((3, 2), -1, dtype=np.int32),
    ],
    ids=lambda actions: repr(actions).replace("\n", ""),
)
def test_bad_actions_are_refused_and_nothing_moves(actions: Any) -> None:
    simulator = Simulator(TASKS["chase"], 3, seed=1)
    with refused(simulator):
        simulator.step(actions)


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int64, np.uint64, list, "F"])
def test_actions_of_every_integer_type_and_order_are_the_same(kind: Any) -> None:
    plain, other = Simulator(TASKS["chase"], 3, seed=1), Simulator(TASKS["chase"], 3, seed=1)
    actions = np.array([[0, 1], [2, 3], [3, 2]], dtype=np.int32)
    plain.step(actions)
    if kind is list:
        other.step(actions.tolist())
    else:
        other.step(np.asfortranarray(actions) if kind == "F" else actions.astype(kind))
    np.testing.assert_array_equal(rows_of(plain), rows_of(other))


def test_a_bad_action_names_agent_game_and_remedy() -> None:
    simulator = Simulator(TASKS["chase"], 3)
    with pytest.raises(ValueError, match=r"evader_0 in game 1.*0 to 3.*stay_action=True"):
        simulator.step([[0, 0], [0, 4], [0, 0]])


DUEL: dict[str, Any] = {"num_chasers": 1, "num_evaders": 1}
PARTS = Maze.from_text("+-+-+-+\n|   | |\n+-+-+-+", name="two parts")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "without agents.*give num_chasers"),
        ({**DUEL, "num_evaders": True}, "num_evaders=True; it is a whole number"),
        ({**DUEL, "min_start_distance": 0}, "min_start_distance=0; it is at least 1"),
        ({**DUEL, "min_start_distance": 99}, "min_start_distance=99.*5x5.*Lower the minimum"),
        ({"num_chasers": 1}, "num_chasers=1, num_evaders=0 and no goals.*give num_evaders"),
        ({"num_evaders": 1}, "num_evaders=1, num_chasers=0 and no goals.*give num_chasers"),
        ({"num_runners": 1}, "num_runners=1 and num_goals=0.*num_goals of at least 1"),
        ({"num_chasers": 1, "num_goals": 1}, "only runners and evaders.*give num_runners"),
        ({**DUEL, "maze": "5x6"}, r"unknown maze '5x6' \(did you mean '6x6'\?\); shipped mazes"),
        ({**DUEL, "maze": "2x2", "num_goals": 3}, "need 5 different cells.*2x2 has 4.*larger maze"),
        (
            {"num_runners": 1, "num_goals": 1, "maze": PARTS},
            "two parts has 2 unconnected parts.*open",
        ),
    ],
)
def test_errors_of_invalid_tasks_name_value_and_remedy(
    settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Task(**settings)


def test_an_unknown_task_or_setting_is_named() -> None:
    with pytest.raises(ValueError, match="unknown task 'bridge'; one of chase, maze, race, heist"):
        make_task("bridge")
    with pytest.raises(TypeError, match="keyword argument 'evaders'; the settings are maze, num_"):
        make_task("chase", evaders=2)


def test_a_table_plays_a_copied_game_as_the_original() -> None:
    maze = load_maze("5x5")
    table = best_response("chaser", maze, RandomAgent().action_probabilities(maze)).policy
    policy = TablePolicy(maze, table, epsilon=0.3)
    simulator = Simulator(make_task("chase"), 2, seed=7)
    actions = np.zeros((2, 2), dtype=np.int32)
    for _ in range(60):
        simulator.set_state(simulator.get_state([0]), [1])
        simulator.act([policy, RandomAgent()], actions)
        assert (actions[0] == actions[1]).all()
        simulator.step(actions)
