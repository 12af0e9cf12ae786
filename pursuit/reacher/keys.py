"""Keys for `gymnasium.utils.play`: which ones turn which joints of an arm."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from pursuit.environments.keys import Keys
from pursuit.reacher.task import ReacherTask

FORTH, BACK = "qwertyui", "asdfghjk"
"""A key for each joint; those of one joint are one below the other."""


def arm_keys(task: ReacherTask) -> dict[Keys, Any]:
    """q, w, e, ... turn a joint to the left, a, s, d, ... to the right; two joints at once as well.

    Actions are arrays [joints] as the environment takes them; space stays.
    """
    still: Any = np.zeros(task.joints, dtype=np.float32)
    if task.discrete_actions:
        still = np.ones(task.joints, dtype=np.int64)
    turns = [(FORTH[joint], joint, 1) for joint in range(task.joints)]
    turns += [(BACK[joint], joint, -1) for joint in range(task.joints)]
    keys: dict[Keys, Any] = {(ord(" "),): still}
    for (one, joint, sign), (two, other, turn) in product(turns, turns):
        if joint == other and one != two:
            continue
        action = still.copy()
        action[joint] += sign
        if joint != other:
            action[other] += turn
        keys[tuple(sorted({ord(one), ord(two)}))] = action
    return keys
