"""Processor time of the references of the arm: `python tools/benchmarks/bench_arm.py`."""

from __future__ import annotations

import time

import numpy as np

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
from train.machine import processor


def least_steps_of_starts(joints: int, starts: int, tolerance: float) -> None:
    """Print the time per start, and the share of exact solutions."""
    arms = ReacherSimulator(ReacherTask(joints=joints, tolerance=tolerance), starts)
    times, exact, steps = [], 0, 0
    for pose, target in zip(arms.angles[:, None], arms.targets[:, None], strict=True):
        began = time.process_time()
        lower, upper, _ = least_steps_of(pose, target, tolerance=tolerance)
        times.append(1000 * (time.process_time() - began))
        exact += int(lower[0] == upper[0])
        steps += int(upper[0])
    began = time.process_time()
    least_steps_of(arms.angles, arms.targets, tolerance=tolerance)
    together = 1000 * (time.process_time() - began) / starts
    print(
        f"least steps, {joints} joint(s), tolerance {tolerance:4.2f}: {np.mean(times):8.3f} ms "
        f"a start (longest {max(times):.3f}; in a batch {together:.4f}), "
        f"{100 * exact / starts:.1f} % exact, {steps / starts:.2f} steps",
        flush=True,
    )


def decisions(joints: int, games: int = 4096, steps: int = 50) -> None:
    """Print the time per action of every policy, in a batch."""
    policies = {
        "random": RandomArm(),
        **{method: InverseKinematics(method) for method in IK_METHODS},
        "thesis": ThesisInverseKinematics(),
    }
    if joints <= 4:
        policies["least steps"] = LeastStepsPolicy()
    for name, policy in policies.items():
        arms = ReacherSimulator(ReacherTask(joints=joints), games)
        policy.act(arms.view())
        arms.reset(seed=1)
        spent = 0.0
        for _ in range(steps):
            began = time.process_time()
            actions = policy.act(arms.view())
            spent += time.process_time() - began
            arms.step(actions)
        print(f"{name:15s} {joints} joint(s): {1e9 * spent / games / steps:9.0f} ns per action")


def main() -> None:
    """Run all benchmarks."""
    print(processor())
    arms = ReacherSimulator(ReacherTask(joints=2))
    began = time.process_time()
    least_steps_of(arms.angles, arms.targets)
    print(f"first call, including compilation: {time.process_time() - began:.1f} s")
    for tolerance, starts in ((0.2, 1000), (0.02, 100)):
        for joints in range(1, 9):
            least_steps_of_starts(joints, starts, tolerance)
    for joints in (1, 2, 4, 8):
        decisions(joints)


if __name__ == "__main__":
    main()
