"""The training loop, with evaluations, checkpoints and exact resumption."""

from __future__ import annotations

import contextlib
import os
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Generic

import torch
from filelock import BaseFileLock
from typing_extensions import TypeVar  # with defaults, which Python has from 3.13 on

from scripted_agents.exact.long_work import Tell, in_time
from train.files import Plain, write_csv, write_json
from train.machine import machine, versions
from train.runs.budget import Budget
from train.runs.folder import (
    CHECKPOINT,
    CONFIG,
    CURVE,
    KEPT_LIST,
    METRICS,
    MISFITS,
    REPLAY,
    RESULTS,
    RESULTS_FORMAT,
    frames_name,
    load_results,
    misfit,
    read_kept_list,
    read_metrics,
    save_checkpoint,
)
from train.runs.imitation import ImitationError
from train.runs.interruption import Diverged, Signals, Stopped
from train.runs.logs import Logs
from train.runs.provenance import recorded_parts
from train.runs.threads import (
    ThreadChoice,
    check_device,
    prepare_torch,
    random_states,
    set_random_states,
)
from train.runs.trainee import Parts, Trainee
from train.settings.self_play import WholeSettings
from train.tensors import first_not_finite, own_defaults

BRIEF_EPISODES, BRIEF_STEPS = 2, 2
"""Episodes and their steps in a dry run of the results."""

EVALUATIONS = 20
"""Number of evaluations, each with a checkpoint, over the budget."""


def evenly(count: int) -> list[float]:
    """So many shares of a budget in even distances, up to 1."""
    return [number / count for number in range(1, count + 1)]


T = TypeVar("T", bound=Trainee, default=Trainee, covariant=True)
P = TypeVar("P", bound=Parts)
S = TypeVar("S", bound=WholeSettings)


