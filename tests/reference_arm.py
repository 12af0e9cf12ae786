"""One step of an arm in complex numbers. Slow and obvious; it shares no code with the kernels.

A link is a number of size 1, an angle a turn of it: the tip is where all of them lead.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Arm:
    """A state: the angles, the target as a complex number, and the two counters."""

    angles: tuple[float, ...]
    target: complex
    held: int = 0
    steps: int = 0


@dataclass(frozen=True)
class Outcome:
    """What a step led to."""

    arm: Arm
    reward: float
    terminated: bool
    truncated: bool


def ends(angles: Sequence[float]) -> list[complex]:
    """Where every link ends."""
    return [
        sum(cmath.rect(1.0, sum(angles[: link + 1])) for link in range(last + 1))
        for last in range(len(angles))
    ]


def step(
    arm: Arm,
    action: Sequence[float],
    hold: int = 1,
    tolerance: float = 0.2,
    max_steps: int = 400,
    max_turn: float = 0.1,
    effort: float = 0.01,
    free_joints: int = 8,
) -> Outcome:
    turns = [turn if joint < free_joints else 0.0 for joint, turn in enumerate(action)]
    angles = tuple(angle + max_turn * turn for angle, turn in zip(arm.angles, turns, strict=True))
    distance = abs(ends(angles)[-1] - arm.target)
    held = arm.held + 1 if distance <= tolerance else 0
    after = replace(arm, angles=angles, held=held, steps=arm.steps + 1)
    reward = -distance / (2 * len(angles)) - effort * sum(map(abs, turns))
    terminated = held >= hold
    return Outcome(after, reward, terminated, not terminated and after.steps >= max_steps)


def observed(arm: Arm, tolerance: float = 0.2, with_angles: bool = False) -> list[float]:
    """In reach or not, base and ends relative to the target, the angles in one turn."""
    places = [0j, *ends(arm.angles)]
    relative = [place - arm.target for place in places]
    seen = [float(abs(relative[-1]) <= tolerance)]
    seen += [part for place in relative for part in (place.real, place.imag)]
    if with_angles:
        seen += [math.remainder(angle, 2 * math.pi) for angle in arm.angles]
    return seen


def difference(one: float, other: float) -> float:
    """Of two angles, on the circle."""
    return abs(math.remainder(one - other, 2 * math.pi))
