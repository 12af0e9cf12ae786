"""Who moves an arm without learning, against other solvers, linear algebra and the least steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize_scalar

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from scripted_agents import (
    IK_METHODS,
    InverseKinematics,
    LeastStepsPolicy,
    RandomArm,
    ThesisInverseKinematics,
    least_steps_of,
)
from scripted_agents.agents.arm import DAMPING


def tip(angles: Any) -> Any:
    directions = np.cumsum(angles)
    return np.array([np.cos(directions).sum(), np.sin(directions).sum()])


def jacobian(angles: Any) -> Any:
    """[2, joints], by differences."""
    bumps = 1e-6 * np.eye(len(angles))
    return np.stack([(tip(angles + b) - tip(angles - b)) / 2e-6 for b in bumps], axis=1)


def simulator(joints: int, arms: int = 200, seed: int = 0, **settings: Any) -> ReacherSimulator:
    return ReacherSimulator(ReacherTask(joints=joints, **settings), arms, seed, auto_restart=False)


def play(arms: ReacherSimulator, policy: Any) -> Any:
    """The lengths of the episodes, which all have reached their targets."""
    while not arms.ended.all():
        arms.step(policy.act(arms.view()))
    assert arms.terminated.all(), policy
    return arms.episode_lengths.copy()


def least_lengths(arms: ReacherSimulator) -> Any:
    lower, upper, _ = least_steps_of(
        arms.angles, arms.targets, arms.task.max_turn, arms.arms.tolerance, arms.arms.free_joints
    )
    assert np.array_equal(lower, upper)
    return np.maximum(upper, 1) + arms.task.hold - 1


@pytest.mark.parametrize("joints", [1, 2, 3, 5])
@pytest.mark.parametrize("hold", [1, 4])
def test_the_least_steps_are_played(joints: int, hold: int) -> None:
    arms = simulator(joints, hold=hold)
    wanted = least_lengths(arms)
    assert np.array_equal(play(arms, LeastStepsPolicy()), wanted)


def test_the_least_steps_are_played_episode_after_episode() -> None:
    """Kept poses, targets of the moment, other tolerances, locked joints, one policy for all."""
    arms, policy = simulator(4, 50), LeastStepsPolicy()
    arms.configure(tolerance=np.linspace(0.05, 0.5, 50), free_joints=[1 + i % 4 for i in range(50)])
    for episode in range(4):
        arms.reset(seed=3 if episode == 0 else None)
        wanted = least_lengths(arms)
        assert np.array_equal(play(arms, policy), wanted)


def test_a_plan_that_does_not_fit_is_made_anew() -> None:
    policy, other = LeastStepsPolicy(), simulator(3, seed=9)
    for _ in range(3):
        other.step(policy.act(other.view()))  # plans of other arms, in mid-episode
    arms = simulator(3)
    for _ in range(5):
        arms.step(RandomArm().act(arms.view()))
    lengths, running = least_lengths(arms) + 5, ~arms.ended
    play(arms, policy)
    assert np.array_equal(arms.episode_lengths[running], lengths[running])
    fewer = simulator(3, 7)
    assert play(fewer, policy).shape == (7,)


@pytest.mark.parametrize(
    "policy",
    [*map(InverseKinematics, IK_METHODS), ThesisInverseKinematics()],
    ids=[*IK_METHODS, "thesis"],
)
@pytest.mark.parametrize("joints", [1, 2, 3, 8])
def test_inverse_kinematics_reach_what_a_solver_reaches(policy: Any, joints: int) -> None:
    """Every target, as SciPy's least squares finds a pose for it; never before the least steps."""
    arms = simulator(joints, 40 if joints == 8 else 200)
    for pose, target in zip(arms.angles[:20], arms.targets[:20], strict=True):
        found = least_squares(lambda x, target=target: tip(x) - target, pose + 0.1)
        assert np.linalg.norm(tip(found.x) - target) < 0.2
    least = least_lengths(arms)
    assert (play(arms, policy) >= least).all()
    assert (np.linalg.norm(arms.tips - arms.targets, axis=1) <= 0.2).all()


@pytest.mark.parametrize("method", IK_METHODS)
@pytest.mark.parametrize("joints", [2, 3, 8])
def test_straight_arms_find_a_way(method: str, joints: int) -> None:
    """All joints, tip and target on one line, where the Jacobian sees no way along it."""
    arms = simulator(joints, 12)
    targets = [[radius * joints, 0.0] for radius in np.linspace(-1.0, 1.0, 12)]
    arms.place(np.zeros(joints), targets)
    play(arms, InverseKinematics(method))


def turns_of(policy: InverseKinematics, arms: ReacherSimulator) -> Any:
    return arms.task.max_turn * policy.act(arms.view())