class Run(Generic[T]):
    """A trainee in a run folder.

    Args:
        trainee: the learners to train, restored from `state`.
        folder: of the run, with its `config.json`.
        budget: of the training.
        state: the checkpoint of a resumed run; None for a new one.
        marks: the shares of the budget at which the policy is evaluated and saved, in order; None
            for `EVALUATIONS` in even distances.
        checkpoints: the number of policies that are kept, in even distances, which are evaluated.
        log: names of logs for other programs, as in the settings.

    Attributes:
        trainee, folder, budget, checkpoints: the arguments.
        marks: of all evaluations.
        ended: whether another iteration would exceed a budget with `within`.
        seconds: training time by the budget's clock, without evaluations and compilation.
        rows: the evaluations, of `metrics.csv`.
        figures: of the last iteration.
        stopped: set by the user, to end training after the current iteration.
        saved_frames: those of the checkpoint; 0 without one.
        lock: the lock of the folder, if any.
        present: (run, results) writes the figures and the report of a finished run; None if there
            are none. A dry run calls it before training.
    """

    def __init__(
        self,
        trainee: T,
        folder: Path,
        budget: Budget,
        state: Plain | None = None,
        marks: Sequence[float] | None = None,
        checkpoints: int = 0,
        log: str = "none",
    ) -> None:
        self.trainee, self.folder, self.budget, self.stopped = trainee, folder, budget, False
        self.checkpoints, self.ended, self.log_setting = evenly(checkpoints), False, log
        given = evenly(EVALUATIONS) if marks is None else marks
        self.marks = sorted({*given, *self.checkpoints})
        self.seconds, self.evaluations, self.figures = 0.0, 0, dict[str, float]()
        self.lock: BaseFileLock | None = None
        self.present: Callable[[Run[T], Plain], None] | None = None
        self.rows: list[dict[str, float]] = []
        self.saved_frames, self.last_is_due = 0, True
        if state is not None:
            self.seconds, self.evaluations = state["seconds"], state["evaluations"]
            self.figures, self.ended = state.get("figures", {}), state.get("ended", False)
            set_random_states(state)
            self.saved_frames = trainee.frames
            self.rows = self._rows_of_checkpoint(state.get("rows"))
            if state.get("budget", budget.amount) != budget.amount:  # it is longer now
                self.ended, self.evaluations = False, self._passed(self.marks)

    def _rows_of_checkpoint(self, count: int | None) -> list[dict[str, float]]:
        """The first `count` rows of `metrics.csv` up to the checkpoint: later evaluations will be
        repeated. None: all of them, in checkpoints of earlier versions."""
        if count == 0:
            return []
        rows = read_metrics(self.folder, self.trainee.objective.column)[:count]
        return [row for row in rows if row["frames"] <= self.trainee.frames]

    def _passed(self, marks: Sequence[float]) -> int:
        """How many of these shares of the budget the last evaluation has reached."""
        if not self.rows:
            return 0
        last = self.rows[-1]
        share = self.budget.progress(last["seconds"], int(last["frames"]))
        return sum(mark <= share for mark in marks)

    @property
    def progress(self) -> float:
        """Share of the budget used, in [0, 1]."""
        return min(self.budget.progress(self.seconds, self.trainee.frames), 1.0)

    @property
    def scheduled(self) -> float:
        """Share of the schedules; above 1 where a longer budget keeps their end."""
        return self.budget.scheduled(self.seconds, self.trainee.frames)

    @property
    def due(self) -> int:
        """The number of evaluations that are due so far, except one before training."""
        return len(self.marks) if self.ended else sum(mark <= self.progress for mark in self.marks)

    @property
    def is_spent(self) -> bool:
        """Whether the budget allows no further iteration."""
        return self.ended or self.progress >= 1.0

    @property
    def is_trained(self) -> bool:
        """Whether the budget is spent and the last evaluation made."""
        return self.is_spent and self.evaluations >= self.due

    @own_defaults()
    def train(
        self,
        report: OnReport[T] = lambda run, row: None,
        callback: Callable[[Run[T]], object] = lambda run: None,
    ) -> None:
        """Train until the end of the budget, or until `stopped` is set.

        After Ctrl-C or SIGTERM the run is saved without an evaluation, at once or after the current
        iteration. A second signal ends it without saving.

        Args:
            report: called with every row of `metrics.csv`, and with {} after every iteration.
            callback: called with this run after every evaluation, which is `rows[-1]`. It may end
                training (`run.stopped = True`), log values (`run.log({"name": 1.0})`), keep the
                present policies (`run.keep()`), and use the trainee (`run.trainee.policy`).

        Raises:
            Diverged: a value is not finite; the last checkpoint is kept.
            Stopped: after a signal, a kind of `KeyboardInterrupt`.
        """

        def report_and_call(run: Run[T], row: dict[str, float]) -> None:
            report(run, row)
            if row:
                callback(run)

        closing = contextlib.closing
        with Signals() as signals, closing(self.trainee), closing(self.open_logs()):
            try:
                self._train(signals, report_and_call)
            except Stopped:
                # After a second signal the learner may be in the middle of an iteration.
                if signals.count == 1 and self.trainee.frames > self.saved_frames:
                    self.save()
                raise

    def open_logs(self) -> Logs:
        """The logs for other programs, which evaluations write until they are closed."""
        self.logs = Logs(self.log_setting, self.folder)
        return self.logs

    def log(self, values: Mapping[str, float]) -> None:
        """Write further values into the logs for other programs, at the present frames."""
        self.logs.write(values, self.trainee.frames)

    def _train(self, signals: Signals, report: OnReport[T]) -> None:
        trainee, cores = self.trainee, os.cpu_count() or 1
        # Results depend on the number of threads in the last bits, so it may be fixed.
        free = self.budget.free_threads and cores > 1
        choice, spent = ThreadChoice(cores) if free else None, 0.0
        if trainee.evaluates_first and not self.rows:
            self.evaluate(report, signals)
        self.dry_run()
        while True:
            # Counted by progress, so that a resumed run has the same evaluations.
            last = self.rows[-1]["frames"] if self.rows else -1.0
            if self.due > self.evaluations or (self.stopped and last < trainee.frames):
                self.evaluate(report, signals)
            if self.is_spent or self.stopped:
                return
            before = f"the last one took {spent:.0f} s" if spent else "the first compiles kernels"
            message = f"saving after this iteration ({before}); another signal ends without saving"
            with signals.held("" if 0.0 < spent < 1.0 else message):
                if choice is not None:
                    choice.choose()
                began, frames = self.budget.now(), trainee.frames
                with self._watched():
                    figures = trainee.iterate(self)
                # Plain numbers, as the checkpoint holds them.
                self.figures = {name: float(value) for name, value in figures.items()}
                spent = self.budget.now() - began
                self.seconds += spent
                after = (self.seconds + spent, 2 * trainee.frames - frames)
                self.ended = self.budget.within and self.budget.progress(*after) > 1.0
                if choice is not None:
                    choice.learn(spent)
                for name, value in self.figures.items():
                    if not abs(value) < float("inf"):
                        raise self._diverged(f"{name} is {value:g}")
            report(self, {})

    @own_defaults()
    def dry_run(self) -> None:
        """Build the results once, with tiny sizes, and draw them, in a temporary folder.

        So what cannot be evaluated or drawn is an error before training. The run does not depend on
        it.
        """
        states, threads = random_states(), torch.get_num_threads()
        with TemporaryDirectory() as temporary:
            small = copy(self)
            small.trainee, small.folder = self.trainee.brief(), Path(temporary) / self.folder.name
            small.folder.mkdir()
            if (self.folder / CONFIG).exists():
                shutil.copy(self.folder / CONFIG, small.folder)
            content = small.results(BRIEF_EPISODES)
            if self.present is not None:
                evaluation = {k: float(v or 0.0) for k, v in content["evaluation"].items()}
                small.rows = self.rows or [{"frames": 0.0, "seconds": 0.0, **evaluation}]
                write_csv(small.folder / METRICS, small.rows)
                self.present(small, content)
        torch.set_num_threads(threads)
        set_random_states(states)

    def evaluate(
        self, report: OnReport[T] = lambda run, row: None, signals: Signals | None = None
    ) -> None:
        """Evaluate, and save the row, the policies that are kept, and the checkpoint.

        One that is not due, where `report` stopped the run, leaves no trace in a resumed run.
        """
        signals = signals or Signals()
        frames, due = self.trainee.frames, self.due > self.evaluations
        due = due or frames == 0
        kept_before = self._passed(self.checkpoints)
        with self._watched():
            row = {
                "frames": float(frames),
                "seconds": self.seconds,
                "frames_per_second": frames / max(self.seconds, 1e-9),
                **self.trainee.evaluate(),
                **self.figures,
            }
        self._check_learned()
        with signals.held():
            self.rows.append(row)
            self.last_is_due = due
            write_csv(self.folder / METRICS, self.rows)
            passed = self._passed(self.checkpoints) > kept_before or self.ended
            if due and passed and self.checkpoints:
                self.keep()
            if due:
                self.evaluations = self.due
                self.trainee.forget_episodes()
            self.save()
            if due:
                self.log(row)
        report(self, row)

    def keep(self) -> None:
        """Keep the policies of the last evaluation, as the setting `checkpoints` does."""
        # The list has none of evaluations that are repeated.
        row = self.rows[-1]
        frames, aim = int(row["frames"]), self.trainee.objective
        self.trainee.keep(self.folder, frames_name(frames))
        before = {int(each["frames"]) for each in self.rows} - {frames}
        kept = [each for each in read_kept_list(self.folder).kept if each["frames"] in before]
        kept.append({name: row[name] for name in ("frames", "seconds", aim.column)})
        best = (min if aim.less_is_better else max)(kept, key=lambda each: each[aim.column])
        write_json(self.folder / KEPT_LIST, {"best": int(best["frames"]), "kept": kept})

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

    def _diverged(self, how: str) -> Diverged:
        kept = f"its checkpoint at {self.saved_frames:,} frames is kept"
        has = (self.folder / CHECKPOINT).exists()
        return Diverged(
            f"{self.folder}: training diverged at frame {self.trainee.frames:,}, after "
            f"{self.seconds:.1f} s: {how}; {kept if has else 'it has no checkpoint yet'}. Use a "
            "lower learning_rate"
        )

    def save(self) -> None:
        """Write the checkpoint, from which a resumed run continues exactly; earlier results are
        marked as outdated."""
        state: Plain = {"seconds": self.seconds, "evaluations": self.evaluations}
        rows = len(self.rows) - (not self.last_is_due)
        state |= {"rows": rows, "figures": self.figures, **random_states()}
        state["budget"] = self.budget.amount
        state |= {"ended": True} if self.ended else {}
        save_checkpoint(self.folder, {"trainee": self.trainee.state_dict(), **state})
        self.saved_frames = self.trainee.frames
        self.trainee.save_beside(self.folder)
        if (self.folder / RESULTS).exists():
            write_json(self.folder / RESULTS, load_results(self.folder) | {"outdated": True})

    @own_defaults()
    def results(
        self,
        episodes: int = 1000,
        exact_seconds: float | None = None,
        tell: Tell = lambda what, share: None,
    ) -> Plain:
        """Evaluate the trained policy and the references, and write `results.json`.

        Figures of earlier results are deleted, so that commands draw new ones.

        Args:
            episodes: of scores that are not exact.
            exact_seconds: that exact solutions of large games may take; 0 for none, None for no
                limit.
            tell: called with a description and the progress in [0, 1] of long work.
        """
        trainee = self.trainee
        if (self.folder / CHECKPOINT).exists():  # the last save may have been interrupted
            trainee.save_beside(self.folder)
        best = read_kept_list(self.folder).best

        def evaluated() -> Plain:
            found = trainee.results(episodes)
            if best is not None:
                try:
                    kept = trainee.evaluate_kept(self.folder, best, episodes)
                    found["best"] = {"frames": best, **kept}
                except ValueError as error:  # deleted since, or damaged
                    warnings.warn(f"{error}; results.json has no best policy", stacklevel=2)
            return found

        found, limit = in_time(evaluated, exact_seconds, tell)
        content = {
            "format": RESULTS_FORMAT,
            "kind": trainee.kind,
            **found,
            **({"exact_limit": limit} if limit else {}),
            "objective": asdict(trainee.objective),
            "frames": trainee.frames,
            "seconds": round(self.seconds, 3),
            "clock": self.budget.clock,
            "frames_per_second": round(trainee.frames / max(self.seconds, 1e-9), 1),
            "interrupted": not self.is_trained,
            "parts": recorded_parts(self.folder / CONFIG),
            "versions": versions(),
            "machine": machine(),
        }
        if trainee.evaluates_first and self.rows:
            content["at_start"] = self.rows[0]
        if (self.folder / RESULTS).exists():  # else they are of these results, which were lost
            for name in (CURVE, REPLAY):
                (self.folder / name).unlink(missing_ok=True)
        write_json(self.folder / RESULTS, content)
        return content


