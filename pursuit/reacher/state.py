"""Checks of the saved state of arms before it is restored."""

from __future__ import annotations

import numpy as np

from pursuit.reacher.task import LEAST_TOLERANCE, ReacherTask
from pursuit.simulator.state import SimulatorState, check_range


def check_values(state: SimulatorState, task: ReacherTask) -> None:
    """Raise ValueError for values that are impossible in arms of `task`."""
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