def test_turns_are_those_of_linear_algebra() -> None:
    """Small moves, which are not cut, and the direction of large ones, by NumPy."""
    rng = np.random.default_rng(0)
    for joints in (1, 2, 3, 6):
        arms = simulator(joints, 30, tolerance=1e-3, max_turn=3.0)
        for _ in range(2):
            found = {m: turns_of(InverseKinematics(m), arms) for m in IK_METHODS}
            for arm, (pose, target) in enumerate(zip(arms.angles, arms.targets, strict=True)):
                matrix, error = jacobian(pose), target - tip(pose)
                wanted = {
                    "pseudo-inverse": np.linalg.pinv(matrix, rcond=1e-4) @ error,
                    "damped": np.linalg.lstsq(
                        np.vstack([matrix, DAMPING * np.eye(joints)]),
                        np.concatenate([error, np.zeros(joints)]),
                    )[0],
                }
                for name, turns in wanted.items():
                    turns = turns * min(1.0, 3.0 / np.abs(turns).max())
                    assert found[name][arm] == pytest.approx(turns, rel=1e-3, abs=1e-5), name
                along = matrix.T @ error
                moved = matrix @ found["transpose"][arm]
                size = np.linalg.norm(found["transpose"][arm]) * np.linalg.norm(along)
                assert found["transpose"][arm] @ along == pytest.approx(size, rel=1e-6)
                if np.abs(found["transpose"][arm]).max() < 2.999:
                    best = minimize_scalar(
                        lambda share, moved=moved, error=error: ((share * moved - error) ** 2).sum()
                    )
                    assert best.x == pytest.approx(1 / 0.7, rel=1e-4)
            bent = arms.angles + rng.uniform(-0.05, 0.05, arms.angles.shape)
            near = np.array([tip(pose) for pose in bent])
            arms.place(
                arms.angles.copy(), near * np.minimum(1, joints / np.hypot(*near.T))[:, None]
            )


def test_a_cycle_turns_every_joint_to_where_the_tip_is_nearest() -> None:
    arms = simulator(4, 10, tolerance=1e-3, max_turn=0.7)
    turns = turns_of(InverseKinematics("cyclic"), arms)
    for pose, target, turned in zip(arms.angles, arms.targets, turns, strict=True):
        now = pose.copy()
        for joint in range(3, -1, -1):
            choices = np.linspace(-0.7, 0.7, 401)
            bent = now + choices[:, None] * (np.arange(4) == joint)
            distance = [np.linalg.norm(tip(each) - target) for each in bent]
            now[joint] += turned[joint]
            assert np.linalg.norm(tip(now) - target) <= min(distance) + 1e-6


@pytest.mark.parametrize("method", IK_METHODS)
def test_large_turns_are_scaled_and_arms_in_reach_hold_still(method: str) -> None:
    arms = simulator(5, tolerance=1.0)
    policy = InverseKinematics(method)
    actions = policy.act(arms.view())
    far = np.linalg.norm(arms.tips - arms.targets, axis=1) > 1.0
    assert np.abs(actions).max() <= 1.0 and far.any() and not far.all()
    assert (np.abs(actions[far]).max(axis=1) > 0).all() and not actions[~far].any()
    arms.configure(free_joints=2)
    arms.reset(seed=1)
    assert not policy.act(arms.view())[:, 2:].any()


def test_the_thesis_goes_straight_to_a_pose_at_the_target() -> None:
    arms = simulator(3, tolerance=1e-2)
    begin, policy = arms.angles.copy(), ThesisInverseKinematics()
    assert repr(policy) == "ThesisInverseKinematics(0.001, 1000)"
    first = policy.act(arms.view())
    arms.step(first)
    whole = np.abs(first).max(axis=1) > 1.0 - 1e-9
    assert whole[~arms.ended].all()
    for _ in range(40):
        actions = policy.act(arms.view())
        # In proportion, all the way: the next action is a part of the first.
        part = (actions * first).sum(axis=1) / (first * first).sum(axis=1)
        running = ~arms.ended
        assert actions[running] == pytest.approx((part[:, None] * first)[running], abs=1e-9)
        arms.step(actions)
    assert arms.terminated.all()
    goal = np.stack([tip(pose) for pose in arms.final.angles])
    assert np.linalg.norm(goal - arms.targets, axis=1).max() <= 1e-2
    away = np.abs((arms.final.angles - begin + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
    assert (arms.episode_lengths == np.maximum(np.ceil(away / 0.1 - 1e-9), 1)).all()


@pytest.mark.parametrize(
    "make", [RandomArm, InverseKinematics, LeastStepsPolicy, ThesisInverseKinematics]
)
def test_an_arm_does_not_depend_on_its_batch(make: Any) -> None:
    together, policy = ReacherSimulator(ReacherTask(joints=3), 5, seed=2), make()
    alone = [ReacherSimulator(together.task, 1, seed=2, first_game=i) for i in range(5)]
    policies = [make() for _ in alone]
    for _ in range(60):
        together.step(policy.act(together.view()))
        for arm, own in zip(alone, policies, strict=True):
            arm.step(own.act(arm.view()))
    assert np.array_equal(together.angles, np.concatenate([arm.angles for arm in alone]))


def test_random_arms_are_uniform() -> None:
    arms = simulator(2, 2000)
    drawn = np.stack([RandomArm().act(arms.view()) for _ in range(20)])
    assert -1.0 <= drawn.min() < -0.999 and 0.999 < drawn.max() <= 1.0
    assert abs(drawn.mean()) < 0.01 and drawn.var() == pytest.approx(1 / 3, rel=0.02)
    assert abs(np.corrcoef(drawn.reshape(-1, 2).T)[0, 1]) < 0.02
    discrete = RandomArm().act(simulator(2, 3000, discrete_actions=True).view())
    values, counts = np.unique(discrete, return_counts=True)
    assert values.tolist() == [-1.0, 0.0, 1.0] and counts.min() > 1850


def test_what_is_refused() -> None:
    for wrong in (
        lambda: InverseKinematics("newton"),
        lambda: InverseKinematics(damping=0.0),
        lambda: LeastStepsPolicy(budget=-1),
        lambda: ThesisInverseKinematics(precision=0.0),
        lambda: ThesisInverseKinematics(iterations=0),
    ):
        with pytest.raises(ValueError, match=r"method|damping|budget|precision|iterations"):
            wrong()
    assert repr(InverseKinematics()) == "InverseKinematics('damped', damping=0.3)"
