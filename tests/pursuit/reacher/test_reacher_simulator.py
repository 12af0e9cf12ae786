"""The arm's simulator: determinism, exact copies, restarts, settings, and what it refuses."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from pursuit.reacher.observations import ENCODINGS, space_of
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask

TASKS = {
    "kept": ReacherTask(2, tolerance=0.6, max_steps=25),
    "random": ReacherTask(1, start="random", hold=2, max_steps=20),
    "fixed": ReacherTask(5, start="fixed", tolerance=1.5, hold=3, max_steps=30),
    "eight": ReacherTask(8, tolerance=3.0, max_steps=15, max_turn=math.pi),
}
KEPT = ("rewards", "returns", "terminated", "truncated", "episode_returns", "episode_lengths")


def snapshot(simulator: ReacherSimulator) -> dict[str, NDArray[Any]]:
    """Copies of all readable arrays, one row per arm."""
    found = {name: getattr(simulator, name).copy() for name in (*KEPT, "streams")}
    found |= {name: array.copy() for name, array in simulator.arms._asdict().items()}
    found |= {f"final {name}": array.copy() for name, array in simulator.final._asdict().items()}
    found |= {f"next {name}": array.copy() for name, array in simulator._coming._asdict().items()}
    return found | {encoding: simulator.observe(encoding) for encoding in ENCODINGS}


def play(simulator: ReacherSimulator, steps: int) -> list[dict[str, NDArray[Any]]]:
    """Actions that an arm draws from its own stream, so that they belong to it."""
    view, history = simulator.view(), []
    for _ in range(steps):
        simulator.step(np.clip(view.normal(), -1.0, 1.0))
        history.append(snapshot(simulator))
    return history


def assert_same(one: Any, arm: int, other: Any, other_arm: int) -> None:
    for left, right in zip(one, other, strict=True):
        for name in left:
            np.testing.assert_array_equal(left[name][arm], right[name][other_arm], err_msg=name)


def assert_equal(one: dict[str, NDArray[Any]], other: dict[str, NDArray[Any]]) -> None:
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


# -- determinism and copies ------------------------------------------------------------------------


@pytest.mark.parametrize("name", TASKS)
def test_an_arm_does_not_depend_on_its_batch(name: str) -> None:
    batch = play(ReacherSimulator(TASKS[name], 7, seed=5), 80)
    ends = sum(int(moment["terminated"].sum() + moment["truncated"].sum()) for moment in batch)
    assert ends > 10  # restarts are part of it
    for arm in (0, 3, 6):
        assert_same(batch, arm, play(ReacherSimulator(TASKS[name], 1, 5, arm), 80), 0)
    assert_same(batch, 4, play(ReacherSimulator(TASKS[name], 3, 5, 2), 80), 2)


def test_other_seeds_and_other_arms_are_other_games() -> None:
    simulator = ReacherSimulator(TASKS["kept"], 500, seed=0)
    first = snapshot(simulator)
    for name in ("angles", "target", "streams"):
        assert len(np.unique(first[name], axis=0)) == 500
    simulator.reset(seed=1)
    assert (simulator.angles != first["angles"]).all()
    simulator.reset(seed=0)
    assert_equal(snapshot(simulator), first)


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("auto_restart", [True, False])
def test_a_restored_state_continues_exactly(name: str, auto_restart: bool) -> None:
    simulator = ReacherSimulator(TASKS[name], 6, seed=3, auto_restart=auto_restart)
    play(simulator, 10)
    simulator.configure([1], target_distance=3, hold=1, tolerance=0.9, free_joints=1)
    state = simulator.get_state()
    first = play(simulator, 60)
    simulator.set_state(state)
    second = play(simulator, 60)
    other = ReacherSimulator(TASKS[name], 6, seed=99, auto_restart=auto_restart)
    other.set_state(state)
    third = play(other, 60)
    keys = [key for key in first[0] if "final" not in key and "episode" not in key]
    for one, two, three in zip(first, second, third, strict=True):
        for key in keys:  # results of finished episodes are not part of a state
            np.testing.assert_array_equal(one[key], two[key], err_msg=key)
            np.testing.assert_array_equal(one[key], three[key], err_msg=key)


def test_an_arm_copied_to_another_index_continues_like_the_original() -> None:
    simulator = ReacherSimulator(TASKS["kept"], 5, seed=3)
    play(simulator, 10)
    simulator.set_state(simulator.get_state([1, 3]), [4, 0])
    for moment in play(simulator, 60):
        for name in ("angles", "target", "rewards", "streams", "returns"):
            assert (moment[name][0] == moment[name][3]).all()
            assert (moment[name][4] == moment[name][1]).all()
        assert (moment["streams"][0] != moment["streams"][2]).all()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
@pytest.mark.parametrize("auto_restart", [True, False])
def test_a_copy_within_an_episode_continues_like_the_original(
    copied: Callable[[Any], Any], auto_restart: bool
) -> None:
    simulator = ReacherSimulator(TASKS["fixed"], 4, seed=8, auto_restart=auto_restart)
    play(simulator, 37)
    simulator.configure([2], target_distance=2)
    twin = copied(simulator)
    assert_equal(snapshot(simulator), snapshot(twin))
    before = snapshot(twin)
    first = play(simulator, 50)
    assert_equal(snapshot(twin), before)  # independent
    for one, other in zip(first, play(twin, 50), strict=True):
        assert_equal(one, other)


def test_a_state_is_a_copy_and_fits_its_own_task_only() -> None:
    simulator = ReacherSimulator(TASKS["kept"], 3)
    state = simulator.get_state()
    angles = state.angles.copy()
    play(simulator, 5)
    np.testing.assert_array_equal(state.angles, angles)
    broken = copy.deepcopy(state)
    broken.angles[1, 0] = np.nan
    later = copy.deepcopy(state)
    later.steps[:] = 26
    for other, wrong in (
        (ReacherSimulator(TASKS["kept"], 4), state),
        (ReacherSimulator(TASKS["eight"], 3), state),
        (ReacherSimulator(TASKS["kept"], 3), broken),
        (ReacherSimulator(TASKS["kept"], 3), later),
        (ReacherSimulator(TASKS["kept"], 3), "state"),
    ):
        before = snapshot(other)
        with pytest.raises(ValueError, match="state"):
            other.set_state(wrong)  # type: ignore[arg-type]
        assert_equal(snapshot(other), before)


# -- restarts --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TASKS)
def test_a_restart_keeps_what_the_episode_ended_with(name: str) -> None:
    """Compared with a simulator without automatic restarts."""
    simulator = ReacherSimulator(TASKS[name], 8, seed=2)
    twin = ReacherSimulator(TASKS[name], 8, seed=2, auto_restart=False)
    ends = 0
    for _ in range(120):
        twin.set_state(simulator.get_state())
        for each in (simulator, twin):
            each.step(np.clip(each.view().normal(), -1.0, 1.0))
        for kept in ("terminated", "truncated", "rewards"):
            np.testing.assert_array_equal(getattr(simulator, kept), getattr(twin, kept))
        over = np.flatnonzero(simulator.ended)
        ends += len(over)
        np.testing.assert_array_equal(simulator.episode_lengths[over], twin.steps[over])
        np.testing.assert_array_equal(simulator.episode_returns[over], twin.returns[over])
        for final, live in zip(simulator.final, twin.arms, strict=True):
            np.testing.assert_array_equal(final[over], live[over])
        for encoding in ENCODINGS:
            seen = simulator.observe_final(encoding, over)
            np.testing.assert_array_equal(seen, twin.observe(encoding)[over])
        assert not simulator.steps[over].any() and not simulator.held[over].any()
        assert not simulator.returns[over].any()
        twin.reset(games=over)  # the same stream: the same next episode
        for name_ in ("angles", "target", "ends", "streams"):
            np.testing.assert_array_equal(snapshot(simulator)[name_], snapshot(twin)[name_])
    assert ends > 20


def test_without_automatic_restart_ended_arms_stay_as_they_are() -> None:
    simulator = ReacherSimulator(TASKS["kept"], 16, seed=6, auto_restart=False)
    play(simulator, 30)
    assert simulator.ended.all() and simulator.terminated.any() and simulator.truncated.any()
    before = snapshot(simulator)
    assert not before["rewards"].any() and before["returns"].all()
    simulator.step(np.ones((16, 2)))
    assert_equal(snapshot(simulator), before)
    simulator.reset(games=[3])
    assert simulator.ended.sum() == 15 and simulator.steps[3] == 0
    simulator.step(np.ones((16, 2)))
    assert simulator.steps[3] == 1


def test_returns_and_lengths_are_sums_over_the_episode() -> None:
    simulator = ReacherSimulator(TASKS["kept"], 5, seed=4)
    totals, lengths = np.zeros(5), np.zeros(5, dtype=int)
    for _ in range(80):
        play(simulator, 1)
        totals, lengths = totals + simulator.rewards, lengths + 1
        over = simulator.ended
        np.testing.assert_allclose(simulator.episode_returns[over], totals[over], atol=1e-5)
        np.testing.assert_array_equal(simulator.episode_lengths[over], lengths[over])
        totals[over], lengths[over] = 0.0, 0


def test_settings_apply_from_the_next_episode() -> None:
    simulator = ReacherSimulator(ReacherTask(3, max_steps=4, hold=2), 4, seed=0)
    simulator.configure([0, 1], hold=[3, 4], tolerance=0.5, free_joints=2, target_distance=5)
    assert simulator.arms.hold.tolist() == [2] * 4 and simulator.arms.tolerance.max() == 0.2
    assert simulator.arms.free_joints.tolist() == [3] * 4
    while not simulator.ended.any():
        simulator.step(np.zeros((4, 3)))
    simulator.reset()
    assert simulator.arms.hold.tolist() == [3, 4, 2, 2]
    assert simulator.arms.tolerance.tolist() == [0.5, 0.5, 0.2, 0.2]
    assert simulator.arms.free_joints.tolist() == [2, 2, 3, 3]
    assert not simulator.angles[:2, 2].any()


def test_seeded_starts_repeat() -> None:
    simulator = ReacherSimulator(TASKS["kept"], 6, seed=0)
    simulator.seed_starts([1, 4], [7, 7])
    simulator.reset()
    np.testing.assert_array_equal(simulator.angles[1], simulator.angles[4])
    np.testing.assert_array_equal(simulator.targets[1], simulator.targets[4])
    other = ReacherSimulator(TASKS["kept"], 1, seed=99)
    other.seed_starts(None, 7)
    other.reset()
    np.testing.assert_array_equal(other.angles[0], simulator.angles[1])
    np.testing.assert_array_equal(other.targets[0], simulator.targets[1])


def test_place_sets_poses_and_targets() -> None:
    simulator = ReacherSimulator(ReacherTask(2), 2)
    simulator.place([[0.3, -math.pi], [7.0, math.pi]], [1.0, 1.0])
    assert simulator.angles[0].tolist() == [0.3, -math.pi]
    assert simulator.angles[1] == pytest.approx([7.0 - 2 * math.pi, -math.pi])
    simulator.place([-math.pi - 4.4e-16, math.pi - 4.4e-16], [0.0, 0.0])
    assert (simulator.angles >= -math.pi).all() and (simulator.angles < math.pi).all()
    assert simulator.targets.tolist() == [[0.0, 0.0]] * 2 and not simulator.steps.any()


def test_a_view_shows_the_arms_as_they_are_and_draws_from_their_streams() -> None:
    simulator = ReacherSimulator(ReacherTask(3), 4000, seed=1)
    view = simulator.view()
    simulator.step(np.ones((4000, 3)))
    shown = {"angles": simulator.angles, "targets": simulator.targets, "ends": simulator.ends}
    shown |= {"steps": simulator.steps, "held": simulator.held, "streams": simulator.streams}
    for name, live in shown.items():
        assert getattr(view, name) is live
    assert (view.num_games, view.task) == (4000, simulator.task)
    assert (view.free_joints == 3).all() and (view.tolerance == 0.2).all()
    np.testing.assert_array_equal(view.observe("positions"), simulator.observe("positions"))
    drawn, uniform = view.normal(), view.uniform()
    for joint in range(3):
        assert stats.kstest(drawn[:, joint], "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(drawn.T) - np.eye(3)).max() < 0.06
    assert stats.kstest(uniform, "uniform").pvalue > 1e-3
    starts = simulator.streams[:, 0].copy()
    view.normal()
    np.testing.assert_array_equal(simulator.streams[:, 0], starts)  # its own stream only


# -- discrete actions and observations -------------------------------------------------------------


@pytest.mark.parametrize("joints", [1, 2, 3, 8])
def test_choices_are_numbers_in_base_three(joints: int) -> None:
    task = ReacherTask(joints, discrete_actions=True)
    choices = np.arange(min(task.num_choices, 500))
    expected = [
        [int(digit) - 1 for digit in np.base_repr(choice, 3).zfill(joints)] for choice in choices
    ]
    np.testing.assert_array_equal(task.actions_of(choices), expected)
    assert task.num_choices == 3**joints
    assert task.actions_of(task.num_choices - 1).tolist() == [1.0] * joints
    for wrong in (-1, task.num_choices, 0.5, True, "0"):
        with pytest.raises(ValueError, match="choices="):
            task.actions_of(wrong)


def test_an_observation_goes_into_an_array_that_is_given() -> None:
    simulator = ReacherSimulator(TASKS["kept"], 3)
    out = np.empty((3, 9), dtype=np.float32)
    assert simulator.observe("positions_angles", out) is out
    np.testing.assert_array_equal(out, simulator.observe("positions_angles"))
    for wrong in (np.empty((3, 7), np.float32), np.empty((3, 9)), [[0.0] * 9] * 3):
        with pytest.raises(ValueError, match="out="):
            simulator.observe("positions_angles", wrong)
    assert space_of(TASKS["kept"], "positions") is space_of(TASKS["kept"], "positions")
