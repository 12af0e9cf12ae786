"""Compiled kernels of inverse kinematics: the turns of the joints towards the target.

The Jacobian J is [2, n]: column j is the vector from joint j to the tip, rotated by a right angle.
Let e be the vector from the tip to the target. The methods turn the joints by

    transpose         a J' e (Wolovich and Elliott, 1984), with a step size a of 0.7 times that of
                      steepest descent, <e, J J' e> / |J J' e|^2, as the full step size oscillates
                      in narrow valleys (Raydan and Svaiter, 2002)
    pseudo-inverse    J' (J J')^+ e (Whitney, 1969)
    damped            J' (J J' + d^2)^-1 e (Wampler, 1986; Nakamura and Hanafusa, 1986)
    cyclic            from the last joint to the first, each to the angle that minimises the
                      distance to the target given the later joints (Wang and Chen, 1991)

If a turn exceeds the maximum of a step, the first three methods scale all turns by one factor,
which keeps the direction of the tip. The cyclic method clips each turn separately, as a part of a
turn also reduces the distance.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt
from typing import Any

from pursuit.compilation.compiled import compiled, subroutine

TRANSPOSE, PSEUDO_INVERSE, DAMPED, CYCLIC = 0, 1, 2, 3

SINGULAR = 1e-9
"""J J' counts as singular if its determinant is at most this multiple of its squared trace."""
SHORTENED = 0.7
"""Step size as a multiple of the optimal one of steepest descent."""
STUCK = 1e-6
"""If all turns are at most this share of a step, the arm points at the target."""


@compiled
def turn_arms(
    method: int, angles: Any, targets: Any, tolerances: Any, free_joints: Any, max_turn: float,
    damping: float, actions: Any,
) -> None:  # fmt: skip
    """Fill `actions` [arms, n] in [-1, 1] with a step to the targets; 0 within the tolerance."""
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
    """Turn `angles` [arms, n] until the tip is at the target, in at most `most` iterations.

    `turns` [arms, n] is scratch memory. An iteration turns a joint by at most 1 radian.
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
    """Fill `turns` [n] with up to `most` radians each; True if the tip is within the tolerance."""
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
        for joint in range(free):  # bend a straight arm, so that its tip moves back along its line
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
    """The turns by which a method moves the tip at (x, y) by (right, up)."""
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
    # The vector that J' is multiplied by.
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
    elif trace > 0.0:  # a matrix of rank 1 over its squared trace is its pseudo-inverse
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
    """The turns of cyclic coordinate descent, each of at most `most` radians."""
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
