"""Encodings of observations of an arm, and their spaces."""

from __future__ import annotations

from functools import lru_cache

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.reacher import rules
from pursuit.reacher.rules import Arms
from pursuit.reacher.task import ReacherTask
from pursuit.validation import one_of

ENCODINGS = ("positions", "positions_angles")


def space_of(task: ReacherTask, encoding: str) -> gymnasium.spaces.Box:
    """The space of an encoding (the same object at every call).

    An observation contains 1 if the tip is in reach of the target, else 0; x and y of the base and
    of the end of every link, relative to the target, in link lengths; with "positions_angles" also
    the angles in radians.

    Raises:
        ValueError: an unknown encoding.
    """
    return _space_of(task, one_of("observation", encoding, ENCODINGS))


@lru_cache
def _space_of(task: ReacherTask, encoding: str) -> gymnasium.spaces.Box:
    joints = task.joints
    # A target is at most `tolerance` outside the rim.
    most = [1.0] + [2.0 * joints + task.tolerance] * (2 * joints + 2)
    if encoding == "positions_angles":
        most += [np.pi] * joints
    high = np.array(most, dtype=np.float32)
    low = -high
    low[0] = 0.0
    return gymnasium.spaces.Box(low, high, dtype=np.float32)


def encode(
    task: ReacherTask, arms: Arms, encoding: str, out: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """[arms, numbers] float32, the observations: a new array, or `out`.

    Raises:
        ValueError: an unknown encoding, or an `out` of another shape or dtype.
    """
    shape = (len(arms.steps), *space_of(task, encoding).shape)
    if out is None:
        out = np.empty(shape, dtype=np.float32)
    elif not (isinstance(out, np.ndarray) and out.shape == shape and out.dtype == np.float32):
        raise ValueError(f"out={out!r}; a float32 array of shape {shape} is needed")
    rules.observe_arms(*arms, encoding == "positions_angles", out)
    return out
