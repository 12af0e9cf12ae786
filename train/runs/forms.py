"""The schemas of the files of a run.

Files may have further fields, as later versions may add some.
"""

from __future__ import annotations

from math import inf
from typing import Literal

import msgspec

from pursuit.validation import check
from train.evaluation.scores import Measure, Score
from train.files import Plain

RESTORE = "restore it from a copy"
AGAIN = "delete it and resume the run, which writes it again"


class Final(msgspec.Struct, frozen=True):
    """The settings of the final results of a run: arguments of `Run.results`."""

    episodes: int = 1000
    exact_seconds: float | None = None

    def __post_init__(self) -> None:
        check(self.episodes >= 2, f"episodes={self.episodes}; give at least 2")
        check(
            self.exact_seconds is None or 0.0 <= self.exact_seconds < inf,
            f"exact_seconds={self.exact_seconds}; give at least 0, or None for no limit",
        )

    def arguments(self) -> Plain:
        """By name."""
        return msgspec.structs.asdict(self)


class Config(msgspec.Struct, kw_only=True):
    """`config.json`, without settings other than the task."""

    kind: str
    task: Plain
    maze_text: str | None
    final: Final = Final()
    init_sha256: str | None = None
    longer: list[Longer] = []


class Longer(msgspec.Struct, frozen=True):
    """A run that goes on with a longer budget.

    Attributes:
        budget: before, in the unit of the run.
        at: the frames so far.
        stretch: whether schedules extend over the new budget; else they keep their end.
        sha256: of the checkpoint from which it goes on; None if there was none.
        command: that extended it.
    """

    budget: float
    at: int
    stretch: bool
    sha256: str | None
    command: str


class KeptList(msgspec.Struct):
    """`checkpoints.json`.

    Attributes:
        best: the frames of the kept policy with the best evaluation.
        kept: the evaluations of all that are kept.
    """

    best: int | None = None
    kept: list[dict[str, float]] = []


class Evaluation(msgspec.Struct):
    """The final evaluation of one agent."""

    episodes: int
    exact: bool
    mean_steps: float
    ci95: float
    success_rate: float
    optimal_steps: float | None
    optimality_gap: float | None

    def __post_init__(self) -> None:
        known = self.optimal_steps is not None or self.optimality_gap is None
        check(known, f"optimality_gap={self.optimality_gap} without optimal_steps")


class Match(msgspec.Struct):
    """The result of two policies of self-play against each other."""

    chaser: str
    evader: str
    steps: float
    ci95: float
    games: int


class Machine(msgspec.Struct):
    """The machine of a run."""

    processor: str


class Results(msgspec.Struct, kw_only=True):
    """`results.json` of every kind of run; files of the first format have no number of it."""

    format: int = 1
    kind: str
    task: str
    maze: str | None
    algorithm: str
    seed: int
    evaluation: dict[str, float | bool | None]
    objective: Measure
    frames: int
    seconds: float
    clock: str = "wall"
    frames_per_second: float
    interrupted: bool
    outdated: bool = False
    versions: dict[str, str | None]
    machine: Machine
    scores: list[Score] = []
    matches: list[Match] = []
    at_start: dict[str, float] = {}
    approximate_best_response: dict[str, float] = {}
    exact_best_response: dict[str, float] = {}
    limited_best_responses: dict[str, tuple[float, float]] = {}
    nash_conv_of: dict[str, float | None] = {}
    discount: float = 1.0
    reference: Plain = {}
    team: Plain = {}
    teammates: dict[str, str] = {}
    whole_game: Plain | None = None


class Exported(msgspec.Struct):
    """The metadata of an exported policy that is read; files of older versions have no format."""

    task: Plain
    agent: str
    observation: str
    actions: list[str]
    format: Literal[1] = 1
    play: dict[str, bool | float] = {}


class Description(msgspec.Struct):
    """The description file of a Stable-Baselines3 model."""

    task: Plain
    observation: str
