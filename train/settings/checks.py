"""What every settings class checks itself with."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any


def check(condition: bool, message: str) -> None:
    """Raise ValueError(message) unless `condition`."""
    if not condition:
        raise ValueError(message)


def check_default(settings: Any, default: Any, names: Iterable[str], why: str) -> None:
    """ValueError unless these settings have the values that they have in `default`."""
    for name in names:
        value = getattr(settings, name)
        check(
            value == getattr(default, name),
            f"{name}={value!r} has no effect: {why}; leave it out",
        )


def check_choice(what: str, value: object, choices: Iterable[str]) -> None:
    """ValueError unless `value` is one of `choices`, which it names."""
    known = tuple(choices)
    check(value in known, f"unknown {what} {value!r}; one of {', '.join(known)}")


CLOCKS = ("wall", "processor")


def check_budget(seconds: float | None, frames: int | None, clock: str = "wall") -> None:
    """ValueError unless exactly one of the two is given, above 0 and finite, frames in 63 bits.

    Also unless `clock`, which counts the seconds, is one of `CLOCKS`.
    """
    check_choice("clock", clock, CLOCKS)
    check(
        (seconds is None) != (frames is None),
        f"seconds={seconds} and frames={frames}; give one of the two as the budget",
    )
    for name, value in (("seconds", seconds), ("frames", frames)):
        check(value is None or 0 < value < float("inf"), f"{name}={value}; it is above 0")
    check(frames is None or frames < 2**63, f"frames={frames}; below 2**63")


PRECISIONS = ("auto", "float32", "bfloat16")


def check_device(device: str, clock: str) -> None:
    """ValueError for a device that is none, or whose work `clock` does not count."""
    check(
        re.fullmatch("cpu|cuda(:(0|[1-9][0-9]?))?", device) is not None,
        f"unknown device {device!r}; cpu, cuda, or one GPU of several: cuda:0, cuda:1, ...",
    )
    check(
        clock == "wall" or device == "cpu",
        f"clock={clock!r} with device={device!r}; what a GPU computes is not counted: take "
        "clock='wall' there",
    )


EVALUATION_SEED = 2**62
"""Seeds below are trained with. What is reported is played with this one and those above, so that
nothing is judged by games that it may have learned from: one rule, for every command."""


MOST_THREADS = 1024


def check_threads(threads: int, least: int) -> None:
    """ValueError for a number of torch's threads that no machine can start."""
    check(
        least <= threads <= MOST_THREADS,
        f"threads={threads}; from {least} to {MOST_THREADS}, and no more than there are cores",
    )


MOST_FRAMES = 64


def check_frame_stack(count: int) -> None:
    """ValueError for a number of observations that no network is given at once."""
    check(
        1 <= count <= MOST_FRAMES,
        f"frame_stack={count}; from 1 (what is observed now) to {MOST_FRAMES}",
    )


def check_seed(seed: int) -> None:
    """ValueError for a seed that is not one to train with."""
    check(
        0 <= seed < EVALUATION_SEED,
        f"seed={seed}; 0 to 2**62-1 (those above are kept for evaluation)",
    )


def evaluation_seed(seed: int) -> int:
    """The seed of an evaluation's games that `--seed` 0, 1, ... means: never one of a training.

    Raises:
        ValueError: not from 0 to 2**62 - 1.
    """
    check_seed(seed)
    return EVALUATION_SEED + seed
