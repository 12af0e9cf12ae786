"""The arm's kernels compared with complex numbers, and the distribution of starts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import reference_arm
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from pursuit.reacher import rules
from pursuit.reacher.observations import ENCODINGS, space_of
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask

REACH = 0.2


@st.composite
def games(draw: st.DrawFn) -> dict[str, Any]:
    """An arm anywhere, a target that it reaches (often where it stands), and actions."""
    joints = draw(st.integers(1, 8))
    angle = st.floats(-math.pi, math.pi, exclude_max=True)
    angles = tuple(draw(st.lists(angle, min_size=joints, max_size=joints)))
    if draw(st.booleans()):  # near the tip, so that the arm goes in and out
        place = reference_arm.ends(angles)[-1]
        target = complex(place) * draw(st.floats(0.9, 1.0))
    else:
        least = 1.0 if joints == 1 else 0.0
        radius = draw(st.floats(least, joints))
        target = complex(radius * np.exp(1j * draw(angle)))
    if joints == 1:
        target = target / abs(target)
    row = st.lists(st.floats(-1.0, 1.0), min_size=joints, max_size=joints)
    return {
        "angles": angles,
        "target": target,
        "actions": draw(st.lists(row, min_size=1, max_size=12)),
        "hold": draw(st.integers(1, 3)),
        "free_joints": draw(st.one_of(st.just(joints), st.integers(1, joints))),
        "max_turn": draw(st.sampled_from([0.1, 1.0, math.pi])),
        "effort": draw(st.sampled_from([0.0, 0.01, 0.5])),
    }


@settings(max_examples=200)
@given(games())
def test_every_step_is_that_of_the_complex_numbers(game: dict[str, Any]) -> None:
    angles, target, free = game["angles"], game["target"], game["free_joints"]
    joints = len(angles)
    angles = tuple(angle if joint < free else 0.0 for joint, angle in enumerate(angles))
    task = ReacherTask(
        joints, hold=game["hold"], max_turn=game["max_turn"], effort=game["effort"], max_steps=10
    )
    least = max(joints - 2 * free + 2, 0)
    if abs(target) < least:
        target = least * (target / abs(target) if target else 1.0)
    simulator = ReacherSimulator(task, auto_restart=False)
    simulator.configure(free_joints=free)
    simulator.place(angles, [target.real, target.imag])
    arm, total = reference_arm.Arm(angles, target), 0.0
    for action in game["actions"]:
        outcome = reference_arm.step(
            arm, action, task.hold, REACH, 10, task.max_turn, task.effort, free
        )
        arm = outcome.arm
        distance = abs(reference_arm.ends(arm.angles)[-1] - target)
        if abs(distance - REACH) < 1e-9:
            return  # on the edge rounding decides
        simulator.step([action])
        total += outcome.reward
        assert simulator.rewards[0] == pytest.approx(outcome.reward, rel=1e-6, abs=1e-7)
        assert simulator.returns[0] == pytest.approx(total, abs=1e-9)
        assert (simulator.held[0], simulator.steps[0]) == (arm.held, arm.steps)
        ended = (simulator.terminated[0], simulator.truncated[0])
        assert ended == (outcome.terminated, outcome.truncated)
        assert (simulator.angles >= -math.pi).all() and (simulator.angles < math.pi).all()
        for ours, theirs in zip(simulator.angles[0], arm.angles, strict=True):
            assert reference_arm.difference(ours, theirs) < 1e-12
        ends = np.array(reference_arm.ends(arm.angles))
        np.testing.assert_allclose(simulator.ends[0] @ [1, 1j], ends, atol=1e-12)
        for encoding in ENCODINGS:
            seen = simulator.observe(encoding)[0]
            with_angles = encoding == "positions_angles"
            expected = reference_arm.observed(arm, REACH, with_angles)
            plain = 1 + 2 * (joints + 1)
            np.testing.assert_allclose(seen[:plain], expected[:plain], atol=1e-5)
            for ours, theirs in zip(seen[plain:], expected[plain:], strict=True):
                assert reference_arm.difference(ours, theirs) < 1e-5
            assert space_of(task, encoding).contains(seen)
        if outcome.terminated or outcome.truncated:
            return


def test_sine_and_cosine_are_those_of_the_library() -> None:
    """To the last digit or so, over all directions that eight joints can have, edges too."""
    drawn = np.random.default_rng(0).uniform(-8 * math.pi, 8 * math.pi, 200_000)
    edges = np.arange(-64, 65) * math.pi / 8
    near = [np.nextafter(edges, side) for side in (-99.0, 99.0)]
    directions = np.concatenate([drawn, edges, *near, [0.0, -0.0, 1e-300]])
    ends = np.empty((len(directions), 1, 2))
    rules.find_all_ends(directions[:, None], ends)
    np.testing.assert_allclose(ends[:, 0, 0], np.cos(directions), rtol=0, atol=2.3e-16)
    np.testing.assert_allclose(ends[:, 0, 1], np.sin(directions), rtol=0, atol=2.3e-16)


# -- the order of what ends an episode -------------------------------------------------------------


def stretched(**settings: Any) -> ReacherSimulator:
    """Two joints stretched along the x-axis, the target on the rim 0.5 rad up."""
    task = ReacherTask(joints=2, start="fixed", **settings)
    simulator = ReacherSimulator(task, auto_restart=False)
    simulator.place([0.0, 0.0], [2 * math.cos(0.5), 2 * math.sin(0.5)])
    return simulator


FORTH, BACK, STAY = [[1.0, 0.0]], [[-1.0, 0.0]], [[0.0, 0.0]]


def test_the_counter_is_cleared_on_leaving_and_by_a_new_episode() -> None:
    simulator = stretched(hold=3)
    held = []
    for action in [FORTH] * 4 + [STAY] + [BACK] * 2 + [FORTH] * 2:
        simulator.step(action)
        held.append(int(simulator.held[0]))
    assert held == [0, 0, 0, 1, 2, 0, 0, 0, 1]
    simulator.reset()
    assert simulator.held[0] == 0
    simulator.place([0.5, 0.0], [2 * math.cos(0.5), 2 * math.sin(0.5)])
    assert simulator.observe()[0, 0] == 1.0 and simulator.held[0] == 0  # it begins in reach
    for step in range(1, 4):
        assert not simulator.ended[0]
        simulator.step(STAY)
        assert simulator.held[0] == step
    assert simulator.terminated[0]


@pytest.mark.parametrize(("max_steps", "ended"), [(4, (True, False)), (3, (False, True))])
def test_reaching_in_the_last_step_is_no_truncation(
    max_steps: int, ended: tuple[bool, bool]
) -> None:
    simulator = stretched(max_steps=max_steps)
    for _ in range(max_steps):
        simulator.step(FORTH)
    assert (simulator.terminated[0], simulator.truncated[0]) == ended


# -- starts of episodes ----------------------------------------------------------------------------

MANY = 4000


def uniform(drawn: NDArray[Any], least: float, most: float) -> bool:
    """Kolmogorov-Smirnov test at level 0.001."""
    law = stats.uniform(least, most - least)
    return bool(stats.kstest(drawn, law.cdf).pvalue > 1e-3)


@pytest.mark.parametrize("joints", [1, 2, 5])
def test_targets_have_a_uniform_radius_and_a_uniform_angle(joints: int) -> None:
    simulator = ReacherSimulator(ReacherTask(joints), MANY, seed=1)
    x, y = simulator.targets.T
    radii, directions = np.hypot(x, y), np.arctan2(y, x)
    assert uniform(directions, -math.pi, math.pi)
    if joints == 1:
        np.testing.assert_allclose(radii, 1.0)
    else:
        assert uniform(radii, 0.0, joints) and radii.max() <= joints
        assert abs(np.corrcoef(radii, np.abs(directions))[0, 1]) < 0.05


@pytest.mark.parametrize(
    ("joints", "free", "least"), [(4, 1, 4), (4, 2, 2), (4, 3, 0), (3, 2, 1), (8, 3, 4)]
)
def test_targets_lie_where_the_free_joints_bring_the_tip(
    joints: int, free: int, least: int
) -> None:
    simulator = ReacherSimulator(ReacherTask(joints, start="random"), MANY)
    simulator.configure(free_joints=free)
    simulator.reset(seed=2)
    radii = np.hypot(*simulator.targets.T)
    if least == joints:
        np.testing.assert_allclose(radii, joints)
    else:
        assert uniform(radii, least, joints)
    assert not simulator.angles[:, free:].any() and simulator.angles[:, :free].all()
    # No pose of this arm comes nearer to the base, and some comes as near.
    drawn = np.random.default_rng(0).uniform(-math.pi, math.pi, (50_000, free))
    folded = np.zeros(joints)
    folded[free - 1] = math.pi * (free > 1)
    poses = np.concatenate([np.zeros((50_000, joints)), [folded]])
    poses[:-1, :free] = drawn
    tips = np.abs(np.exp(1j * poses.cumsum(axis=1)).sum(axis=1))
    assert tips.min() >= least - 1e-9
    if least:
        assert tips[-1] == pytest.approx(least)


def test_poses_are_uniform_where_they_are_drawn() -> None:
    simulator = ReacherSimulator(ReacherTask(3, start="random"), MANY)
    for joint in range(3):
        assert uniform(simulator.angles[:, joint], -math.pi, math.pi)
    first = simulator.angles.copy()
    simulator.reset()
    assert (simulator.angles != first).all()


def test_a_kept_pose_is_that_in_which_the_episode_ended() -> None:
    simulator = ReacherSimulator(ReacherTask(2, max_steps=7), 50, seed=3)
    assert uniform(simulator.angles[:, 0], -math.pi, math.pi)  # the first one is drawn
    rng = np.random.default_rng(0)
    for _ in range(30):
        before, targets = simulator.angles.copy(), simulator.targets.copy()
        actions = rng.uniform(-1, 1, (50, 2))
        simulator.step(actions)
        turned = np.angle(np.exp(1j * (simulator.angles - before)))
        np.testing.assert_allclose(turned, 0.1 * actions, atol=1e-12)  # over the restart too
        assert ((simulator.targets != targets).all(axis=1) == simulator.ended).all()
    kept = simulator.angles.copy()
    simulator.reset()
    np.testing.assert_array_equal(simulator.angles, kept)
    simulator.reset(seed=3)
    assert (simulator.angles != kept).all()


def test_a_fixed_pose_is_straight() -> None:
    simulator = ReacherSimulator(ReacherTask(4, start="fixed", max_steps=2), 20)
    for _ in range(4):
        assert not simulator.angles.any()
        assert (simulator.tips == [4.0, 0.0]).all()
        simulator.step(np.ones((20, 4)))
        simulator.step(np.ones((20, 4)))


@pytest.mark.parametrize("joints", [1, 2, 4])
@pytest.mark.parametrize("distance", [0.0, 1.0, 7.5, 31.0])
def test_a_target_within_a_distance_needs_no_more_steps(joints: int, distance: float) -> None:
    """One joint in closed form; several joints by moving to the drawn pose."""
    simulator = ReacherSimulator(ReacherTask(joints, start="random", tolerance=1e-6), 500)
    simulator.configure(target_distance=distance)
    simulator.reset(seed=4)
    x, y = simulator.targets.T
    if joints == 1:
        off = np.abs(np.angle(np.exp(1j * (np.arctan2(y, x) - simulator.angles[:, 0]))))
        assert (off <= 0.1 * distance + 1e-9).all()
        if distance:
            assert uniform(off, 0.0, 0.1 * distance)
        return
    # Every link turns by less than (joint + 1) * 0.1 * distance in all.
    moved = np.hypot(*(simulator.tips - simulator.targets).T)
    assert (moved <= 0.1 * distance * joints * (joints + 1) / 2 + 1e-9).all()
    if joints == 2:  # both poses with that tip, in closed form: one lies within the distance
        squared = x**2 + y**2
        bend = np.arccos(np.clip((squared - 2.0) / 2.0, -1.0, 1.0))
        found = np.zeros(500, dtype=bool)
        for elbow in (bend, -bend):
            turned = np.arctan2(np.sin(elbow), 1.0 + np.cos(elbow))
            pose = np.stack([np.arctan2(y, x) - turned, elbow], axis=1)
            off = np.abs(np.angle(np.exp(1j * (pose - simulator.angles)))).max(axis=1)
            found |= off <= 0.1 * distance + 1e-5
        assert found.all()


def test_a_distance_of_half_a_turn_or_none_is_anywhere() -> None:
    for distance in (-1.0, 31.5, 1e6):
        simulator = ReacherSimulator(ReacherTask(2), MANY)
        simulator.configure(target_distance=distance)
        simulator.reset(seed=5)
        assert uniform(np.hypot(*simulator.targets.T), 0.0, 2.0)
