"""The rules of the arm: functions for one arm of a batch, and kernels over the batch.

    base o---o---o  tip        joint j turns link j and all links after it
         0   1   2             angles[j] is relative to the link before, angles[0] to the x-axis

Links have length 1. Angles are in [-pi, pi); joints have no stops, so differences of angles are
taken on the circle. Inner functions take `Arms`, `Outcome`, `NextEpisode` and `ArmRules`; the
kernels take flat arrays, as unboxing named tuples takes longer than a step of one arm.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled, inlined
from pursuit.rules.arrays import Flags, Ints, Reals, Words
from pursuit.rules.randomness import next_uniform

STARTS_STREAM, POLICY_STREAM, NUM_STREAMS = 0, 1, 2
KEPT, RANDOM, FIXED = 0, 1, 2
DONE, BAD_ACTION = 0, 1
ROUNDING = 1e-6
"""Actions outside [-1, 1] by at most this much are clipped."""
UNCHANGED = -1.0
"""In `NextEpisode`: the setting keeps its value."""
QUARTER = round(math.pi / 2.0 * 2**40) / 2**40
QUARTER_REST = (math.pi / 2.0 - QUARTER) + 6.123233995736766e-17
"""pi / 2 as a sum of two floats; small multiples of the first are exact."""


class Arms(NamedTuple):
    """The state of a batch of arms, current or at the end of the last episodes.

    angles: [arms, joints] float64, radians. target: [arms, 2] float64, the base is at (0, 0). ends:
    [arms, joints, 2] float64, the end of every link, a function of the angles; the last one is the
    tip. held: [arms] int32, consecutive steps with the tip in reach. steps: [arms] int32.
    free_joints: [arms] int32; joints with this index or above are locked straight. hold: [arms]
    int32, and tolerance: [arms] float64, as in `ReacherTask`.
    """

    angles: Reals
    target: Reals
    ends: Reals
    held: Ints
    steps: Ints
    free_joints: Ints
    hold: Ints
    tolerance: Reals


class Outcome(NamedTuple):
    """The results of a step.

    rewards: [arms] float32. returns, episode_returns: [arms] float64. terminated, truncated: [arms]
    bool. episode_lengths: [arms] int32. final: the `Arms` at the end of the last episodes.
    """

    rewards: NDArray[np.float32]
    returns: Reals
    episode_returns: Reals
    terminated: Flags
    truncated: Flags
    episode_lengths: Ints
    final: Arms


class NextEpisode(NamedTuple):
    """Settings of the next episode, each [arms].

    fresh: bool, whether the pose is drawn although `start` is KEPT. distance: float64, number of
    steps in which the target is reachable; UNCHANGED is no limit. free_joints, hold: int32, and
    tolerance: float64, as in `Arms`.
    """

    fresh: Flags
    distance: Reals
    free_joints: Ints
    hold: Ints
    tolerance: Reals


class ArmRules(NamedTuple):
    """The numbers of a `ReacherTask`; start is KEPT, RANDOM or FIXED."""

    start: int
    max_steps: int
    max_turn: float
    effort: float


@inlined
def wrapped(angle: float) -> float:
    """The same direction in [-pi, pi); the angle is less than a full turn outside."""
    if angle >= math.pi:
        return angle - 2.0 * math.pi
    return angle + 2.0 * math.pi if angle < -math.pi else angle


@inlined
def cosine_and_sine(angle: float) -> tuple[float, float]:
    """Cosine and sine, to 2e-16 for a few turns, in less than half of the library's time.

    They are Taylor series around the nearest quarter turn; the omitted terms are below
    (pi / 4)**17 / 17!.
    """
    quarters = math.floor(angle / QUARTER + 0.5)
    rest = (angle - quarters * QUARTER) - quarters * QUARTER_REST
    square = rest * rest
    sine = 1.0 - square * (1.0 / (14 * 15))
    sine = 1.0 - square * (1.0 / (12 * 13)) * sine
    sine = 1.0 - square * (1.0 / (10 * 11)) * sine
    sine = 1.0 - square * (1.0 / (8 * 9)) * sine
    sine = 1.0 - square * (1.0 / (6 * 7)) * sine
    sine = 1.0 - square * (1.0 / (4 * 5)) * sine
    sine = rest - rest * (square * (1.0 / (2 * 3)) * sine)
    cosine = 1.0 - square * (1.0 / (15 * 16))
    cosine = 1.0 - square * (1.0 / (13 * 14)) * cosine
    cosine = 1.0 - square * (1.0 / (11 * 12)) * cosine
    cosine = 1.0 - square * (1.0 / (9 * 10)) * cosine
    cosine = 1.0 - square * (1.0 / (7 * 8)) * cosine
    cosine = 1.0 - square * (1.0 / (5 * 6)) * cosine
    cosine = 1.0 - square * (1.0 / (3 * 4)) * cosine
    cosine = 1.0 - square * 0.5 * cosine
    quarter = int(quarters) & 3
    x = sine if quarter & 1 else cosine
    y = cosine if quarter & 1 else sine
    return (-x if quarter == 1 or quarter == 2 else x), (-y if quarter >= 2 else y)


@inlined
def find_ends(angles: Reals, ends: Reals) -> None:
    """Write the ends [joints, 2] of the links of an arm with these angles [joints]."""
    direction, x, y = 0.0, 0.0, 0.0
    for joint in range(angles.shape[0]):
        direction += angles[joint]
        cosine, sine = cosine_and_sine(direction)
        x += cosine
        y += sine
        ends[joint, 0], ends[joint, 1] = x, y


@inlined
def distance_of(arms: Arms, arm: int) -> float:
    """The distance from the tip to the target."""
    last = arms.angles.shape[1] - 1
    across = arms.ends[arm, last, 0] - arms.target[arm, 0]
    up = arms.ends[arm, last, 1] - arms.target[arm, 1]
    return math.sqrt(across * across + up * up)


@inlined
def least_radius(joints: int, free_joints: int) -> int:
    """The smallest distance from the tip to the base if only the first joints are free.

    The last free joint turns a rigid link of length joints - free_joints + 1, and the links before
    it can fold back.
    """
    return max(joints - 2 * free_joints + 2, 0)


@inlined
def begin(
    arms: Arms, outcome: Outcome, pending: NextEpisode, streams: Words, rules: ArmRules, arm: int
) -> None:
    """Start an episode: the pose, then the target."""
    joints = arms.angles.shape[1]
    stream = streams[arm]
    if pending.free_joints[arm] >= 0:
        arms.free_joints[arm] = pending.free_joints[arm]
    if pending.hold[arm] >= 0:
        arms.hold[arm] = pending.hold[arm]
    if pending.tolerance[arm] >= 0.0:
        arms.tolerance[arm] = pending.tolerance[arm]
    free = arms.free_joints[arm]
    drawn = rules.start == RANDOM or (rules.start == KEPT and pending.fresh[arm])
    pending.fresh[arm] = False
    for joint in range(joints):
        if joint >= free or rules.start == FIXED:
            arms.angles[arm, joint] = 0.0
        elif drawn:
            turn = next_uniform(stream, STARTS_STREAM)
            arms.angles[arm, joint] = wrapped(2.0 * math.pi * turn - math.pi)
    most = pending.distance[arm] * rules.max_turn
    if 0.0 <= most < math.pi:
        # The tip of a pose that is at most this many steps away, so the target is reachable.
        direction, x, y = 0.0, 0.0, 0.0
        for joint in range(joints):
            direction += arms.angles[arm, joint]
            if joint < free:
                direction += most * (2.0 * next_uniform(stream, STARTS_STREAM) - 1.0)
            x += math.cos(direction)
            y += math.sin(direction)
    else:
        inner = least_radius(joints, free)
        radius = inner + (joints - inner) * next_uniform(stream, STARTS_STREAM)
        angle = 2.0 * math.pi * next_uniform(stream, STARTS_STREAM)
        x, y = radius * math.cos(angle), radius * math.sin(angle)
    arms.target[arm, 0], arms.target[arm, 1] = x, y
    find_ends(arms.angles[arm], arms.ends[arm])
    arms.held[arm] = arms.steps[arm] = 0
    outcome.returns[arm] = outcome.rewards[arm] = 0.0


@inlined
def move(
    arms: Arms, outcome: Outcome, pending: NextEpisode, streams: Words, rules: ArmRules, arm: int,
    actions: Reals, auto_restart: bool,
) -> None:  # fmt: skip
    """Turn the joints of one arm, and set its reward and flags."""
    if outcome.terminated[arm] or outcome.truncated[arm]:
        if not auto_restart:  # it waits for a reset
            outcome.rewards[arm] = 0.0
            return
        outcome.terminated[arm] = outcome.truncated[arm] = False
    effort = 0.0
    for joint in range(arms.free_joints[arm]):
        turn = min(max(actions[arm, joint], -1.0), 1.0)
        effort += abs(turn)
        arms.angles[arm, joint] = wrapped(arms.angles[arm, joint] + rules.max_turn * turn)
    find_ends(arms.angles[arm], arms.ends[arm])
    distance = distance_of(arms, arm)
    arms.steps[arm] += 1
    arms.held[arm] = arms.held[arm] + 1 if distance <= arms.tolerance[arm] else 0
    reward = -distance / (2.0 * arms.angles.shape[1]) - rules.effort * effort
    outcome.rewards[arm] = reward
    outcome.returns[arm] += reward
    outcome.terminated[arm] = arms.held[arm] >= arms.hold[arm]
    outcome.truncated[arm] = not outcome.terminated[arm] and arms.steps[arm] >= rules.max_steps
    if outcome.terminated[arm] or outcome.truncated[arm]:
        keep_final(arms, outcome, arm)
        if auto_restart:
            begin(arms, outcome, pending, streams, rules, arm)
            outcome.rewards[arm] = reward


@inlined
def keep_final(arms: Arms, outcome: Outcome, arm: int) -> None:
    """Save the results of an episode before a restart overwrites them."""
    final = outcome.final
    outcome.episode_returns[arm] = outcome.returns[arm]
    outcome.episode_lengths[arm] = arms.steps[arm]
    for joint in range(arms.angles.shape[1]):
        final.angles[arm, joint] = arms.angles[arm, joint]
        for axis in range(2):
            final.ends[arm, joint, axis] = arms.ends[arm, joint, axis]
    for axis in range(2):
        final.target[arm, axis] = arms.target[arm, axis]
    final.held[arm], final.steps[arm] = arms.held[arm], arms.steps[arm]
    final.free_joints[arm], final.hold[arm] = arms.free_joints[arm], arms.hold[arm]
    final.tolerance[arm] = arms.tolerance[arm]


# -- the kernels over a batch: start, step, observe ------------------------------------------------


@inlined
def arms_of(arrays: Any) -> tuple[Arms, Outcome, NextEpisode, Words, ArmRules]:
    """The flat arguments of a kernel as named tuples; `ReacherSimulator` passes them in this order.

    They are the fields of `Arms`, of `Outcome` without `final`, of `final`, of `NextEpisode`, the
    streams [arms, streams] uint64, and the fields of `ArmRules`.
    """
    arms, final = Arms(*arrays[0:8]), Arms(*arrays[14:22])
    outcome = Outcome(*arrays[8:14], final)  # type: ignore[call-arg]
    return arms, outcome, NextEpisode(*arrays[22:27]), arrays[27], ArmRules(*arrays[28:32])


@compiled
def start_arms(chosen: Flags, *arrays: Any) -> None:
    """Start new episodes in the arms of the mask `chosen` [arms]; `arrays` as in `arms_of`."""
    arms, outcome, pending, streams, rules = arms_of(arrays)
    for arm in range(chosen.shape[0]):
        if chosen[arm]:
            outcome.terminated[arm] = outcome.truncated[arm] = False
            begin(arms, outcome, pending, streams, rules, arm)


@compiled
def step_arms(actions: Reals, auto_restart: bool, *arrays: Any) -> int:
    """Move all arms by actions [arms, joints]; `arrays` as in `arms_of`.

    BAD_ACTION, and no arm moves, if an action is out of range or NaN.
    """
    for arm in range(actions.shape[0]):
        for joint in range(actions.shape[1]):
            if not abs(actions[arm, joint]) <= 1.0 + ROUNDING:
                return BAD_ACTION
    arms, outcome, pending, streams, rules = arms_of(arrays)
    for arm in range(actions.shape[0]):
        move(arms, outcome, pending, streams, rules, arm, actions, auto_restart)
    return DONE


@compiled
def find_all_ends(angles: Reals, ends: Reals) -> None:
    """Write ends [arms, joints, 2] of angles [arms, joints]."""
    for arm in range(angles.shape[0]):
        find_ends(angles[arm], ends[arm])


@compiled
def observe_arms(
    angles: Reals, target: Reals, ends: Reals, held: Ints, steps: Ints, free_joints: Ints,
    hold: Ints, tolerance: Reals, with_angles: bool, out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Write the observations of all arms into out [arms, numbers] float32.

    They are 1 if the tip is in reach, else 0; the base and the ends of all links relative to the
    target; and with `with_angles` the angles.
    """
    arms = Arms(angles, target, ends, held, steps, free_joints, hold, tolerance)
    joints = angles.shape[1]
    for arm in range(angles.shape[0]):
        out[arm, 0] = 1.0 if distance_of(arms, arm) <= tolerance[arm] else 0.0
        x, y = target[arm, 0], target[arm, 1]
        out[arm, 1], out[arm, 2] = -x, -y
        for joint in range(joints):
            out[arm, 3 + 2 * joint] = ends[arm, joint, 0] - x
            out[arm, 4 + 2 * joint] = ends[arm, joint, 1] - y
        if with_angles:
            for joint in range(joints):
                out[arm, 3 + 2 * joints + joint] = angles[arm, joint]
