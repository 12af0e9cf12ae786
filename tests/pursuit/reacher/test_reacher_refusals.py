"""Invalid input to arms: nothing changes, and the error names the value and the rule."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from simulated import refused

from pursuit import ReacherSimulator, ReacherTask, reacher_v0
from pursuit.reacher.task import make_reacher_task

ID = "pursuit/Reacher-v0"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        *(({"joints": joints}, "joints=") for joints in (0, 9, 2.5, True, "2", None)),
        *(({"tolerance": value}, "tolerance=") for value in (0, -0.1, math.nan, math.inf, True)),
        ({"hold": 0}, "hold=0; it is at least 1"),
        ({"hold": 401}, "hold=401 is above max_steps=400; lower hold"),
        ({"hold": 3, "max_steps": 2}, "hold=3 is above max_steps=2"),
        ({"max_steps": 0}, "max_steps=0"),
        ({"start": "straight"}, "unknown start 'straight'; one of kept, random, fixed"),
        *(({"max_turn": value}, "max_turn=") for value in (0.0, -1.0, 1e-300, 3.15, math.nan)),
        *(({"effort": value}, "effort=") for value in (-0.1, math.inf, 1e31, "much")),
        ({"discrete_actions": 1}, "discrete_actions=1; it is True or False"),
    ],
)
def test_invalid_tasks(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ReacherTask(**settings)


def test_an_unknown_setting_is_an_unknown_keyword() -> None:
    with pytest.raises(TypeError, match="keyword argument 'links'; the settings are joints, start"):
        make_reacher_task(links=2)
    assert make_reacher_task(joints=3) == ReacherTask(3)


@pytest.mark.parametrize(
    "actions",
    [
        [[0.0, 0.0], [0.0, 1.1]],
        [[0.0, 0.0], [0.0, -1.00001]],
        [[math.nan, 0.0], [0.0, 0.0]],
        [[0.0, 0.0], [math.inf, 0.0]],
        [[0.0, 0.0]],
        [0.0, 0.0],
        [[0.0], [0.0]],
        [[True, False], [True, True]],
        [["0", "0"], ["0", "0"]],
        [[0j, 0], [0, 0]],
        [[0.0, 0.0], [0.0]],
        None,
    ],
)
def test_nothing_moves_when_an_action_is_refused(actions: Any) -> None:
    for auto_restart in (True, False):
        simulator = ReacherSimulator(ReacherTask(2), 2, auto_restart=auto_restart)
        simulator.step(np.ones((2, 2)))
        with refused(simulator, "action"):
            simulator.step(actions)


def test_rounding_is_clipped() -> None:
    simulator = ReacherSimulator(ReacherTask(2), 1)
    simulator.place([0.0, 0.0], [1.0, 1.0])
    simulator.step(np.array([[1.0 + 5e-7, -1.0 - 5e-7]], dtype=np.float32))
    np.testing.assert_array_equal(simulator.angles, [[0.1, -0.1]])


@pytest.mark.parametrize(
    ("angles", "targets", "message"),
    [
        ([0.0, 0.0], [2.3, 0.0], r"target \(2.3, 0.0\) is out of reach; .* has radius 0 to 2"),
        ([0.0, 0.0], [[0.0, 0.0], [0.0, -9.0]], "is out of reach"),
        ([0.0, 0.0], [math.nan, 0.0], "targets="),
        ([0.0, math.inf], [1.0, 0.0], "angles="),
        ([0.0], [1.0, 0.0], "angles="),
        ([0.0, 0.0, 0.0], [1.0, 0.0], "angles="),
        ([0.0, 0.0], [1.0], "targets="),
        ("straight", [1.0, 0.0], "angles="),
    ],
)
def test_nothing_changes_when_a_start_is_refused(angles: Any, targets: Any, message: str) -> None:
    simulator = ReacherSimulator(ReacherTask(2), 2)
    with refused(simulator, message):
        simulator.place(angles, targets, seed=3)


def test_targets_are_checked_with_the_tolerance_of_the_new_episode() -> None:
    simulator = ReacherSimulator(ReacherTask(1), 2)
    with pytest.raises(ValueError, match=r"tolerance=0\.2: give"):
        simulator.place([0.0], [1.4, 0.0])
    simulator.configure([1], tolerance=0.5)
    with pytest.raises(ValueError, match=r"tolerance=0\.2: give"):
        simulator.place([0.0], [1.4, 0.0])  # of the first arm it is still the task's
    simulator.configure(tolerance=0.5)
    simulator.place([0.0], [1.4, 0.0])
    simulator.step(np.zeros((2, 1)))
    assert simulator.terminated.all()
    simulator.configure(tolerance=0.1)
    with pytest.raises(ValueError, match=r"tolerance=0\.1: give"):
        simulator.place([0.0], [1.15, 0.0])


def test_locked_joints_restrict_poses_and_targets() -> None:
    simulator = ReacherSimulator(ReacherTask(4), 1)
    simulator.configure(free_joints=2)
    with pytest.raises(ValueError, match="of which 2 turn has radius 2 to 4"):
        simulator.place([0.0] * 4, [1.0, 0.0])
    with pytest.raises(ValueError, match="angles of locked joints must be 0"):
        simulator.place([0.0, 0.0, 0.1, 0.0], [3.0, 0.0])
    simulator.place([1.0, 2.0, 0.0, 0.0], [3.0, 0.0])
    one = ReacherSimulator(ReacherTask(1))
    with pytest.raises(ValueError, match="of which 1 turn has radius 1 to 1"):
        one.place([0.0], [0.5, 0.0])


@pytest.mark.parametrize(
    "settings",
    [
        {"target_distance": -2},
        {"target_distance": math.nan},
        {"target_distance": "near"},
        {"free_joints": 0},
        {"free_joints": 3},
        {"free_joints": 1.5},
        {"hold": 0},
        {"hold": 401},
        {"tolerance": 0.0},
        {"tolerance": 4.1},
        {"tolerance": [0.1, 0.2, 0.3]},
        {"hold": 2, "tolerance": -1.0},
    ],
)
def test_invalid_settings_change_nothing(settings: dict[str, Any]) -> None:
    simulator = ReacherSimulator(ReacherTask(2), 2)
    with refused(simulator, "=.*; |give one for all"):
        simulator.configure(**settings)


def test_other_invalid_arguments() -> None:
    task = ReacherTask(2)
    for settings in ({"num_games": 0}, {"num_games": 2.0}, {"seed": -1}, {"first_game": -1}):
        with pytest.raises(ValueError, match=next(iter(settings))):
            ReacherSimulator(task, **settings)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"task='reacher'; give a pursuit.ReacherTask"):
        ReacherSimulator("reacher")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="take fewer games"):
        ReacherSimulator(task, 10**12)
    simulator = ReacherSimulator(task, 2)
    with pytest.raises(ValueError, match="unknown observation 'pixels'; one of positions, pos"):
        simulator.observe("pixels")
    for seed in (-1, 2**64, 1.5, "1", True):
        with pytest.raises(ValueError, match="seed="):
            simulator.reset(seed=seed)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"observation": "pixels"}, "unknown observation 'pixels'; one of positions, positions_an"),
        ({"observation": ["positions"]}, "unknown observation"),
        ({"render_mode": "3d"}, "render_mode '3d'"),
        ({"joints": 9}, "joints=9; it is at most 8"),
    ],
)
def test_invalid_environments(settings: dict[str, Any], message: str) -> None:
    for make in (
        lambda: gymnasium.make(ID, **settings),
        lambda: gymnasium.make_vec(ID, num_envs=2, **settings),
        lambda: reacher_v0.parallel_env(**settings),
        lambda: reacher_v0.env(**settings),
    ):
        with pytest.raises(ValueError, match=message):
            make()