OnReport = Callable[[Run[T], dict[str, float]], None]


# -- a run from its settings -----------------------------------------------------------------------


@own_defaults()
def build_parts(parts_of: Callable[[S], P], settings: S) -> P:
    """The parts of a run, built by `parts_of` after torch has been configured for it.

    Raises:
        ValueError: settings that cannot run here.
    """
    check_device(settings.device)
    prepare_torch(settings.fixed_threads, settings.seed)
    return parts_of(settings)


@own_defaults()
def build_run(
    trainee_of: Callable[[P, Path, Plain | None], T],
    parts: P,
    folder: Path,
    state: Plain | None = None,
    budget: Budget | None = None,
    marks: Sequence[float] | None = None,
) -> Run[T]:
    """The run of `build_parts` in its folder, new or from a checkpoint.

    Args:
        trainee_of: (parts, folder, its state) -> the trainee.
        parts, folder, state, marks: as of `Run`.
        budget: None for that of the settings.

    Raises:
        ValueError: a checkpoint that does not match the settings.
    """
    try:
        settings = parts.settings
        trainee = trainee_of(parts, folder, None if state is None else state["trainee"])
        budget = budget or Budget.of(settings)
        return Run(trainee, folder, budget, state, marks, settings.checkpoints, settings.log)
    except MISFITS as error:
        if state is None or isinstance(error, ImitationError):
            raise
        raise misfit(folder, error) from error
