"""Learning from games on a GPU with graphs, in Numba's simulator of one: as device_learning.py.

`python tests/device_graphs.py FILE CASE ...` writes what is learned where a recorder captures
rollouts and updates, and how often graphs were replayed.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from typing import Any

import device_learning
import device_self_play
import numpy as np
from graph_recorder import Recorder

REPLAYED, WARNED = "replayed", "warned"
LONGER = 6
"""Iterations of one case; the first is no graph yet, and the second captures."""


def learn(name: str, device: str, paused: bool = False) -> dict[str, np.ndarray]:
    """As `device_learning.learn`; on a device with graphs, and with what became of them."""
    graphs = Recorder() if device != "cpu" else None
    script: Any = device_learning if name in device_learning.CASES else device_self_play
    case = script.CASES[name]
    script.CASES[name] = replace(case, iterations=max(case.iterations, LONGER))
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        seen: dict[str, np.ndarray] = script.learn(name, device, paused, graphs)
    script.CASES[name] = case
    if graphs is not None:
        told = [str(one.message) for one in noted if "CUDA graphs" in str(one.message)]
        seen[f"{name}: {REPLAYED}"] = np.array([one.replays for one in graphs.graphs])
        seen[f"{name}: {WARNED}"] = np.array(told, dtype=str)
    return seen


if __name__ == "__main__":
    device_learning.main(learn, *sys.argv[1:])
