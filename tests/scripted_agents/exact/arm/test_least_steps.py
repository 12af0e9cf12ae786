"""The least steps of an arm against grids of all poses, other solvers, a formula and symmetries."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from scripted_agents import least_steps
from scripted_agents import least_steps_of as batch
from scripted_agents.exact.arm.least_steps import pose_at

TURN = 0.1


def starts(joints: int, arms: int, seed: int = 0) -> tuple[Any, Any]:
    """Poses and targets as the task draws them."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0, joints, arms) if joints > 1 else np.ones(arms)
    angle = rng.uniform(0, 2 * np.pi, arms)
    targets = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return rng.uniform(-np.pi, np.pi, (arms, joints)), targets


def solve(*arguments: Any, **settings: Any) -> tuple[Any, Any]:
    """[arms, 2] the bounds, and [arms, n] how far the joints turn."""
    lower, upper, turns = batch(*arguments, **settings)
    return np.stack([lower, upper], axis=1), turns


def tips(angles: Any) -> Any:
    directions = np.cumsum(angles, axis=-1)
    return np.stack([np.cos(directions).sum(axis=-1), np.sin(directions).sum(axis=-1)], axis=-1)


def distances(angles: Any, targets: Any) -> Any:
    return np.linalg.norm(tips(angles) - targets, axis=-1)


def grid(angles: Any, width: float, points: int) -> Any:
    """[points, ..., n]: all poses of a grid over what lies within `width` in every joint."""
    line = np.linspace(-width, width, points)
    return angles + np.stack(np.meshgrid(*[line] * len(angles), indexing="ij"), axis=-1)


def test_one_joint_by_the_formula() -> None:
    """The tip must turn to where a chord of the circle is as long as the tolerance."""
    angles, targets = starts(1, 500)
    away = np.arctan2(targets[:, 1], targets[:, 0]) - angles[:, 0]
    away = np.abs((away + np.pi) % (2 * np.pi) - np.pi)
    wanted = np.maximum(np.ceil((away - 2 * np.arcsin(0.1)) / TURN), 0)
    steps, _ = solve(angles, targets)
    assert np.array_equal(steps, np.stack([wanted, wanted], axis=1))


@pytest.mark.parametrize(("joints", "points", "arms"), [(1, 2001, 60), (2, 201, 60), (3, 41, 25)])
@pytest.mark.parametrize("tolerance", [0.1, 0.2, 0.7])
def test_no_pose_of_a_grid_is_sooner_in_reach(
    joints: int, points: int, arms: int, tolerance: float
) -> None:
    angles, targets = starts(joints, arms, seed=3)
    steps, turns = solve(angles, targets, tolerance=tolerance)
    assert np.array_equal(steps[:, 0], steps[:, 1])
    assert (distances(angles + turns, targets) <= tolerance).all()
    for pose, target, least in zip(angles, targets, steps[:, 1], strict=True):
        if least > 0:
            sooner = grid(pose, TURN * (least - 1), points)
            assert distances(sooner, target).min() > tolerance


@pytest.mark.parametrize("joints", [3, 4, 5, 8])
def test_no_solver_is_sooner_in_reach(joints: int) -> None:
    """SciPy's least squares within the bounds, from several poses, one step before."""
    angles, targets = starts(joints, 8, seed=joints)
    steps, turns = solve(angles, targets)
    assert np.array_equal(steps[:, 0], steps[:, 1])
    assert (distances(angles + turns, targets) <= 0.2).all()
    assert (np.abs(turns).max(axis=1) <= TURN * steps[:, 1] + 1e-12).all()
    rng = np.random.default_rng(0)
    for pose, target, least in zip(angles, targets, steps[:, 1], strict=True):
        width = TURN * (least - 1)
        if width <= 0:
            continue
        for _ in range(2):
            begin = pose + rng.uniform(-width, width, joints)
            found = least_squares(
                lambda x, target=target: tips(x) - target,
                begin,
                bounds=(pose - width, pose + width),
                max_nfev=40,
            )
            assert distances(found.x, target) > 0.2


