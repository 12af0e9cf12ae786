"""The training loop, with evaluations, checkpoints and exact resumption."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any, ClassVar, Protocol

import torch
from torchrl.record.loggers import TensorboardLogger

from train.files import cannot_write, write_csv, write_json
from train.runs.folder import (
    CHECKPOINT,
    CONFIG,
    CURVE,
    METRICS,
    REPLAY,
    RESULTS,
    MetricsFile,
    save_checkpoint,
)
from train.runs.interruption import Diverged, Interruption
from train.runs.provenance import recorded_parts
from train.runs.threads import ThreadChoice, random_states, set_random_states
from train.runs.versions import machine, versions
from train.tensors import first_not_finite

BRIEF_EPISODES, BRIEF_STEPS = 2, 2
"""Episodes and their steps in a dry run of the results."""

EVALUATIONS = 20
"""Number of evaluations, each with a checkpoint, over the budget."""


@dataclass(frozen=True)
class Objective:
    """The objective of a run: a column of `metrics.csv`."""

    column: str
    unit: str
    less_is_better: bool = True


class Clock(Protocol):
    """The progress of a run: the share of its budget in [0, 1], and its seconds of training."""

    seconds: float

    @property
    def progress(self) -> float: ...  # noqa: D102 -- see the class


class Trainee(Protocol):
    """What a run trains: a single agent, or both roles of self-play.

    Attributes:
        kind: of run, in `config.json`.
        objective: of the run.
        evaluates_first: whether there is an evaluation before the first iteration.
    """

    kind: ClassVar[str]
    objective: Objective
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

    def results(self, interrupted: bool, episodes: int) -> dict[str, Any]:
        """The final evaluation as plain values: "task", "maze", "algorithm", "evaluation" ..."""

    def brief(self) -> Any:
        """A copy for a dry run: its `results` are of a few steps of a few episodes, and nothing
        large is solved. It shares the learners."""

    def state_dict(self) -> dict[str, Any]:
        """Tensors and plain values from which a resumed run continues exactly."""

    def learned(self) -> dict[str, Any]:
        """The part of `state_dict` that is learned; it must stay finite."""

    def save_beside(self, folder: Path) -> None:
        """Write further files into the folder, after the checkpoint has been saved."""

    def close(self) -> None:
        """Release resources."""


@dataclass(frozen=True)
class Budget:
    """The budget of a run: seconds of training, or frames; and torch's threads.

    With 0 threads and a budget in seconds, one or all threads are used, whichever is faster.
    Seconds are wall time, or the processor time of this process (`clock` "processor"), which
    depends less on other programs and includes the time of all threads.
    """

    seconds: float | None
    frames: int | None
    threads: int = 0
    clock: str = "wall"

    @property
    def free_threads(self) -> bool:
        """Whether torch's threads are chosen during the run, for a budget of wall time."""
        return self.seconds is not None and self.threads == 0 and self.clock == "wall"

    @property
    def first_threads(self) -> int:
        """Initial threads of torch; 0 for one per core."""
        own_seconds = self.seconds is not None and self.clock == "processor"
        return self.threads or int(own_seconds)

    def now(self) -> float:
        """The current time of the budget's clock, in seconds."""
        return perf_counter() if self.clock == "wall" else process_time()

    def progress(self, seconds: float, frames: int) -> float:
        """The share of the budget that is used, in [0, 1]."""
        if self.frames is not None:
            return min(frames / self.frames, 1.0)
        return min(seconds / (self.seconds or 1.0), 1.0)


Report = Callable[["Run", dict[str, float]], None]
Present = Callable[[Any, Path, list[dict[str, float]], dict[str, Any]], None]


