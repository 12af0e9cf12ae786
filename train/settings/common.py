"""What the settings of a run of one agent and those of self-play have in common."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any

from pursuit.plugins import Registry
from train.settings.checks import (
    CLOCKS,
    MOST_FRAMES,
    PRECISIONS,
    SEED,
    Settings,
    check,
    one_of,
    passes,
    rule,
)

NETWORKS: Registry[Any] = Registry(
    "network",
    "a function or class (features, width) -> torch.nn.Module",
    callable,
    ours=("auto", "mlp", "convolutions", "planning", "flat"),
)
"""What stands between observations and heads: ours by name, and users' own."""


def with_memory(given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by name, with what the network "recurrent" stands for: "auto", and a GRU behind."""
    if given.get("network") != "recurrent":
        return dict(given)
    return {**given, "network": "auto", "recurrent": given.get("recurrent") or "gru"}


FrameStack = Annotated[
    int,
    rule(
        lambda value: 1 <= value <= MOST_FRAMES, f"from 1 (what is observed now) to {MOST_FRAMES}"
    ),
]


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """Budget, seed and machine of a run."""

    network: Annotated[str, passes(NETWORKS.check)] = "auto"
    """What sees the observations. Of planes: convolutions; planning, a layer that learns what is a
    wall and what a goal, and finds the shortest paths (for unseen mazes); mlp (or flat), which
    takes them as one vector, as it does everything else. auto: planning where a runner learns in a
    suite of mazes, else convolutions. recurrent: auto, and behind it a GRU (as --recurrent gru).
    Or package.module:Name of your own."""
    frame_stack: FrameStack = 1
    """Observations that a network is given at once: the last so many of the episode, the older
    ones empty at its start."""
    seconds: float | None = None
    """Budget of training time; evaluations are not counted."""
    clock: Annotated[str, one_of(*CLOCKS)] = "wall"
    """What a second is: wall, or processor, one that this run computed, on however many cores:
    other work on the machine then costs it fewer of its frames."""
    frames: int | None = None
    """Budget of environment steps of the learning agents, all games counted. With it, a resumed run
    ends bit for bit where an uninterrupted one does."""
    seed: Annotated[int, SEED] = 0
    """Of the games, the networks, the exploration and the opponents."""
    device: str = "cpu"
    """Where the networks are: cpu or cuda. Games are always simulated on the CPU."""
    precision: Annotated[str, one_of(*PRECISIONS)] = "auto"
    """float32, bfloat16, or auto: bfloat16 where the processor has it in hardware."""
    fused: Annotated[str, one_of("auto", "off")] = "auto"
    """auto: gradient steps by kernels of our own where network and games have the form that these
    are written for; off: always by torch. The results say which ("update")."""

    def __post_init__(self) -> None:
        super().__post_init__()
        seconds, frames, device = self.seconds, self.frames, self.device
        check(
            (seconds is None) != (frames is None),
            f"seconds={seconds} and frames={frames}; give one of the two as the budget",
        )
        for name, value in (("seconds", seconds), ("frames", frames)):
            check(value is None or 0 < value < inf, f"{name}={value}; it is above 0")
        check(frames is None or frames < 2**63, f"frames={frames}; below 2**63")
        check(
            re.fullmatch("cpu|cuda(:(0|[1-9][0-9]?))?", device) is not None,
            f"unknown device {device!r}; cpu, cuda, or one GPU of several: cuda:0, cuda:1, ...",
        )
        check(
            self.clock == "wall" or device == "cpu",
            f"clock={self.clock!r} with device={device!r}; what a GPU computes is not counted: "
            "take clock='wall' there",
        )