def test_a_smaller_step_or_tolerance_never_takes_fewer_steps() -> None:
    angles, targets = starts(4, 60)
    by_tolerance = [solve(angles, targets, tolerance=x)[0] for x in (0.05, 0.2, 0.6)]
    by_turn = [solve(angles, targets, max_turn=x)[0] for x in (0.07, 0.1, 0.4, np.pi)]
    for results in (by_tolerance, by_turn):
        for more, fewer in pairwise(results):
            assert (more[:, 0] >= fewer[:, 0]).all()
            assert (more[:, 0] > fewer[:, 0]).any()
    assert by_turn[-1].max() == 1


@pytest.mark.parametrize("joints", [2, 5])
def test_turning_the_plane_or_mirroring_it_changes_nothing(joints: int) -> None:
    angles, targets = starts(joints, 50)
    plain, _ = solve(angles, targets)
    turned = angles.copy()
    turned[:, 0] += 1.3
    turn = np.array([[np.cos(1.3), np.sin(1.3)], [-np.sin(1.3), np.cos(1.3)]])
    assert np.array_equal(solve(turned, targets @ turn)[0], plain)
    assert np.array_equal(solve(-angles, targets * [1, -1])[0], plain)
    assert np.array_equal(solve(angles + 6 * np.pi, targets)[0], plain)


def test_locked_joints_are_a_longer_last_link() -> None:
    """Of four joints two turn: a grid over these; and what is locked in a bend stays bent."""
    angles, _ = starts(4, 30)
    targets = tips(angles + np.random.default_rng(1).uniform(-1, 1, (30, 4)) * [1, 1, 0, 0])
    steps, turns = solve(angles, targets, free_joints=2)
    assert np.array_equal(steps[:, 0], steps[:, 1])
    assert not turns[:, 2:].any() and (distances(angles + turns, targets) <= 0.2).all()
    for pose, target, least in zip(angles, targets, steps[:, 1], strict=True):
        if least > 0:
            some = np.zeros((301, 301, 4)) + pose
            some[..., :2] = grid(pose[:2], TURN * (least - 1), 301)
            assert distances(some, target).min() > 0.2
    assert (solve(angles, targets)[0] <= steps).all()


@pytest.mark.parametrize("joints", [2, 4, 8])
def test_a_search_cut_short_gives_bounds_around_the_exact_number(joints: int) -> None:
    angles, targets = starts(joints, 40)
    exact, _ = solve(angles, targets)
    assert np.array_equal(exact[:, 0], exact[:, 1])
    steps, turns = solve(angles, targets, budget=3**joints)
    assert (steps[:, 0] <= exact[:, 0]).all() and (exact[:, 1] <= steps[:, 1]).all()
    assert (steps[:, 0] < steps[:, 1]).any()
    assert (distances(angles + turns, targets) <= 0.2).all()
    assert (np.abs(turns).max(axis=1) <= TURN * steps[:, 1] + 1e-12).all()


@pytest.mark.parametrize("joints", [2, 3, 8])
def test_straight_arms_folded_arms_and_rings(joints: int) -> None:
    """Poses where directions are lost: the arm is straight, folded, or a ring."""
    rim = np.array([joints, 0.0])
    assert least_steps(np.zeros(joints), rim) == (0, 0)
    assert least_steps(np.zeros(joints), rim * 1.02, tolerance=0.25) == (0, 0)
    folded = np.pi * (np.arange(joints) > 0)
    ring = np.full(joints, 2 * np.pi / joints)
    for pose in (np.zeros(joints), folded, ring):
        for target in ([0.0, 0.0], [joints, 0.0], [-joints, 0.0], [0.0, 1.0]):
            lower, upper = least_steps(pose, target)
            assert lower == upper
            if joints == 2 and upper > 0:
                assert distances(grid(pose, TURN * (upper - 1), 301), target).min() > 0.2


