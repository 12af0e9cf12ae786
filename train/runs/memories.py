"""What is remembered of games in the middle of an episode, for checkpoints.

A learner keeps its own; here is what goes with the environment: the memories of the opponents that
remember, and the last observations where those are stacked.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

Memories = dict[str, dict[str, torch.Tensor]]


def memories_of(env: Any) -> Memories:
    """Copies of everything that is remembered, by seat (and opponent) and name."""
    return {
        place: {name: torch.from_numpy(_plain(array).copy()) for name, array in arrays.items()}
        for place, arrays in _arrays(env)
    }


def put_memories(env: Any, saved: Memories) -> None:
    """Put what `memories_of` gave of such an environment back, before it is stepped.

    An opponent that is not there any more is passed over; one that was not there begins afresh.
    """
    for place, arrays in _arrays(env):
        if place in saved:
            for name, array in arrays.items():
                _plain(array)[:] = saved[place][name].numpy()


def _arrays(env: Any) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """The live arrays by place."""
    if getattr(env, "stack", None) is not None:
        yield "stack", {"frames": env.frames}
    for seat, policy in enumerate(getattr(env, "policies", ())):
        # A pool of opponents says which of its members remember.
        several = getattr(policy, "remembering", None)
        found = {"": policy} if hasattr(policy, "memory") else {}
        for name, one in (found if several is None else several()).items():
            yield f"{seat} {name}".strip(), one.memory.of(env.simulator.view(seat))


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """torch has few operations on uint64: its bits travel as int64."""
    return array.view(np.int64) if array.dtype == np.uint64 else array
