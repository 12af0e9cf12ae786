"""What a run trains, and what it is made of: the interface of `loop.py`."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Protocol, Self

from train.evaluation.scores import Measure
from train.files import Plain
from train.settings.self_play import WholeSettings


class Clock(Protocol):
    """The progress of a run: the share of its budget in [0, 1], that of its schedules, which is
    above 1 where a longer budget keeps their end, and its seconds of training."""

    seconds: float

    @property
    def progress(self) -> float: ...  # noqa: D102 -- see the class

    @property
    def scheduled(self) -> float: ...  # noqa: D102 -- see the class


class Trainee(Protocol):
    """What a run trains: a single agent, or both roles of self-play.

    Attributes:
        kind: of run, in `config.json`.
        objective: of the run.
        evaluates_first: whether there is an evaluation before the first iteration.
    """

    kind: ClassVar[str]
    objective: Measure
    evaluates_first: ClassVar[bool]

    @property
    def frames(self) -> int:
        """Environment steps of the learning agents."""

    def iterate(self, clock: Clock) -> dict[str, float]:
        """One iteration of learning, such as a rollout with its updates.

        Returns:
            Values for the log, such as losses.
        """

    def evaluate(self) -> dict[str, float]:
        """The values of an evaluation of the current policy."""

    def forget_episodes(self) -> None:
        """Start new means over the training games for the next evaluation."""

    def log_fields(self, row: dict[str, float]) -> list[str]:
        """The fields of the log line of an evaluation."""

    def results(self, episodes: int) -> Plain:
        """The final evaluation as plain values: "task", "maze", "algorithm", "evaluation" ..."""

    def brief(self) -> Self:
        """A copy for a dry run: its `results` are of a few steps of a few episodes, and nothing
        large is solved. It shares the learners."""

    def state_dict(self) -> Plain:
        """Tensors and plain values from which a resumed run continues exactly."""

    def learned(self) -> Plain:
        """The part of `state_dict` that is learned; it must stay finite."""

    def keep(self, folder: Path, name: str) -> None:
        """Save the present policies of the run in a folder by `write_kept`, with this name."""

    def evaluate_kept(self, folder: Path, frames: int, episodes: int) -> Plain:
        """The evaluation of kept policies, on other starts than those of evaluations during
        training."""

    def save_beside(self, folder: Path) -> None:
        """Write further files into the folder, after the checkpoint has been saved."""

    def close(self) -> None:
        """Release resources."""


class Parts(Protocol):
    """What the settings of a run describe, built and checked once: what a trainee is made of."""

    @property
    def settings(self) -> WholeSettings: ...  # noqa: D102 -- see the class
