"""Training on the terminal: a live bar with lines above it, or lines alone elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, strftime
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from train.commands.parse import heard
from train.files import check_folder
from train.runs.folder import CONFIG, check_new, load_final, load_results
from train.runs.forms import Final
from train.runs.provenance import allow_options

if TYPE_CHECKING:
    from train.runs.loop import Run

QUIET = 2.0
"""Seconds of work that need no report."""


class Alive:
    """Says on stderr that long work goes on, and how far it is; nothing of what is done in seconds.

    On a terminal one line is written over again, elsewhere there is a line now and then.
    """

    def __init__(self) -> None:
        self.began = self.told = perf_counter()
        self.what, self.open = "", False

    def __call__(self, what: str, share: float) -> None:
        """Report what goes on, and its share that is done, in [0, 1]."""
        now, live = perf_counter(), sys.stderr.isatty()
        if what != self.what:
            self.what, self.began, self.told = what, now, now
        elif now - self.told >= (0.5 if live else 10.0) and now - self.began >= QUIET:
            self.told, self.open = now, live
            line = f"{what}: {100 * share:3.0f} %, {now - self.began:.0f} s"
            print(
                f"\r{line}" if live else line, end="" if live else "\n", file=sys.stderr, flush=True
            )
        if share >= 1.0 and self.open:
            self.open = False
            print(file=sys.stderr)


class Watch:
    """Shows a run as it learns: a bar on a terminal, and a line for every evaluation."""

    def __init__(self) -> None:
        console = Console()
        self.progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self.task = self.progress.add_task("learning", total=1.0)

    def __enter__(self) -> Self:
        self.progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.progress.stop()

    def __call__(self, run: Run, row: dict[str, float]) -> None:
        """Report a rollout (an empty row) or an evaluation."""
        self.progress.update(self.task, completed=run.progress)
        if not row:
            return
        parts = [
            f"{100 * run.progress:3.0f} %",
            f"{run.seconds:6.1f} s",
            f"{run.trainee.frames / 1e6:7.2f} M frames",
            f"{row['frames_per_second'] / 1e3:5.1f} k/s",
            *run.trainee.log_fields(row),
        ]
        self.progress.console.print("  ".join(parts), highlight=False, soft_wrap=True)


@dataclass(frozen=True, kw_only=True)
class RunCommand:
    """Where a run lies, and what its final results are made with."""

    out: Path | None = None
    """A new folder for the run; runs/NAME-TIME if left out."""
    resume: Path | None = None
    """Go on with the run in this folder instead; all other options are taken from there."""
    episodes: int | None = None
    """Episodes of the final evaluation, where it is not exact; if left out 1000, or with --resume
    those of the first command."""


def begun(kind: str, settings: Any, given: RunCommand, name: str) -> tuple[Run, Final]:
    """The run that a command begins or goes on with, and what its final results are made with.

    Args:
        kind: of the run.
        settings: of a new one.
        given: the command.
        name: of the folder of a new one, but for the time.

    Raises:
        ValueError: settings that cannot run, too few episodes, a folder that holds anything, or no
            run to resume.
    """
    final, folder = Final(), given.resume
    if folder is not None and (folder / CONFIG).exists():
        final = load_final(folder)
    if given.episodes is not None:
        final = Final(given.episodes)
    out = given.out or Path("runs") / f"{name}-{strftime('%Y%m%d-%H%M%S')}"
    if folder is None:
        check_new(out)
    else:
        check_folder(folder)
    from train.experiments.kinds import resume, start  # torch is slow to import

    with heard():
        run = start(kind, settings, out, final) if folder is None else resume(folder, kind)
    return run, final


def carry_out(
    run: Run, episodes: int, again: str, before: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Train as far as the budget goes, or Ctrl-C lets it; evaluate, and give the results.

    What was done before is not done again: a run that is complete has its results already.

    Args:
        run: begun, or to go on with.
        episodes: of the final evaluation.
        again: the command that goes on with it.
        before: is called when the results are about to be made.
    """
    from train.experiments.kinds import is_complete  # torch is slow to import

    print(f"folder: {run.folder}", flush=True)
    if is_complete(run.folder):
        return load_results(run.folder)
    if run.progress < 1.0:
        with Watch() as watch:
            run.train(watch)
    if run.stopped:
        again += allow_options(run.folder / CONFIG)
        print(f"interrupted; go on with: {again} --resume {run.folder}", file=sys.stderr)
    try:
        before()
        return run.results(episodes)
    except KeyboardInterrupt:
        hint = f"interrupted before its results were made; go on with: {again} --resume"
        print(f"{hint} {run.folder}", file=sys.stderr)
        raise


def leave(run: Run) -> None:
    """End the command: after a signal, with the exit status that says so."""
    if run.exit_status:
        sys.exit(run.exit_status)
