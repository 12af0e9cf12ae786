"""What the simulators of mazes and arms share: determinism, exact copies, states, restarts."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from diagonals import diagonal
from simulated import (
    ARMS,
    CROWD,
    TASKS,
    assert_equal,
    assert_same,
    play,
    refused,
    simulator_of,
    snapshot,
)

from pursuit.reacher.task import ReacherTask
from pursuit.tasks.task import Task, make_task

Tasks = Task | ReacherTask
FINISHED = ("final", "episode_returns", "episode_lengths")
"""The results of finished episodes, which are not part of a state."""

each_task = pytest.mark.parametrize("task", [*TASKS.values(), *ARMS.values()], ids=[*TASKS, *ARMS])
two_tasks = pytest.mark.parametrize("task", [TASKS["chase"], ARMS["kept"]], ids=["maze", "arm"])


# -- determinism and copies ------------------------------------------------------------------------


@each_task
def test_a_game_does_not_depend_on_its_batch(task: Tasks) -> None:
    batch = play(simulator_of(task, 7, seed=5), 100)
    assert sum(int(moment["ended"].sum()) for moment in batch) > 10  # restarts are part of it
    for game in (0, 3, 6):
        assert_same(batch, game, play(simulator_of(task, 1, seed=5, first_game=game), 100), 0)
    assert_same(batch, 4, play(simulator_of(task, 3, seed=5, first_game=2), 100), 2)


@pytest.mark.parametrize("task", [make_task("chase", maze="9x9"), ARMS["kept"]], ids=str)
def test_other_seeds_and_other_games_are_other_games(task: Tasks) -> None:
    simulator = simulator_of(task, 200, seed=0)
    first = snapshot(simulator)
    assert len(np.unique(first["streams"], axis=0)) == 200
    assert len(np.unique(first["seen"], axis=0)) > 180
    simulator.reset(seed=1)
    assert (simulator.observe() != first["seen"]).any(axis=-1).mean() > 0.9
    simulator.reset(seed=0)
    assert_equal(snapshot(simulator), first)


@pytest.mark.parametrize(
    ("task", "auto_restart"), diagonal([*TASKS.values(), *ARMS.values()], [True, False])
)
def test_a_restored_state_continues_exactly(task: Tasks, auto_restart: bool) -> None:
    simulator = simulator_of(task, 6, seed=3, auto_restart=auto_restart)
    play(simulator, 12)
    maze: dict[str, Any] = {"epsilon": 0.9, "max_start_distance": 3}
    arm = {"target_distance": 3, "hold": 1, "tolerance": 0.9, "free_joints": 1}
    simulator.configure([1], **(maze if isinstance(task, Task) else arm))
    state = simulator.get_state()
    first = play(simulator, 60)
    for other in (simulator, simulator_of(task, 6, seed=99, auto_restart=auto_restart)):
        other.set_state(state)
        for one, two in zip(first, play(other, 60), strict=True):
            assert_equal(one, two, without=FINISHED)


@each_task
def test_a_game_copied_to_another_index_continues_like_the_original(task: Tasks) -> None:
    simulator = simulator_of(task, 6, seed=3)
    play(simulator, 12)
    others = vars(simulator.get_state([0, 2, 4]))
    simulator.set_state(simulator.get_state([1, 3]), [5, 1])
    assert_equal(vars(simulator.get_state([0, 2, 4])), others)
    history = [
        {name: rows for name, rows in moment.items() if name not in FINISHED}
        for moment in play(simulator, 60)
    ]
    assert_same(history, 3, history, 1)
    assert any((moment["streams"][1] != moment["streams"][0]).any() for moment in history)


@pytest.mark.parametrize(
    ("copied", "auto_restart"),
    [(copy.deepcopy, True), (lambda it: pickle.loads(pickle.dumps(it)), False)],
)
@two_tasks
def test_a_copy_within_an_episode_continues_like_the_original(
    copied: Callable[[Any], Any], task: Tasks, auto_restart: bool
) -> None:
    simulator = simulator_of(task, 16, seed=8, auto_restart=auto_restart)
    play(simulator, 8)
    simulator.configure([2], **({"epsilon": 1} if isinstance(task, Task) else {"hold": 2}))
    twin = copied(simulator)
    before = snapshot(simulator)
    assert auto_restart or simulator.ended.any()
    assert_equal(snapshot(twin), before)
    first = play(simulator, 50)
    assert_equal(snapshot(twin), before)  # independent
    for one, other in zip(first, play(twin, 50), strict=True):
        assert_equal(one, other)


@two_tasks
def test_a_state_is_a_copy_and_fits_its_own_task_and_number_of_games_only(task: Tasks) -> None:
    simulator = simulator_of(task, 3)
    state = simulator.get_state()
    before = copy.deepcopy(vars(state))
    play(simulator, 5)
    assert_equal(vars(state), before)
    others: tuple[tuple[Tasks, int], ...] = ((task, 4), (CROWD, 3), (ARMS["eight"], 3))
    for other in (simulator_of(*each) for each in others):
        with refused(other, "state does not match"):
            other.set_state(state)
    with refused(simulator, "give a result of `get_state`"):
        simulator.set_state("state")  # type: ignore[arg-type]


# -- restarts --------------------------------------------------------------------------------------


@each_task
def test_a_restart_keeps_what_the_episode_ended_with(task: Tasks) -> None:
    """Compared with a simulator without automatic restarts."""
    simulator = simulator_of(task, 8, seed=2)
    twin = simulator_of(task, 8, seed=2, auto_restart=False)
    encodings = ("index", "planes") if isinstance(task, Task) else ("positions", "positions_angles")
    ends = 0
    for _ in range(120):
        twin.set_state(simulator.get_state())
        for each in (simulator, twin):
            play(each, 1)
        for name in ("terminated", "truncated", "rewards"):
            np.testing.assert_array_equal(getattr(simulator, name), getattr(twin, name))
        over = np.flatnonzero(simulator.ended)
        ends += len(over)
        np.testing.assert_array_equal(simulator.episode_lengths[over], twin.steps[over])
        np.testing.assert_array_equal(simulator.episode_returns[over], twin.returns[over])
        for encoding in encodings:
            final = simulator.observe_final(encoding, games=over)
            np.testing.assert_array_equal(final, twin.observe(encoding)[over])
        assert not simulator.steps[over].any() and not simulator.returns[over].any()
        twin.reset(games=over)  # the same stream: the same next episode
        without = (*FINISHED, "rewards", "terminated", "truncated", "ended")
        assert_equal(snapshot(simulator), snapshot(twin), without)
    assert ends > 10


@each_task
def test_returns_and_lengths_are_sums_over_the_episode(task: Tasks) -> None:
    simulator = simulator_of(task, 5, seed=4)
    totals, lengths = np.zeros_like(simulator.returns), np.zeros(5, dtype=int)
    for _ in range(80):
        play(simulator, 1)
        totals, lengths = totals + simulator.rewards, lengths + 1
        over = simulator.ended
        np.testing.assert_allclose(simulator.episode_returns[over], totals[over], atol=1e-5)
        np.testing.assert_array_equal(simulator.episode_lengths[over], lengths[over])
        totals[over], lengths[over] = 0.0, 0


@pytest.mark.parametrize("task", [TASKS["chase"], CROWD, ARMS["kept"]], ids=str)
def test_without_automatic_restart_ended_games_stay_as_they_are(task: Tasks) -> None:
    simulator = simulator_of(task, 16, seed=6, auto_restart=False)
    play(simulator, 31)
    assert simulator.ended.all() and not simulator.rewards.any()  # at the latest by truncation
    before = snapshot(simulator)
    for moment in play(simulator, 5):
        assert_equal(moment, before, without=["streams"])
    simulator.reset(games=[3])
    assert np.flatnonzero(~simulator.ended).tolist() == [3] and simulator.steps[3] == 0
    moment = play(simulator, 1)[0]
    assert simulator.steps[3] == 1
    for name in before.keys() - {"streams"}:
        np.testing.assert_array_equal(moment[name][4:], before[name][4:], name)


@two_tasks
def test_states_with_auto_restart_have_no_ended_games(task: Tasks) -> None:
    simulator = simulator_of(task, 16, seed=6)
    while not simulator.ended.any():
        play(simulator, 1)
    state = simulator.get_state()
    assert not state.terminated.any() and not state.truncated.any() and simulator.ended.any()


@two_tasks
def test_an_ended_game_is_restored_only_without_auto_restart(task: Tasks) -> None:
    simulator = simulator_of(task, 16, seed=6, auto_restart=False)
    while simulator.ended.sum() < 3:
        play(simulator, 1)
    over, state, before = simulator.ended, simulator.get_state(), snapshot(simulator)
    assert not over.all()
    for other in (simulator, simulator_of(task, 16, auto_restart=False)):
        other.set_state(state)
        np.testing.assert_array_equal(other.ended, over)
        play(other, 1)  # ended games do not move and get no rewards; others continue
        assert not other.rewards[over].any() and (other.steps - before["steps"] == ~over).all()
        np.testing.assert_array_equal(other.observe()[over], before["seen"][over])
    restarting = simulator_of(task, 16)
    with refused(restarting, "has ended; reset it, or use auto_restart=False"):
        restarting.set_state(state)
    running = ~simulator.ended
    restarting.set_state(simulator.get_state(running), running)


@two_tasks
def test_a_reset_of_some_games_does_not_change_the_others(task: Tasks) -> None:
    simulator, other = simulator_of(task, 6, seed=8), simulator_of(task, 6, seed=5)
    before = snapshot(simulator)
    simulator.reset(games=[])
    assert_equal(snapshot(simulator), before)
    simulator.reset(seed=5, games=[0, 3])
    assert simulator.last_seed is None
    for name, rows in snapshot(simulator).items():
        np.testing.assert_array_equal(rows[[1, 2, 4, 5]], before[name][[1, 2, 4, 5]], name)
        np.testing.assert_array_equal(rows[[0, 3]], snapshot(other)[name][[0, 3]], name)
    simulator.reset(seed=5)
    assert_equal(snapshot(simulator), snapshot(other))
    assert simulator.last_seed == 5
    play(simulator, 2)
    before = snapshot(simulator)
    simulator.reset(games=np.arange(6) == 0)
    assert simulator.steps.tolist() == [0, *before["steps"][1:]]


@two_tasks
@pytest.mark.parametrize(
    "games", [[6], [-7], [0.5], ["a"], [True] * 3, True, {}, [[0, 1]], "a", [[0], 1]]
)
def test_games_that_are_not_there_are_refused(task: Tasks, games: Any) -> None:
    simulator = simulator_of(task, 6)
    for seed in (None, 5):
        with refused(simulator):
            simulator.reset(seed=seed, games=games)


@two_tasks
def test_seeded_starts_repeat(task: Tasks) -> None:
    simulator, other = simulator_of(task, 6, seed=0), simulator_of(task, 1, seed=99)
    simulator.seed_starts([1, 4], [7, 7])
    other.seed_starts(None, 7)
    for each in (simulator, other):
        each.reset()
    seen = simulator.observe()
    np.testing.assert_array_equal(seen[1], seen[4])
    np.testing.assert_array_equal(seen[1], other.observe()[0])
    for wrong in (-1, [1, 2, 3], 0.5, 2**63, "a"):
        with refused(simulator, "seeds"):
            simulator.seed_starts(None, wrong)
