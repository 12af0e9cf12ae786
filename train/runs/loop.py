"""The one training loop: whatever learns, evaluated as it goes, saved, resumable at any moment."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, ClassVar, Protocol

import torch
from torchrl.record.loggers import TensorboardLogger

import pursuit
from train.files import cannot_write, write_json
from train.machine import commit, processor
from train.runs.folder import (
    CHECKPOINT,
    CONFIG,
    CURVE,
    REPLAY,
    RESULTS,
    MetricsFile,
    save_checkpoint,
)
from train.runs.interruption import Diverged, Interruption
from train.runs.provenance import recorded_parts
from train.runs.threads import ThreadChoice, random_states, set_random_states
from train.tensors import first_not_finite

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

    def log_fields(self, row: dict[str, float]) -> list[str]:
        """What a person is told of an evaluation, in few words each."""

    def results(self, interrupted: bool, episodes: int) -> dict[str, Any]:
        """The final evaluation as plain values: "task", "maze", "algorithm", "evaluation" ..."""

    def state_dict(self) -> dict[str, Any]:
        """Tensors and plain values: what a resumed one needs to go on exactly."""

    def learned(self) -> dict[str, Any]:
        """The part of `state_dict` that is learned; a number in it that is not finite is an end."""

    def save_beside(self, folder: Path) -> None:
        """Write what it keeps in the folder besides the checkpoint, which has just been saved."""

    def close(self) -> None:
        """Let go of whatever is held open."""


@dataclass(frozen=True)
class Budget:
    """How long a run trains: seconds of training, or frames; and with how many threads of torch.

    With 0 threads and seconds, one or all of them, whichever is the faster at the time. Seconds are
    the wall's, or those that the process computed (`clock` "processor"): with those, what else runs
    on the machine takes fewer frames from a run, and a second thread is paid for.
    """

    seconds: float | None
    frames: int | None
    threads: int = 0
    clock: str = "wall"

    @property
    def free_threads(self) -> bool:
        """Whether torch's threads are chosen as the run goes, for its seconds on the wall."""
        return self.seconds is not None and self.threads == 0 and self.clock == "wall"

    @property
    def first_threads(self) -> int:
        """Threads of torch to begin with; 0 for one on each core."""
        own_seconds = self.seconds is not None and self.clock == "processor"
        return self.threads or int(own_seconds)

    def now(self) -> float:
        """A moment, in the seconds that are counted."""
        return perf_counter() if self.clock == "wall" else process_time()

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
        seconds: training time so far, by the budget's clock, without evaluations.
        metrics: the evaluations so far.
        stopped: whether it was interrupted before its budget was spent.
        exit_status: 0, or what tells of the signal that interrupted it.
        lock: holds the folder for this run, where somebody took it.
    """

    def __init__(
        self, trainee: Any, folder: Path, budget: Budget, state: dict[str, Any] | None = None
    ) -> None:
        # Any: a caller who made the trainee knows more of it than the loop does.
        self.trainee, self.folder, self.budget, self.stopped = trainee, folder, budget, False
        self.seconds, self.evaluations, self.exit_status = 0.0, 0, 0
        self.lock: Any = None
        self._saved_frames = 0
        if state is not None:
            self.seconds, self.evaluations = state["seconds"], state["evaluations"]
            set_random_states(state)
            self._saved_frames = trainee.frames
        column = trainee.objective.column
        self.metrics = MetricsFile(folder, None if state is None else trainee.frames, column)
        self._drop_row_of_interruption()

    def _drop_row_of_interruption(self) -> None:
        """Forget a last row that only a signal caused: an uninterrupted run has none there."""
        rows = self.metrics.rows
        done = [
            int(EVALUATIONS * self.budget.progress(row["seconds"], int(row["frames"])))
            for row in [{"seconds": 0.0, "frames": 0.0}, *rows][-2:]
        ]
        if rows and rows[-1]["frames"] > 0 and done[0] == done[1]:
            rows.pop()

    @property
    def progress(self) -> float:
        """Share of the budget spent, in [0, 1]."""
        return self.budget.progress(self.seconds, self.trainee.frames)

    def train(self, report: Report = lambda run, row: None) -> None:
        """Learn until the budget is spent; Ctrl-C (or SIGTERM) ends it after the current rollout.

        Args:
            report: called with every row of `metrics.csv`, and with {} after every rollout.

        Raises:
            Diverged: there is nothing to be learned any more; the last checkpoint is kept.
        """
        trainee, cores = self.trainee, os.cpu_count() or 1
        # A change of threads changes the last bits, so runs that must repeat exactly keep theirs.
        free = self.budget.free_threads and cores > 1
        choice = ThreadChoice(cores) if free else None
        with (
            Interruption() as interruption,
            contextlib.closing(trainee),
            self._tensorboard() as board,
        ):
            if trainee.evaluates_first and not self.metrics.rows:
                self._record({}, board, report)
            while self.progress < 1.0 and not self.stopped:
                if choice is not None:
                    choice.choose()
                began = self.budget.now()
                with self._watched():
                    figures = trainee.iterate(self)
                spent = self.budget.now() - began
                self.seconds += spent
                if choice is not None:
                    choice.learn(spent)
                self._check_figures(figures)
                self.stopped, self.exit_status = interruption.asked, interruption.status
                report(self, {})
                if self.progress * EVALUATIONS >= self.evaluations + 1 or self.stopped:
                    # Counted by progress, not by time, so that a resumed run evaluates alike.
                    self.evaluations = int(self.progress * EVALUATIONS)
                    self._record(figures, board, report)

    def _record(self, figures: dict[str, float], board: Any, report: Report) -> None:
        """Evaluate, and keep everything on disk."""
        frames = self.trainee.frames
        with self._watched():
            row = {
                "frames": float(frames),
                "seconds": self.seconds,
                "frames_per_second": frames / max(self.seconds, 1e-9),
                **self.trainee.evaluate(),
                **figures,
            }
        self._check_learned()
        self.metrics.add(row)
        self.save()
        with self._writes_tensorboard():
            for name, value in row.items():
                board.log_scalar(name, value, step=frames)
        report(self, row)

    @contextlib.contextmanager
    def _tensorboard(self) -> Iterator[Any]:
        """The logger of TensorBoard, closed at the end."""
        with self._writes_tensorboard():
            board = TensorboardLogger("tensorboard", str(self.folder))
            events = board.experiment
        try:
            yield board
        finally:
            with self._writes_tensorboard():
                events.close()

    @contextlib.contextmanager
    def _writes_tensorboard(self) -> Iterator[None]:
        """Have errors of the system name the folder of events."""
        try:
            yield
        except OSError as error:
            raise cannot_write(self.folder / "tensorboard", error) from None

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        """Libraries complain of numbers that are not finite in their words: say it in ours."""
        try:
            yield
        except (ValueError, ArithmeticError, ChildProcessError):
            self._check_learned()
            raise

    def _check_learned(self) -> None:
        where = first_not_finite(self.trainee.learned())
        if where is not None:
            raise self._diverged(f"{where} is not finite")

    def _check_figures(self, figures: dict[str, float]) -> None:
        for name, value in figures.items():
            if not abs(value) < float("inf"):
                raise self._diverged(f"{name} is {value:g}")

    def _diverged(self, how: str) -> Diverged:
        kept = f"its checkpoint of {self._saved_frames:,} frames is kept"
        has = (self.folder / CHECKPOINT).exists()
        return Diverged(
            f"{self.folder}: training diverged in frame {self.trainee.frames:,}, after "
            f"{self.seconds:.1f} s: {how}; {kept if has else 'it has no checkpoint yet'}. Take a "
            "lower learning_rate"
        )

    def _own_state(self) -> dict[str, Any]:
        """What the run itself needs to go on, beside its trainee."""
        return {
            "seconds": self.seconds,
            "evaluations": self.evaluations,
            **random_states(),
        }

    def save(self) -> None:
        """Write the checkpoint: whatever a resumed run needs to go on exactly."""
        save_checkpoint(self.folder, {"trainee": self.trainee.state_dict(), **self._own_state()})
        self._saved_frames = self.trainee.frames
        self.trainee.save_beside(self.folder)

    def results(self, episodes: int = 1000) -> dict[str, Any]:
        """Evaluate what was learned beside the references, and write `results.json`.

        The pictures of earlier results are deleted: who finds none makes those of these.
        """
        objective, trainee = self.trainee.objective, self.trainee
        if (self.folder / CHECKPOINT).exists():  # the last save may have been cut short
            trainee.save_beside(self.folder)
        content = {
            "kind": trainee.kind,
            **trainee.results(self.stopped, episodes),
            "objective": asdict(objective),
            "frames": trainee.frames,
            "seconds": round(self.seconds, 3),
            "clock": self.budget.clock,
            "frames_per_second": round(trainee.frames / max(self.seconds, 1e-9), 1),
            "interrupted": self.stopped,
            "parts": recorded_parts(self.folder / CONFIG),
            "versions": versions(),
            "machine": machine(),
        }
        if trainee.evaluates_first and self.metrics.rows:
            content["at_start"] = self.metrics.rows[0]
        for name in (CURVE, REPLAY):
            (self.folder / name).unlink(missing_ok=True)
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
