"""The exact optimum of the arm: the minimum number of steps to move its tip to a target.

A step turns every joint by up to `max_turn`, so after T steps each joint can have any angle within
T * max_turn of the current one. The minimum is the least T for which one of these poses has its tip
within the tolerance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.reacher.task import LEAST_TOLERANCE, LEAST_TURN, MAX_JOINTS
from pursuit.rules.arrays import Array
from pursuit.validation import as_array, number, whole
from scripted_agents.exact.arm.least_steps_kernels import least_steps_kernel
from scripted_agents.exact.limits import MAX_ARM_NODES


def least_steps(
    angles: ArrayLike,
    target: ArrayLike,
    max_turn: float = 0.1,
    tolerance: float = 0.2,
    budget: int = MAX_ARM_NODES,
) -> tuple[int, int]:
    """Bounds (lower, upper) of the minimum steps of one arm; equal if it is known exactly.

    It is exact for any number of joints, unless the budget ends the search, or the nearest distance
    to the target is within rounding (1e-9) of the tolerance. `upper` steps are always sufficient.

    Args:
        angles: [n] radians, relative to the previous link; 1 to 8 joints.
        target: [2], with the base at (0, 0) and links of length 1.
        max_turn: radians that a joint turns in a step; above 0 and at most pi.
        tolerance: distance within which the target is reached; at least 1e-6.
        budget: nodes of the search after which only bounds are returned.

    Returns:
        The bounds; (0, 0) if the target is reached at the start (episodes have at least 1 step).

    Raises:
        ValueError: wrong shapes, values that are no numbers, or a target that no pose reaches.
    """
    pose, position = _floats("angles", angles, 1), _floats("target", target, 1)
    lower, upper, _ = least_steps_of(pose[None], position[None], max_turn, tolerance, budget=budget)
    return int(lower[0]), int(upper[0])


def least_steps_of(
    angles: ArrayLike,
    targets: ArrayLike,
    max_turn: float = 0.1,
    tolerance: ArrayLike = 0.2,
    free_joints: ArrayLike | None = None,
    budget: int = MAX_ARM_NODES,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """`least_steps` of many arms, and turns that reach the target in the upper bound.

    Args:
        angles: [arms, n] radians.
        targets: [arms, 2].
        max_turn: as in `least_steps`.
        tolerance: as in `least_steps`, for all arms or [arms].
        free_joints: number of joints that turn, for all arms or [arms]; the others are locked.
        budget: nodes of the search for each arm.

    Returns:
        [arms] int64 lower and [arms] int64 upper bounds; [arms, n] float64, the total turn of each
        joint to a pose at the target, at most upper * max_turn.

    Raises:
        ValueError: as `least_steps`.
    """
    poses, places = _floats("angles", angles, 2), _floats("targets", targets, 2)
    arms, n = poses.shape
    if not 1 <= n <= MAX_JOINTS:
        raise ValueError(f"angles of {n} joints; give 1 to {MAX_JOINTS}")
    if places.shape != (arms, 2):
        raise ValueError(f"targets of shape {places.shape}; give one for each arm, {(arms, 2)}")
    max_turn = number("max_turn", max_turn, LEAST_TURN, np.pi)
    budget = whole("budget", budget, 0, 2**62)
    within = _one_each("tolerance", tolerance, arms, "fiu").astype(np.float64)
    if not ((within >= LEAST_TOLERANCE) & np.isfinite(within)).all():
        raise ValueError(
            f"tolerance={tolerance!r}; give finite numbers, at least {LEAST_TOLERANCE}"
        )
    free = np.full(arms, n, dtype=np.int64)
    if free_joints is not None:
        free[:] = _one_each("free_joints", free_joints, arms, "iu")
        if arms and not 1 <= free.min() <= free.max() <= n:
            raise ValueError(f"free_joints={free_joints!r}; give 1 to {n} for {n} joints")
    poses = (poses + np.pi) % (2.0 * np.pi) - np.pi  # sines of large angles are inexact
    tails = _tails(poses, free)
    _check_reach(places, within, free, np.abs(tails))
    steps, turns = np.zeros((arms, 2), dtype=np.int64), np.zeros((arms, n))
    least_steps_kernel(poses, places, within, free, max_turn, budget, steps, turns)
    for arm in np.flatnonzero(np.isnan(turns).any(axis=1)):
        goal = poses[arm].copy()
        goal[: free[arm]] = pose_at(complex(*places[arm]), int(free[arm]), complex(tails[arm]))
        turns[arm] = (goal - poses[arm] + np.pi) % (2.0 * np.pi) - np.pi
    return steps[:, 0].copy(), steps[:, 1].copy(), turns


def pose_at(target: complex, joints: int, last: complex) -> NDArray[np.float64]:
    """[joints] radians: a pose with its tip at the target, or as near as possible.

    All links but the last form an arc with equal bends. Its chord, the last link and the line from
    the base to the target form a triangle. `last` is the last link if it points along the x-axis.
    """
    bent, tail, gap = joints - 1, abs(last), abs(target)
    angles = np.zeros(joints)
    tip = last
    if bent:
        chord = min(float(bent), gap + tail)
        low, high = 0.0, 2.0 * np.pi / bent
        for _ in range(60):  # the chord decreases from `bent` to 0 as the arc becomes a circle
            bend = 0.5 * (low + high)
            if np.sin(0.5 * bent * bend) > chord * np.sin(0.5 * bend):
                low = bend
            else:
                high = bend
        angles[1:] = low
        corner = 0.0
        if chord * tail > 0.0:
            cosine = (gap * gap - chord * chord - tail * tail) / (2.0 * chord * tail)
            corner = np.arccos(np.clip(cosine, -1.0, 1.0))
        along = 0.5 * (bent - 1) * low  # the direction of the chord relative to the first link
        angles[bent] = along + corner - np.angle(last) - (bent - 1) * low
        heading = np.exp(1j * np.cumsum(angles))
        tip = heading[:-1].sum() + heading[-1] * last
    angles[0] = np.angle(target) - np.angle(tip)
    return angles


def _tails(angles: NDArray[np.float64], free: NDArray[np.int64]) -> NDArray[np.complex128]:
    """[arms] complex: the last link that turns, with the links after it, along the x-axis."""
    locked = np.arange(angles.shape[1]) >= free[:, None]
    links = np.exp(1j * np.cumsum(np.where(locked, angles, 0.0), axis=1))
    return 1.0 + np.where(locked, links, 0.0).sum(axis=1)


def _check_reach(
    targets: NDArray[np.float64],
    tolerance: NDArray[np.float64],
    free: NDArray[np.int64],
    tails: NDArray[np.float64],
) -> None:
    radii, others = np.hypot(targets[:, 0], targets[:, 1]), free - 1.0
    most = others + tails
    least = np.maximum(2.0 * np.maximum(tails, free > 1) - most, 0.0)
    within = tolerance - 1e-9  # targets reached only by rounding are out of reach
    wrong = (radii - most > within) | (least - radii > within)
    if wrong.any():
        arm = int(wrong.argmax())
        raise ValueError(
            f"target {tuple(targets[arm].tolist())} is out of reach; give one at a radius from "
            f"{least[arm]:g} to {most[arm]:g}, or within tolerance={tolerance[arm]:g} of these"
        )


def _floats(name: str, value: ArrayLike, dimensions: int) -> NDArray[np.float64]:
    shape = "[arms, numbers]" if dimensions == 2 else "[numbers]"
    array = as_array(name, value, "fiu", f"finite numbers {shape}")
    if array.ndim != dimensions or not np.isfinite(array).all():
        raise ValueError(f"{name} of shape {array.shape}; give finite numbers {shape}")
    return np.ascontiguousarray(array, dtype=np.float64)


def _one_each(name: str, value: ArrayLike, arms: int, kinds: str) -> Array:
    rule = f"give one number, or one for each of the {arms} arms"
    array = as_array(name, value, kinds, rule)
    if array.shape not in ((), (arms,)):
        raise ValueError(f"{name} of shape {array.shape}; {rule}")
    return np.broadcast_to(array, arms)