class Run:
    """A trainee in a run folder.

    Args:
        trainee: the learners to train, restored from `state`.
        folder: of the run, with its `config.json`.
        budget: of the training.
        state: the checkpoint of a resumed run; None for a new one.

    Attributes:
        trainee, folder, budget: the arguments.
        seconds: training time by the budget's clock, without evaluations.
        metrics: the evaluations.
        stopped: whether it was interrupted before the end of its budget.
        exit_status: 0, or the exit status for the signal that interrupted it.
        lock: the lock of the folder, if any.
        present: (trainee, folder, rows of `metrics.csv`, results) writes the figures and the report
            of a finished run; None if there are none. A dry run calls it before training.
    """

    def __init__(
        self, trainee: Any, folder: Path, budget: Budget, state: dict[str, Any] | None = None
    ) -> None:
        # Any: callers use more of the trainee than the protocol has.
        self.trainee, self.folder, self.budget, self.stopped = trainee, folder, budget, False
        self.seconds, self.evaluations, self.exit_status = 0.0, 0, 0
        self.lock: Any = None
        self.present: Present | None = None
        self._saved_frames = 0
        if state is not None:
            self.seconds, self.evaluations = state["seconds"], state["evaluations"]
            set_random_states(state)
            self._saved_frames = trainee.frames
        column = trainee.objective.column
        self.metrics = MetricsFile(folder, None if state is None else trainee.frames, column)
        self._drop_row_of_interruption()

    def _drop_row_of_interruption(self) -> None:
        """Drop a last row that was added by an interruption: other runs do not have it."""
        rows = self.metrics.rows
        done = [
            int(EVALUATIONS * self.budget.progress(row["seconds"], int(row["frames"])))
            for row in [{"seconds": 0.0, "frames": 0.0}, *rows][-2:]
        ]
        if rows and rows[-1]["frames"] > 0 and done[0] == done[1]:
            rows.pop()

    @property
    def progress(self) -> float:
        """Share of the budget used, in [0, 1]."""
        return self.budget.progress(self.seconds, self.trainee.frames)

    def train(self, report: Report = lambda run, row: None) -> None:
        """Train until the end of the budget; Ctrl-C or SIGTERM stops after the current iteration.

        Args:
            report: called with every row of `metrics.csv`, and with {} after every iteration.

        Raises:
            Diverged: a value is not finite; the last checkpoint is kept.
        """
        trainee, cores = self.trainee, os.cpu_count() or 1
        # Results depend on the number of threads in the last bits, so it may be fixed.
        free = self.budget.free_threads and cores > 1
        choice = ThreadChoice(cores) if free else None
        with (
            Interruption() as interruption,
            contextlib.closing(trainee),
            self._tensorboard() as board,
        ):
            if trainee.evaluates_first and not self.metrics.rows:
                self._record({}, board, report)
            self.dry_run()
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
                # Counted by progress, so that a resumed run has the same evaluations.
                done = int(self.progress * EVALUATIONS)
                if done > self.evaluations:
                    self.evaluations = done
                    self._record(figures, board, report)
                elif self.stopped:
                    self._record(figures, board, report, due=False)

    def dry_run(self) -> None:
        """Build the results once, with tiny sizes, and draw them into a temporary folder.

        So what cannot be evaluated or drawn is an error before training. The run does not depend on
        it.
        """
        states, threads = random_states(), torch.get_num_threads()
        small = self.trainee.brief()
        content = self._content(small.results(False, BRIEF_EPISODES))
        if self.present is not None:
            evaluation = {k: float(v or 0.0) for k, v in content["evaluation"].items()}
            rows = self.metrics.rows or [{"frames": 0.0, "seconds": 0.0, **evaluation}]
            with TemporaryDirectory() as temporary:
                folder = Path(temporary) / self.folder.name
                folder.mkdir()
                shutil.copy(self.folder / CONFIG, folder / CONFIG)
                write_csv(folder / METRICS, rows)
                write_json(folder / RESULTS, content)
                self.present(small, folder, rows, content)
        torch.set_num_threads(threads)
        set_random_states(states)

    def _record(
        self, figures: dict[str, float], board: Any, report: Report, due: bool = True
    ) -> None:
        """Evaluate, and save the row and the checkpoint.

        An evaluation that is not `due`, at an interruption, leaves no trace in a resumed run.
        """
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
        if due:
            self.trainee.forget_episodes()
        self.save()
        if due:
            with self._writes_tensorboard():
                for name, value in row.items():
                    board.log_scalar(name, value, step=frames)
        report(self, row)

    @contextlib.contextmanager
    def _tensorboard(self) -> Iterator[Any]:
        """The TensorBoard logger, closed at the end."""
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
        """Name the folder of events in errors of the operating system."""
        try:
            yield
        except OSError as error:
            raise cannot_write(self.folder / "tensorboard", error) from None

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        """Report errors of libraries that are due to non-finite values as divergence."""
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
        kept = f"its checkpoint at {self._saved_frames:,} frames is kept"
        has = (self.folder / CHECKPOINT).exists()
        return Diverged(
            f"{self.folder}: training diverged at frame {self.trainee.frames:,}, after "
            f"{self.seconds:.1f} s: {how}; {kept if has else 'it has no checkpoint yet'}. Use a "
            "lower learning_rate"
        )

    def _own_state(self) -> dict[str, Any]:
        """The state of the run itself, without its trainee."""
        return {
            "seconds": self.seconds,
            "evaluations": self.evaluations,
            **random_states(),
        }

    def save(self) -> None:
        """Write the checkpoint, from which a resumed run continues exactly."""
        save_checkpoint(self.folder, {"trainee": self.trainee.state_dict(), **self._own_state()})
        self._saved_frames = self.trainee.frames
        self.trainee.save_beside(self.folder)

    def results(self, episodes: int = 1000) -> dict[str, Any]:
        """Evaluate the trained policy and the references, and write `results.json`.

        Figures of earlier results are deleted, so that commands draw new ones.
        """
        if (self.folder / CHECKPOINT).exists():  # the last save may have been interrupted
            self.trainee.save_beside(self.folder)
        content = self._content(self.trainee.results(self.stopped, episodes))
        for name in (CURVE, REPLAY):
            (self.folder / name).unlink(missing_ok=True)
        write_json(self.folder / RESULTS, content)
        return content

    def _content(self, evaluated: dict[str, Any]) -> dict[str, Any]:
        """The content of `results.json`, with the results of the trainee."""
        trainee = self.trainee
        content = {
            "kind": trainee.kind,
            **evaluated,
            "objective": asdict(trainee.objective),
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
        return content
