"""The arm's simulator: states, settings, views, and observations."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats
from simulated import ARMS, refused

from pursuit.reacher.observations import space_of
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.simulator.state import SimulatorState


@pytest.mark.parametrize(
    "wrong", [{"angles": np.full((3, 2), np.nan)}, {"steps": np.full(3, 26, dtype=np.int32)}]
)
def test_a_state_with_impossible_values_is_refused(wrong: dict[str, Any]) -> None:
    simulator = ReacherSimulator(ARMS["kept"], 3)
    with refused(simulator, "state"):
        simulator.set_state(SimulatorState(**vars(simulator.get_state()) | wrong))


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
    simulator = ReacherSimulator(ARMS["kept"], 3)
    out = np.empty((3, 9), dtype=np.float32)
    assert simulator.observe("positions_angles", out) is out
    np.testing.assert_array_equal(out, simulator.observe("positions_angles"))
    for wrong in (np.empty((3, 7), np.float32), np.empty((3, 9)), [[0.0] * 9] * 3):
        with pytest.raises(ValueError, match="out="):
            simulator.observe("positions_angles", wrong)
    assert space_of(ARMS["kept"], "positions") is space_of(ARMS["kept"], "positions")
