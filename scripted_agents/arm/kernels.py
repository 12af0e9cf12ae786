"""Compiled kernels of the kinematic policies of an arm: how its joints turn towards the target.

The Jacobian J is [2, n]: column j is the way from joint j to the tip, turned by a right angle. With
e the way from the tip to the target, the methods turn the joints by

    transpose         a J' e (Wolovich and Elliott, 1984), a being 0.7 of what shortens e most to
                      first order, which is <e, J J' e> / |J J' e|^2: the most itself goes to and
                      fro across a narrow valley for ever (Raydan and Svaiter, 2002)
    pseudo-inverse    J' (J J')^-1 e, and of the one direction that is left where J J' has no
                      inverse (Whitney, 1969)
    damped            J' (J J' + d^2)^-1 e (Wampler, 1986; Nakamura and Hanafusa, 1986)
    cyclic            from the last joint to the first, each so that the tip, as the joints behind
                      have put it, comes nearest to the target (Wang and Chen, 1991)

The first three scale all turns alike where one exceeds what a step allows: the tip goes on in the
direction that was asked for. A turn of the last is right by itself, and is cut by itself: a part of
it brings the tip nearer too.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt
from typing import Any

from pursuit.compilation.compiled import compiled, subroutine

TRANSPOSE, PSEUDO_INVERSE, DAMPED, CYCLIC = 0, 1, 2, 3

SINGULAR = 1e-9
"""J J' has no inverse where its determinant is so small a part of its trace's square."""
SHORTENED = 0.7
"""The share of the best step of steepest descent that is taken."""
STUCK = 1e-6
"""A largest turn of so small a part of a step leads nowhere: the arm points at the target."""


@compiled
def turn_arms(
    method: int, angles: Any, targets: Any, tolerances: Any, free_joints: Any, max_turn: float,
    damping: float, actions: Any,
) -> None:  # fmt: skip
    """Fill `actions` [arms, n] in [-1, 1] with a step towards the targets; none when in reach."""
    for arm in range(angles.shape[0]):
        near = turn_towards(
            method, angles[arm], targets[arm], tolerances[arm], free_joints[arm], max_turn,
            damping, actions[arm],
        )  # fmt: skip
        for joint in range(angles.shape[1]):
            action = 0.0 if near else actions[arm, joint] / max_turn
            actions[arm, joint] = min(max(action, -1.0), 1.0)


@compiled
def solve_arms(
    method: int, angles: Any, targets: Any, free_joints: Any, damping: float, precision: float,
    most: int, turns: Any,
) -> None:  # fmt: skip
    """Turn `angles` [arms, n] until the tip is at the target, in `most` iterations or before.

    `turns` [arms, n] is room to work in. An iteration turns a joint by 1 radian at most.
    """
    for arm in range(angles.shape[0]):
        for _ in range(most):
            if turn_towards(
                method, angles[arm], targets[arm], precision, free_joints[arm], 1.0, damping,
                turns[arm],
            ):  # fmt: skip
                break
            for joint in range(angles.shape[1]):
                angles[arm, joint] += turns[arm, joint]


@subroutine
def turn_towards(
    method: int, angles: Any, target: Any, tolerance: float, free: int, most: float,
    damping: float, turns: Any,
) -> bool:  # fmt: skip
    """Fill `turns` [n] with up to `most` radians each; True if the tip is in reach already."""
    n = angles.shape[0]
    x, y, direction = 0.0, 0.0, 0.0
    for joint in range(n):
        turns[joint] = 0.0
        direction += angles[joint]
        x += cos(direction)
        y += sin(direction)
    right, up = target[0] - x, target[1] - y
    if sqrt(right * right + up * up) <= tolerance:
        return True
    if method == CYCLIC:
        turn_in_cycle(angles, target, free, most, direction, x, y, turns)
    else:
        turn_by_jacobian(method, angles, free, damping, x, y, right, up, turns)
    largest = 0.0
    for joint in range(free):
        largest = max(largest, abs(turns[joint]))
    if largest <= STUCK * most:
        for joint in range(free):  # bend a straight arm so that its tip comes back along its line
            turns[joint] = 0.5 * most if joint == 0 else -most
    elif largest > most:
        for joint in range(free):
            turns[joint] *= most / largest
    return False


@subroutine
def turn_by_jacobian(
    method: int, angles: Any, free: int, damping: float, x: float, y: float, right: float,
    up: float, turns: Any,
) -> None:  # fmt: skip
    """The turns that move the tip at (x, y) by (right, up), as far as the method allows."""
    a, b, c = 0.0, 0.0, 0.0  # J J' is [[a, b], [b, c]]
    base_x, base_y, direction = 0.0, 0.0, 0.0
    for joint in range(free):
        across, along = base_y - y, x - base_x
        a += across * across
        b += across * along
        c += along * along
        direction += angles[joint]
        base_x += cos(direction)
        base_y += sin(direction)
    # The force on the tip that turns the joints.
    push_x, push_y, scale = right, up, 1.0
    if method == DAMPED:
        a += damping * damping
        c += damping * damping
    determinant, trace = a * c - b * b, a + c
    if method == TRANSPOSE:
        moved_x, moved_y = a * right + b * up, b * right + c * up
        moved = moved_x * moved_x + moved_y * moved_y
        scale = SHORTENED * (right * moved_x + up * moved_y) / moved if moved > 0.0 else 0.0
    elif determinant > SINGULAR * trace * trace:
        push_x, push_y = c * right - b * up, a * up - b * right
        scale = 1.0 / determinant
    elif trace > 0.0:  # a matrix of rank 1 over its trace's square is its pseudo-inverse
        push_x, push_y = a * right + b * up, b * right + c * up
        scale = 1.0 / (trace * trace)
    base_x, base_y, direction = 0.0, 0.0, 0.0
    for joint in range(free):
        turns[joint] = scale * ((base_y - y) * push_x + (x - base_x) * push_y)
        direction += angles[joint]
        base_x += cos(direction)
        base_y += sin(direction)


@subroutine
def turn_in_cycle(
    angles: Any, target: Any, free: int, most: float, direction: float, x: float, y: float,
    turns: Any,
) -> None:  # fmt: skip
    """From the last joint to the first, each as far as it may towards the target."""
    base_x, base_y = x, y
    for joint in range(angles.shape[0] - 1, -1, -1):
        base_x -= cos(direction)
        base_y -= sin(direction)
        direction -= angles[joint]
        if joint >= free:
            continue
        along, across = x - base_x, y - base_y
        right, up = target[0] - base_x, target[1] - base_y
        turn = atan2(along * up - across * right, along * right + across * up)
        turn = min(max(turn, -most), most)
        turns[joint] = turn
        x = base_x + cos(turn) * along - sin(turn) * across
        y = base_y + sin(turn) * along + cos(turn) * across
