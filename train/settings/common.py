"""Settings common to runs of a single agent and self-play."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, ClassVar

from pursuit.plugins import Registry
from pursuit.validation import check, choice, passes, rule
from train.files import Plain
from train.settings.checks import CLOCKS, MOST_FRAMES, PRECISIONS, SEED, SHARE, Settings

LOGS = ("tensorboard", "wandb", "mlflow")
"""Logs for other programs, by the names of their packages."""
NETWORKS: Registry[Any] = Registry(
    "network",
    "a function or class (features, width) -> torch.nn.Module",
    callable,
    ours=("auto", "mlp", "convolutions", "planning", "flat"),
)
"""Networks between observations and heads: built-in names, and user-defined ones."""


def with_memory(given: Mapping[str, object]) -> Plain:
    """Settings by name, with network "recurrent" expanded into network "auto" with a GRU."""
    if given.get("network") != "recurrent":
        return dict(given)
    return {**given, "network": "auto", "recurrent": given.get("recurrent") or "gru"}


def check_min_probability(given: float | None, moves: int) -> float:
    """`min_probability`, 0 for None; ValueError above 1 / moves, the least that leaves a move."""
    least = given or 0.0
    check(
        least * moves <= 1.0,
        f"min_probability={least} with {moves} moves; give 0 to {1.0 / moves:g}, so that one of "
        "them is left",
    )
    return least


def check_logs(given: str) -> None:
    """ValueError unless all logs are known."""
    known = given in ("auto", "none") or {*given.split(",")} <= {*LOGS}
    check(known, f"log={given!r}; give {', '.join(LOGS)}, several with commas, or none")


FrameStack = Annotated[
    int, rule(lambda value: 1 <= value <= MOST_FRAMES, f"give 1 (no stacking) to {MOST_FRAMES}")
]


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """Budget, seed and machine of a run."""

    ADDED: ClassVar[tuple[str, ...]] = (
        "checkpoints",
        "init_from",
        "imitate",
        "imitate_frames",
        "log",
    )

    network: Annotated[str, passes(NETWORKS.check)] = "auto"
    """mlp (or flat), convolutions (for planes), planning (value iteration layers for planes, for
    unseen mazes), recurrent (auto with a GRU), or package.module:Name of a user-defined network.
    auto: planning for a runner in a suite of mazes, convolutions for other planes, else mlp."""
    frame_stack: FrameStack = 1
    """Number of latest observations that the network receives; zeros before the first step of an
    episode."""
    min_probability: Annotated[float | None, SHARE] = None
    """Actions of lower probability are not played when a sampled policy is evaluated or loaded
    (Perolat et al., 2022); training is unaffected. At most 1 / moves. None: 0; in self-play 0.05,
    with more than 5 moves 0.25 / moves."""
    seconds: float | None = None
    """Budget of training time in seconds, without evaluations."""
    clock: Annotated[str, choice(*CLOCKS)] = "wall"
    """Clock of the budget in seconds: wall, or processor (processor time of this run on all cores,
    which depends less on other programs)."""
    frames: int | None = None
    """Budget of environment steps, summed over games and learning agents. A run ends with the
    rollout that reaches it, so it can have slightly more. With this budget, resumed
    and uninterrupted runs have bitwise equal results."""
    checkpoints: Annotated[int, rule(lambda value: 0 <= value <= 1000, "give 0 to 1000")] = 0
    """Policies that are kept through the run, at equal shares of the budget: with 4 at 25, 50, 75
    and 100 %. They are evaluated there, and commands read them by --at."""
    init_from: Annotated[
        str | None, rule(lambda value: value != "", "give a folder, or leave it out")
    ] = None
    """The folder of a run whose weights the new run starts from, with its own settings, optimiser
    and seed; also of one side of self-play, or of a kept policy such as
    runs/first/checkpoints/000200000. In self-play the weights of all sides, or of one."""
    imitate: Annotated[
        str | None, rule(lambda value: value != "", "give a policy, or leave it out")
    ] = None
    """A policy that the learner first imitates, in the states that it visits itself: by name
    (astar, gathering, equilibrium ...), optimal (the exact best response to the other agents), the
    folder of a run, a model, or package.module:Name. For algorithms that learn from rollouts."""
    imitate_frames: Annotated[int, rule(lambda value: value >= 0, "give 0 or more")] = 0
    """Frames after which nothing is imitated. Until then the policy loss is the mean of the
    cross-entropy to the imitated policy and the algorithm's own loss; the weight of the former is 1
    at the start and falls linearly to 0."""
    log: Annotated[str, passes(check_logs)] = "auto"
    """Logs of the evaluations for other programs while training: tensorboard, wandb, mlflow,
    several with commas, or none. auto: tensorboard where it is installed."""
    seed: Annotated[int, SEED] = 0
    """Seed of the games, the networks, the exploration and the opponents."""
    device: str = "cpu"
    """Device of the networks: cpu or cuda. Games are always simulated on the CPU."""
    precision: Annotated[str, choice(*PRECISIONS)] = "auto"
    """Of the training: float32, bfloat16, or auto (bfloat16 where the hardware supports it).
    Policies are evaluated in float32."""
    fused: Annotated[str, choice("auto", "off")] = "auto"
    """auto: compiled gradient kernels where network and task allow them; off: torch autograd only.
    `update` in results.json says which was used."""

    @property
    def budget_unit(self) -> str:
        """The unit of the budget: frames or seconds."""
        return "seconds" if self.frames is None else "frames"

    def __post_init__(self) -> None:
        super().__post_init__()
        seconds, frames, device = self.seconds, self.frames, self.device
        check(
            (seconds is None) != (frames is None),
            f"seconds={seconds} and frames={frames}; give exactly one of the two as the budget",
        )
        for name, value in (("seconds", seconds), ("frames", frames)):
            check(value is None or 0 < value < inf, f"{name}={value}; must be above 0")
        imitate, count = self.imitate, self.imitate_frames
        check(
            (imitate is None) == (count == 0),
            f"imitate={imitate!r} and imitate_frames={count}; give both, or neither",
        )
        check(frames is None or frames < 2**63, f"frames={frames}; must be below 2**63")
        check(
            re.fullmatch("cpu|cuda(:(0|[1-9][0-9]?))?", device) is not None,
            f"unknown device {device!r}; give cpu, cuda, or one GPU of several: cuda:0, cuda:1 ...",
        )
        check(
            self.clock == "wall" or device == "cpu",
            f"clock={self.clock!r} does not measure device={device!r}; use clock='wall'",
        )