@pytest.mark.parametrize("joints", [1, 2, 3, 8])
@pytest.mark.parametrize("last", [1.0, 2.0, 0.5 + 0.5j])
def test_a_pose_for_any_target(joints: int, last: complex) -> None:
    for target in starts(joints, 50)[1]:
        angles = pose_at(complex(*target), joints, last)
        heading = np.exp(1j * np.cumsum(angles))
        tip = heading[:-1].sum() + heading[-1] * last
        most = joints - 1 + abs(last)
        least = max(2 * max(abs(last), joints > 1) - most, 0.0)
        radius = np.hypot(*target)
        off = max(radius - most, least - radius, 0.0)
        assert abs(tip - complex(*target)) == pytest.approx(off, abs=1e-6)


def test_what_is_refused() -> None:
    good: dict[str, Any] = {"angles": [0.1, 0.2], "target": [1.0, 0.5]}
    assert least_steps(**good)[0] > 0
    for wrong in (
        {"angles": [0.1, np.nan]},
        {"angles": [[0.1, 0.2]]},
        {"angles": []},
        {"angles": [0.0] * 9},
        {"angles": ["a", "b"]},
        {"target": [1.0, 0.5, 0.0]},
        {"target": [np.inf, 0.0]},
        {"target": [2.3, 0.0]},
        {"angles": [0.1], "target": [0.5, 0.5]},
        {"tolerance": 0.0},
        {"tolerance": -1.0},
        {"tolerance": np.nan},
        {"max_turn": 0.0},
        {"max_turn": 4.0},
        {"budget": -1},
    ):
        with pytest.raises(ValueError, match=r"angles|target|tolerance|max_turn|budget"):
            least_steps(**{**good, **wrong})
    for several in ({"tolerance": [0.1, 0.2]}, {"free_joints": 0}, {"free_joints": 3}):
        with pytest.raises(ValueError, match=r"tolerance|free_joints"):
            batch([[0.1, 0.2]], [[1.0, 0.5]], **several)


@pytest.mark.parametrize("beyond", [0.0, 1e-12, 1e-8, 1e-7, 1e-6])
@pytest.mark.parametrize("joints", [3, 4, 5])
def test_pieces_too_short_for_a_direction_end_the_search(joints: int, beyond: float) -> None:
    """Arms that fold onto themselves after whole steps: a pose found so may be none."""
    rng = np.random.default_rng(joints)
    for steps in (1, 2, 3, 5, 8):
        for folded in range(1, joints):
            angles = rng.uniform(-np.pi, np.pi, joints)
            angles[folded] = np.pi - 0.1 * steps + beyond
            for _ in range(6):
                radius, turn = rng.uniform(0.0, joints), rng.uniform(-np.pi, np.pi)
                target = radius * np.array([np.cos(turn), np.sin(turn)])
                lower, upper, turned = batch(angles[None], target[None])
                assert 0 <= lower[0] <= upper[0] <= 32
                assert (np.abs(turned) <= 0.1 * upper[0] + 1e-9).all()
                tip = np.exp(1j * np.cumsum(angles + turned[0])).sum()
                assert abs(tip - complex(*target)) <= 0.2 + 1e-9
    lower, upper = least_steps([0.0, np.pi - 0.3 + 1e-7, np.pi / 2], [0.0, 1.15])[:2]
    assert 1 <= lower <= upper <= 32


@pytest.mark.parametrize("joints", range(1, 9))
def test_what_rounding_alone_could_reach_is_out_of_reach(joints: int) -> None:
    with pytest.raises(ValueError, match="out of reach"):
        least_steps(np.zeros(joints), [joints + 0.2, 0.0])
    arm = ReacherSimulator(ReacherTask(joints=joints))
    with pytest.raises(ValueError, match="out of reach"):
        arm.place(np.zeros(joints), [joints + 0.2, 0.0])
