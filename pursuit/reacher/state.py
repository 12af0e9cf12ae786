"""Checks of the saved state of arms before it is restored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.task import LEAST_TOLERANCE, ReacherTask
from pursuit.simulator.state import SimulatorState, check_arrays, check_range


def check_fits(
    state: SimulatorState, live: Mapping[str, NDArray[Any]], task: ReacherTask, arms: int
) -> None:
    """Check a state for `arms` arms of `task`; `live` are the arrays of the simulator.

    Raises:
        ValueError: a different number of arms or another task, or invalid values.
    """
    check_arrays(state, live, arms)
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
        if np.isnan(getattr(state, name)).any():
            raise ValueError(f"state does not match this simulator: {name} contains NaN")
        check_range(state, name, least, largest)
    for name in ("next_free_joints", "next_hold", "next_tolerance"):
        values = getattr(state, name)
        if ((values > -1) & (values <= 0)).any():
            raise ValueError(f"state does not match this simulator: {name} must be positive or -1")
    locked = np.arange(task.joints) >= state.free_joints[:, None]
    if (state.angles[locked] != 0.0).any():
        raise ValueError("state does not match this simulator: angles of locked joints are not 0")
