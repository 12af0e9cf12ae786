"""The simulator: determinism, exact copies, restarts, starts, settings, and what it refuses."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from game_rows import rows_of
from numpy.typing import NDArray
from simulated import CROWD, TASKS, assert_same, play, policies_for

from pursuit.mazes.maze import Maze, load_maze
from pursuit.simulator.simulator import Simulator, SimulatorState
from pursuit.tasks.task import Rewards, Task, make_task
from scripted_agents import RandomAgent, TablePolicy, best_response

# -- determinism and copies ------------------------------------------------------------------------


@pytest.mark.parametrize("name", TASKS)
def test_a_game_does_not_depend_on_its_batch(name: str) -> None:
    batch = play(Simulator(TASKS[name], 7, seed=5), 300)
    assert sum(int(parts[-1].sum()) for parts in batch) > 20  # restarts are part of it
    for game in (0, 3, 6):
        assert_same(batch, game, play(Simulator(TASKS[name], seed=5, first_game=game), 300), 0)
    assert_same(batch, 4, play(Simulator(TASKS[name], 3, seed=5, first_game=2), 300), 2)


def test_other_seeds_and_other_games_are_other_games() -> None:
    batch = Simulator(make_task("chase", maze="9x9"), 200, seed=0)
    starts = batch.positions.copy()
    assert len(np.unique(starts, axis=0)) > 180
    batch.reset(seed=1)
    assert (batch.positions != starts).any(axis=1).mean() > 0.9
    batch.reset(seed=0)
    np.testing.assert_array_equal(batch.positions, starts)


@pytest.mark.parametrize("name", TASKS)
def test_a_restored_state_continues_exactly(name: str) -> None:
    simulator = Simulator(TASKS[name], 6, seed=3)
    play(simulator, 40)
    simulator.configure([1], epsilon=0.9, max_start_distance=3)
    state = simulator.get_state()
    first = play(simulator, 100)
    simulator.set_state(state)
    second = play(simulator, 100)
    other = Simulator(TASKS[name], 6, seed=99)
    other.set_state(state)
    third = play(other, 100)
    for game in range(6):
        assert_same(first, game, second, game)
        assert_same(first, game, third, game)


@pytest.mark.parametrize("name", TASKS)
def test_a_game_copied_to_another_index_continues_like_the_original(name: str) -> None:
    simulator = Simulator(TASKS[name], 6, seed=3)
    play(simulator, 40)
    others = simulator.get_state([0, 2, 4])
    simulator.set_state(simulator.get_state([1, 3]), [5, 1])
    np.testing.assert_array_equal(rows_of(simulator.get_state([0, 2, 4])), rows_of(others))
    history = play(simulator, 100)
    assert_same(history, 3, history, 1)
    assert any((parts[1][1] != parts[1][0]).any() for parts in history)


def test_a_state_is_a_copy() -> None:
    simulator = Simulator(TASKS["chase"], 3)
    state = simulator.get_state()
    before = rows_of(state)
    play(simulator, 10)
    np.testing.assert_array_equal(rows_of(state), before)


def test_a_state_of_another_task_or_number_of_games_is_refused() -> None:
    state = Simulator(make_task("chase", maze="9x9"), 4, seed=1)
    for task, games in ((make_task("chase"), 4), (make_task("chase", maze="9x9"), 3), (CROWD, 4)):
        simulator = Simulator(task, games)
        before = rows_of(simulator)
        with pytest.raises(ValueError, match="state does not match"):
            simulator.set_state(state.get_state())
        np.testing.assert_array_equal(rows_of(simulator), before)


# -- restarts --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TASKS)
def test_a_restart_keeps_what_the_episode_ended_with(name: str) -> None:
    """Compared with a simulator without automatic restarts."""
    task = TASKS[name]
    simulator, twin = Simulator(task, 8, seed=2), Simulator(task, 8, seed=2, auto_restart=False)
    policies = policies_for(task)
    actions = np.zeros((8, task.num_agents), dtype=np.int32)
    simulator.reset()
    twin.reset()
    ended_games = 0
    for _ in range(150):
        simulator.act(policies, actions)
        twin.set_state(simulator.get_state())
        simulator.step(actions)
        twin.step(actions)
        np.testing.assert_array_equal(simulator.terminated, twin.terminated)
        np.testing.assert_array_equal(simulator.truncated, twin.truncated)
        np.testing.assert_array_equal(simulator.rewards, twin.rewards)
        ended = np.flatnonzero(simulator.ended)
        ended_games += len(ended)
        np.testing.assert_array_equal(simulator.final_positions[ended], twin.positions[ended])
        np.testing.assert_array_equal(simulator.episode_lengths[ended], twin.steps[ended])
        np.testing.assert_array_equal(simulator.episode_returns[ended], twin.returns[ended])
        for encoding in ("index", "planes"):
            final = simulator.observe_final(encoding, games=ended)
            np.testing.assert_array_equal(final, twin.observe(encoding)[ended])
            one = simulator.observe_final(encoding, seat=0)[ended]
            np.testing.assert_array_equal(one, final[:, 0])
        assert (simulator.steps[ended] == 0).all() and simulator.active[ended].all()
        assert not simulator.returns[ended].any() and not simulator.events[ended].any()
        twin.reset(games=ended)  # the same stream: the same next episode
        np.testing.assert_array_equal(rows_of(simulator), rows_of(twin))
    assert ended_games > 10


def test_returns_and_lengths_are_sums_over_the_episode() -> None:
    simulator = Simulator(TASKS["crowd"], 5, seed=4)
    totals, lengths = np.zeros((5, 6)), np.zeros(5, dtype=int)
    for _ in range(80):
        play(simulator, 1)
        totals, lengths = totals + simulator.rewards, lengths + 1
        over = simulator.ended
        np.testing.assert_allclose(simulator.episode_returns[over], totals[over], atol=1e-6)
        np.testing.assert_array_equal(simulator.episode_lengths[over], lengths[over])
        totals[over], lengths[over] = 0.0, 0


def test_without_automatic_restart_ended_games_stay_as_they_are() -> None:
    for name in ("chase", "crowd"):
        simulator = Simulator(TASKS[name], 16, seed=6, auto_restart=False)
        play(simulator, 30)
        assert simulator.ended.all()  # at the latest by truncation
        rows, returns, ended = (
            part.copy() for part in (rows_of(simulator), simulator.returns, simulator.ended)
        )
        play(simulator, 5)
        np.testing.assert_array_equal(rows_of(simulator), rows)
        np.testing.assert_array_equal(simulator.returns, returns)
        np.testing.assert_array_equal(simulator.ended, ended)
        assert not simulator.rewards.any()
        simulator.reset(games=[3])
        assert not simulator.ended[3]
        play(simulator, 1)
        assert simulator.steps[3] == 1 and (rows_of(simulator)[4:] == rows[4:]).all()


def test_a_copy_of_an_ended_game_is_ended() -> None:
    simulator = Simulator(TASKS["chase"], 16, seed=6, auto_restart=False)
    play(simulator, 8)
    over = simulator.ended.copy()
    assert 0 < over.sum() < 16
    state, rows = simulator.get_state(), rows_of(simulator)
    assert_goes_on_as_over(simulator, state, over, rows)
    assert_goes_on_as_over(Simulator(TASKS["chase"], 16, auto_restart=False), state, over, rows)
    for copied in (copy.deepcopy(simulator), pickle.loads(pickle.dumps(simulator))):
        np.testing.assert_array_equal(copied.ended, simulator.ended)
    restarting = Simulator(TASKS["chase"], 16)
    with pytest.raises(ValueError, match="has ended; reset it, or use auto_restart=False"):
        restarting.set_state(state)
    restarting.set_state(simulator.get_state(~simulator.ended), ~simulator.ended)


def assert_goes_on_as_over(
    simulator: Simulator, state: SimulatorState, over: NDArray[Any], rows: NDArray[Any]
) -> None:
    """After a restore, ended games do not move and get no rewards; other games continue."""
    simulator.set_state(state)
    np.testing.assert_array_equal(simulator.ended, over)
    play(simulator, 1)
    np.testing.assert_array_equal(rows_of(simulator)[over], rows[over])
    assert not simulator.rewards[over].any() and (simulator.steps[~over] == 9).all()


def test_states_with_auto_restart_have_no_ended_games() -> None:
    simulator = Simulator(TASKS["chase"], 16, seed=6)
    while not simulator.ended.any():
        play(simulator, 1)
    state = simulator.get_state()
    assert not state.terminated.any() and not state.truncated.any() and simulator.ended.any()


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


def test_a_seed_of_some_games_does_not_change_the_others() -> None:
    simulator, other = Simulator(TASKS["chase"], 6, seed=8), Simulator(TASKS["chase"], 6, seed=5)
    streams = simulator.streams.copy()
    simulator.reset(seed=5, games=[0, 3])
    np.testing.assert_array_equal(simulator.streams[[1, 2, 4, 5]], streams[[1, 2, 4, 5]])
    np.testing.assert_array_equal(simulator.streams[[0, 3]], other.streams[[0, 3]])
    np.testing.assert_array_equal(simulator.positions[[0, 3]], other.positions[[0, 3]])
    assert simulator.last_seed is None
    simulator.reset(seed=5)
    np.testing.assert_array_equal(rows_of(simulator), rows_of(other))
    assert simulator.last_seed == 5


def test_reset_of_some_games_does_not_change_the_others() -> None:
    simulator = Simulator(TASKS["chase"], 6, seed=8)
    play(simulator, 5)
    rows = rows_of(simulator)
    simulator.reset(games=[])
    np.testing.assert_array_equal(rows_of(simulator), rows)
    simulator.reset(games=[1, 4])
    assert (simulator.steps == [rows[0, -2], 0, *rows[2:4, -2], 0, rows[5, -2]]).all()
    mask = np.array([True, False, False, False, False, False])
    rows = rows_of(simulator)
    simulator.reset(games=mask)
    np.testing.assert_array_equal(rows_of(simulator)[1:], rows[1:])
    assert simulator.steps[0] == 0


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
    before = simulator.get_state()
    with pytest.raises(ValueError):
        simulator.step(actions)
    after = simulator.get_state()
    for name in vars(before):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


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


@pytest.mark.parametrize(
    "games", [[6], [-7], [0.5], ["a"], [True] * 3, True, {}, [[0, 1]], "a", [[0], 1]]
)
def test_reset_refuses_games_that_are_not_there(games: Any) -> None:
    simulator = Simulator(TASKS["chase"], 6)
    before = simulator.get_state()
    for seed in (None, 5):
        with pytest.raises(ValueError):
            simulator.reset(seed=seed, games=games)
    np.testing.assert_array_equal(simulator.get_state().streams, before.streams)


DUEL: dict[str, Any] = {"num_chasers": 1, "num_evaders": 1}
PARTS = Maze.from_text("+-+-+-+\n|   | |\n+-+-+-+", name="two parts")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "without agents.*give num_chasers"),
        ({**DUEL, "num_chasers": -1}, "num_chasers=-1; it is at least 0"),
        ({**DUEL, "num_evaders": 1.5}, r"num_evaders=1\.5; it is a whole number"),
        ({**DUEL, "num_evaders": True}, "num_evaders=True; it is a whole number"),
        ({**DUEL, "max_steps": 0}, "max_steps=0; it is at least 1"),
        ({**DUEL, "max_steps": 2**31}, "max_steps=2147483648"),
        ({**DUEL, "min_start_distance": 0}, "min_start_distance=0; it is at least 1"),
        ({**DUEL, "min_start_distance": 99}, "min_start_distance=99.*5x5.*Lower the minimum"),
        ({**DUEL, "move_order": "evaders"}, "move_order 'evaders'; one of simultaneous, chasers_f"),
        ({**DUEL, "start": "S"}, "start 'S'; one of random, marks"),
        ({**DUEL, "rewards": "more"}, "rewards 'more'; one of goal, completion, distance, zero"),
        ({**DUEL, "rewards": {"hunter": Rewards()}}, "'hunter'.*the roles are chaser, evader"),
        ({"num_chasers": 1}, "num_chasers=1, num_evaders=0 and no goals.*give num_evaders"),
        ({"num_evaders": 1}, "num_evaders=1, num_chasers=0 and no goals.*give num_chasers"),
        ({"num_runners": 1}, "num_runners=1 and num_goals=0.*num_goals of at least 1"),
        ({"num_chasers": 1, "num_goals": 1}, "only runners and evaders.*give num_runners"),
        ({**DUEL, "maze": ()}, "an empty list; give at least one maze"),
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
