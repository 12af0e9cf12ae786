"""ArmState: an exact copy of arms, to be put back, elsewhere or later."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.task import LEAST_TOLERANCE, ReacherTask


@dataclass(frozen=True)
class ArmState:
    """An exact copy of arms, random streams and pending settings included; one row an arm."""

    angles: NDArray[np.float64]
    target: NDArray[np.float64]
    held: NDArray[np.int32]
    steps: NDArray[np.int32]
    free_joints: NDArray[np.int32]
    hold: NDArray[np.int32]
    tolerance: NDArray[np.float64]
    streams: NDArray[np.uint64]
    returns: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    next_fresh: NDArray[np.bool_]
    next_distance: NDArray[np.float64]
    next_free_joints: NDArray[np.int32]
    next_hold: NDArray[np.int32]
    next_tolerance: NDArray[np.float64]


def check_fits(state: Any, live: Mapping[str, NDArray[Any]], task: ReacherTask, arms: int) -> None:
    """Refuse a state that is none of so many arms of `task`, whose own arrays are `live`.

    Raises:
        ValueError: the number of arms, or the task, is another one, or a value that cannot be.
    """
    if not isinstance(state, ArmState):
        raise ValueError(f"state={state!r}; give what `get_state` gave")
    for name, array in live.items():
        given, shape = np.asarray(getattr(state, name)), (arms, *array.shape[1:])
        if given.shape != shape or given.dtype != array.dtype:
            raise ValueError(
                f"a state of other arms: {name} is {given.dtype} of shape {given.shape}, and "
                f"{array.dtype} of {shape} is needed: the same task, and as many arms as slots"
            )
    most = 2.0**31
    limits = {
        "angles": (-np.pi, np.pi),
        "target": (-most, most),
        "held": (0, task.max_steps),
        "steps": (0, task.max_steps),
        "free_joints": (1, task.joints),
        "hold": (1, task.max_steps),
        "tolerance": (LEAST_TOLERANCE, most),
        "next_distance": (-1.0, most),
        "next_free_joints": (-1, task.joints),
        "next_hold": (-1, task.max_steps),
        "next_tolerance": (-1.0, most),
    }
    for name, (least, largest) in limits.items():
        values = getattr(state, name)
        wrong = ~((values >= least) & (values <= largest))  # NaN is wrong too
        if wrong.any():
            raise ValueError(f"a state of other arms: {name} holds {values[wrong][0]}")
    for name in ("next_free_joints", "next_hold", "next_tolerance"):
        values = getattr(state, name)
        if ((values > -1) & (values <= 0)).any():
            raise ValueError(f"a state of other arms: {name} holds numbers that nobody can set")
    locked = np.arange(task.joints) >= state.free_joints[:, None]
    if (state.angles[locked] != 0.0).any():
        raise ValueError("a state of other arms: angles of locked joints that are not 0")
