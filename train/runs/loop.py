"""The one training loop: whatever learns, evaluated as it goes, saved, resumable at any moment."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, ClassVar, Protocol

import torch
from torchrl.record.loggers import TensorboardLogger

import pursuit
from train.files import write_json
from train.machine import commit, processor
from train.runs.folder import CONFIG, RESULTS, MetricsFile, save_checkpoint
from train.runs.interruption import Interruption
from train.runs.provenance import recorded_parts
from train.runs.threads import ThreadChoice

EVALUATIONS = 20
"""How often a run is evaluated, and its checkpoint saved, over its budget."""


@dataclass(frozen=True)
class Objective:
    """What tells a good run from a bad one: a column of `metrics.csv`."""

    column: str
    unit: str
    less_is_better: bool = True


class Clock(Protocol):
    """How far a run is: its share of the budget in [0, 1], now, and its seconds of training."""

    seconds: float

    @property
    def progress(self) -> float: ...  # noqa: D102 -- see the class


class Trainee(Protocol):
    """Whatever trains: one agent, or two sides that learn from each other.

    Attributes:
        kind: of run, in `config.json`.
        objective: what it is judged by.
        evaluates_first: whether it is evaluated before it has learned anything.
    """

    kind: ClassVar[str]
    objective: Objective
    evaluates_first: ClassVar[bool]

    @property
    def frames(self) -> int:
        """Environment steps taken by whoever learns."""

    def iterate(self, clock: Clock) -> dict[str, float]:
        """Learn for a moment: a rollout or so.

        Returns:
            Figures for the log: losses and the like.
        """

    def evaluate(self) -> dict[str, float]:
        """The figures of an evaluation now."""

    def told(self, row: dict[str, float]) -> list[str]:
        """What a person is told of an evaluation, in few words each."""

    def results(self, interrupted: bool, episodes: int) -> dict[str, Any]:
        """The final evaluation as plain values: "task", "maze", "algorithm", "evaluation" ..."""

    def state_dict(self) -> dict[str, Any]:
        """Tensors and plain values: what a resumed one needs to go on exactly."""

    def save_beside(self, folder: Path) -> None:
        """Write what it keeps in the folder besides the checkpoint, which has just been saved."""

    def close(self) -> None:
        """Let go of whatever is held open."""


@dataclass(frozen=True)
class Budget:
    """How long a run trains: seconds of training, or frames; and with how many threads of torch.

    With 0 threads and seconds, one or all of them, whichever is the faster at the time.
    """

    seconds: float | None
    frames: int | None
    threads: int = 0

    def progress(self, seconds: float, frames: int) -> float:
        """The share that is spent, in [0, 1]."""
        if self.frames is not None:
            return min(frames / self.frames, 1.0)
        return min(seconds / (self.seconds or 1.0), 1.0)


Report = Callable[["Run", dict[str, float]], None]


class Run:
    """A trainee in a folder.

    Args:
        trainee: what learns; already where `state` left it.
        folder: its `config.json` is written.
        budget: how long.
        state: of the checkpoint to go on from; None begins.

    Attributes:
        trainee, folder, budget: the arguments.
        seconds: training time so far, without evaluations.
        metrics: the evaluations so far.
        stopped: whether it was interrupted before its budget was spent.
    """

    def __init__(
        self, trainee: Any, folder: Path, budget: Budget, state: dict[str, Any] | None = None
    ) -> None:
        # Any: a caller who made the trainee knows more of it than the loop does.
        self.trainee, self.folder, self.budget, self.stopped = trainee, folder, budget, False
        self.seconds, self.evaluations = 0.0, 0
        if state is not None:
            self.seconds, self.evaluations = state["seconds"], state["evaluations"]
            torch.set_rng_state(state["torch_rng"])
        self.metrics = MetricsFile(folder, None if state is None else trainee.frames)

    @property
    def progress(self) -> float:
        """Share of the budget spent, in [0, 1]."""
        return self.budget.progress(self.seconds, self.trainee.frames)

    def train(self, report: Report = lambda run, row: None) -> None:
        """Learn until the budget is spent; Ctrl-C (or SIGTERM) ends it after the current rollout.

        Args:
            report: called with every row of `metrics.csv`, and with {} after every rollout.
        """
        trainee, cores = self.trainee, os.cpu_count() or 1
        board = TensorboardLogger("tensorboard", str(self.folder))
        # A change of threads changes the last bits, so runs that must repeat exactly keep theirs.
        free = self.budget.seconds is not None and self.budget.threads == 0 and cores > 1
        choice = ThreadChoice(cores) if free else None
        with (
            Interruption() as interruption,
            contextlib.closing(trainee),
            contextlib.closing(board.experiment),
        ):
            if trainee.evaluates_first and not self.metrics.rows:
                self._record({}, board, report)
            while self.progress < 1.0 and not self.stopped:
                if choice is not None:
                    choice.choose()
                began = perf_counter()
                figures = trainee.iterate(self)
                spent = perf_counter() - began
                self.seconds += spent
                if choice is not None:
                    choice.learn(spent)
                self.stopped = interruption.asked
                report(self, {})
                if self.progress * EVALUATIONS >= self.evaluations + 1 or self.stopped:
                    # Counted by progress, not by time, so that a resumed run evaluates alike.
                    self.evaluations = int(self.progress * EVALUATIONS)
                    self._record(figures, board, report)

    def _record(self, figures: dict[str, float], board: Any, report: Report) -> None:
        """Evaluate, and keep everything on disk."""
        frames = self.trainee.frames
        row = {
            "frames": float(frames),
            "seconds": self.seconds,
            "frames_per_second": frames / max(self.seconds, 1e-9),
            **self.trainee.evaluate(),
            **figures,
        }
        self.metrics.add(row)
        self.save()
        for name, value in row.items():
            board.log_scalar(name, value, step=frames)
        report(self, row)

    def save(self) -> None:
        """Write the checkpoint: whatever a resumed run needs to go on exactly."""
        save_checkpoint(
            self.folder,
            {
                "trainee": self.trainee.state_dict(),
                "seconds": self.seconds,
                "evaluations": self.evaluations,
                "torch_rng": torch.get_rng_state(),
            },
        )
        self.trainee.save_beside(self.folder)

    def results(self, episodes: int = 1000) -> dict[str, Any]:
        """Evaluate what was learned beside the references, and write `results.json`."""
        objective, trainee = self.trainee.objective, self.trainee
        content = {
            "kind": trainee.kind,
            **trainee.results(self.stopped, episodes),
            "objective": asdict(objective),
            "frames": trainee.frames,
            "seconds": round(self.seconds, 3),
            "frames_per_second": round(trainee.frames / max(self.seconds, 1e-9), 1),
            "interrupted": self.stopped,
            "parts": recorded_parts(self.folder / CONFIG),
            "versions": versions(),
            "machine": machine(),
        }
        if trainee.evaluates_first and self.metrics.rows:
            content["at_start"] = self.metrics.rows[0]
        write_json(self.folder / RESULTS, content)
        return content


def versions() -> dict[str, Any]:
    """What ran."""
    return {
        "pursuit": pursuit.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "commit": commit(),
    }


def machine() -> dict[str, Any]:
    """What it ran on."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
    }
