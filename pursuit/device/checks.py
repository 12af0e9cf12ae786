"""Checks: what is asked of a GPU, refused where it cannot be had; and what it is kept from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import Any

import numpy as np
from numba import cuda

from pursuit.task import Task


def on_device(array: Any) -> bool:
    """Whether an array lies on the GPU."""
    return hasattr(array, "copy_to_host") or hasattr(array, "__cuda_array_interface__")


def choose_device(device: str) -> None:
    """Have this thread use the GPU of that name.

    Raises:
        ValueError: a name that is none, or there is no GPU.
    """
    name, _, number = str(device).partition(":")
    if name != "cuda" or not (number.isdigit() or number == str(device)[4:] == ""):
        raise ValueError(f"device={device!r}; give cpu, cuda, or cuda:1 and so on")
    if not cuda.is_available():
        raise ValueError(
            f"device={device!r}, but Numba finds no GPU here; take device='cpu', or, where there "
            "is one, `pip install pursuit[gpu]`"
        )
    if number:
        cuda.select_device(int(number))


def check_task(task: Task) -> None:
    """ValueError for a task that is not the same on a GPU.

    A GPU multiplies and adds with one rounding. The only such sum is the reward for distances; it
    is as good as always the same in float32, and here that is made sure of.
    """
    if task.reward_function is not None:
        raise ValueError(
            f"task {task.name!r} is paid by a function of Python; on a GPU take Rewards by role, "
            "or device='cpu'"
        )
    farthest = max(maze.height + maze.width for maze in task.mazes)
    for role, pay in task.role_rewards.items():
        for away in range(farthest if pay.distance else 0):
            at_once = float(Fraction(pay.step) + Fraction(pay.distance) * away)
            if np.float32(at_once) != np.float32(pay.step + pay.distance * away):
                raise ValueError(
                    f"rewards of the {role}: step={pay.step} and distance={pay.distance} are "
                    f"rounded otherwise on a GPU at distance {away}; change the last digit of one"
                )


@contextmanager
def nothing_freed() -> Iterator[None]:
    """Meanwhile Numba frees no memory of a GPU, which would break off what is captured there."""
    if not cuda.is_available():
        yield
        return
    with cuda.defer_cleanup():
        yield
