"""Training in the terminal: a progress bar and a line for every evaluation."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, redirect_stdout
from math import isnan
from pathlib import Path
from shlex import quote
from shutil import get_terminal_size
from time import perf_counter, strftime
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from train.commands.parse import options_in
from train.commands.run_options import RunCommand
from train.files import Plain, check_folder

if TYPE_CHECKING:
    from train.runs.forms import Final
    from train.runs.loop import Run
    from train.runs.trainee import Trainee
    from train.settings.self_play import WholeSettings

T = TypeVar("T", bound="Trainee")

ERASE = "\r\x1b[K"
"""Empties the current line of a terminal."""
COLUMNS = 100
"""Of a line of progress, at most."""

QUIET = 2.0
"""Work of fewer seconds is not reported."""


class ProgressLine:
    """Reports the progress of long work on stderr, with the expected remaining time; nothing for
    work of a few seconds.

    In a terminal one line is updated, elsewhere a line is printed every minute.

    Attributes:
        muted: whether nothing is reported at all.
    """

    muted: ClassVar[bool] = False

    def __init__(self) -> None:
        self.began = self.reported = perf_counter()
        self.what, self.open = "", False

    def close(self) -> None:
        """Erase an open line."""
        if self.open:
            self.open = False
            print(ERASE, end="", file=sys.stderr, flush=True)

    def __call__(self, what: str, share: float, state: str = "", left: str = "") -> None:
        """Report the current work.

        Args:
            what: the work, shortened if the line is too long.
            share: its completed share in [0, 1]; NaN if unknown.
            state, left: in words, before and after the time so far; of a known share in per cent.
        """
        now, live = perf_counter(), sys.stderr.isatty()
        if self.muted:
            return
        if what != self.what:
            self.close()
            self.what, self.began, self.reported = what, now, now
        elif now - self.reported >= (0.5 if live else 60.0) and now - self.began >= QUIET:
            self.reported, self.open, took = now, live, now - self.began
            if not isnan(share):
                state = f"{100 * share:.0f} %"
                left = f"about {duration(took / share - took)} left" if share > 0.0 else ""
            parts = ", ".join(filter(None, (state, f"{duration(took)} so far", left)))
            width = min(get_terminal_size().columns - 1, COLUMNS) if live else COLUMNS
            line = f"{what[: max(width - len(parts) - 2, 0)]}: {parts}"[:width]
            begin, end = (ERASE, "") if live else ("", "\n")
            print(f"{begin}{line}", end=end, file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """A time in words, in seconds, minutes or hours."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5970 else f"{seconds / 3600:.1f} h"


class TrainingProgress:
    """Shows the progress of a run: a bar in a terminal, and a line for every evaluation."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

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

    def __call__(self, run: Run, row: dict[str, float]) -> None:
        """Report a rollout (an empty row) or an evaluation."""
        self.progress.update(self.task, completed=run.progress)
        if not row:
            return
        console, lines = self.progress.console, [""]
        fields = [
            f"{100 * run.progress:3.0f} %",
            f"{run.seconds:6.1f} s",
            f"{run.trainee.frames / 1e6:7.2f} M frames",
            *run.trainee.log_fields(row),
        ]
        if console.is_terminal:
            fields.insert(3, f"{row['frames_per_second'] / 1e3:5.1f} k/s")
            lines = ["  ".join(fields)]
        else:
            for field in (" ".join(each.split()) for each in fields):
                if len(lines[-1]) + len(field) + 2 > COLUMNS:
                    lines.append("  ")
                lines[-1] += f"  {field}" if lines[-1] else field
        console.print("\n".join(lines), highlight=False, soft_wrap=True)


@contextmanager
def quietly(quiet: bool) -> Iterator[None]:
    """A part that prints only warnings and errors, if it is to be quiet."""
    if not quiet:
        yield
        return
    from pursuit.compilation.compiler import ANNOUNCER

    ProgressLine.muted = ANNOUNCER.muted = True
    try:
        with open(os.devnull, "w", encoding="utf-8") as nothing, redirect_stdout(nothing):
            yield
    finally:
        ProgressLine.muted = ANNOUNCER.muted = False


def start_or_resume(
    kind: str, settings: WholeSettings, given: RunCommand, arguments: Sequence[str], name: str
) -> tuple[Run, Final]:
    """The run that a command starts or resumes, and the settings of its final results.

    Args:
        kind: of the run.
        settings: of a new run.
        given: the command.
        arguments: of the command.
        name: of a new run's folder, without the time.

    Raises:
        ValueError: settings that cannot run, too few episodes, a folder that is not empty, or no
            run to resume.
    """
    from train.evaluation.games import usual_episodes
    from train.runs.folder import CONFIG, check_new, load_config
    from train.runs.forms import Final
    from train.runs.unused_settings import resolved_settings

    final, folder = Final(usual_episodes(settings.task.build(), 1000)), given.resume
    if folder is not None and (folder / CONFIG).exists():
        final = load_config(folder).final
    own = {n: v for n in Final.__struct_fields__ if (v := getattr(given, n)) is not None}
    final = Final(**{**final.arguments(), **own})
    out = given.out or Path("runs") / f"{name}-{strftime('%Y%m%d-%H%M%S')}"
    if folder is None:
        check_new(out)
    else:
        check_folder(folder)
    from train.kinds import resume, start  # torch is slow to import

    if folder is None:
        run = start(kind, settings, out, final)
    else:
        budget = {*options_in(arguments)} & {"frames", "seconds"}
        new = {name: getattr(settings, name) for name in budget}
        run = resume(folder, kind, stretch=given.stretch, **new)
    trainee: Any = run.trainee
    if chosen := resolved_settings(trainee.parts.settings):
        print(f"auto: {', '.join(f'{name} {value}' for name, value in chosen.items())}")
    return run, final


def kept(run: Run) -> str:
    """What an interrupted run has saved, in words."""
    if run.progress >= 1.0:
        return "trained and saved, the final evaluation is missing"
    saved = run.saved_frames
    return f"saved at {saved:,} frames, {100 * run.progress:.0f} %" if saved else "nothing is saved"


def finish_run(
    run: Run[T], final: Final, again: str, present: Callable[[Run[T], Plain], None] | None
) -> Plain:
    """Train until the end of the budget; then evaluate, draw, and return the results.

    For a complete run the existing results are drawn and returned.

    Args:
        run: new or resumed.
        final: settings of the final evaluation.
        again: the command that resumes it.
        present: writes the figures and the report, as `Run.present`; None for none.
    """
    from train.runs.folder import CONFIG, is_complete, load_results
    from train.runs.provenance import allow_options

    print(f"folder: {run.folder}", flush=True)
    run.present = present
    content = load_results(run.folder) if is_complete(run.folder) else None
    if content is None:
        try:
            if not run.is_trained:
                watch = TrainingProgress()
                with watch.progress:
                    run.train(watch)
            began = perf_counter()
            with closing(ProgressLine()) as tell:
                content = run.results(**final.arguments(), tell=tell)
            if (spent := perf_counter() - began) >= QUIET and not ProgressLine.muted:
                print(f"final evaluation: {spent:.0f} s", file=sys.stderr)
            if limit := content.get("exact_limit"):
                print(f"{limit}; `pursuit evaluate` has none by default", file=sys.stderr)
        except KeyboardInterrupt:
            again += f"{allow_options(run.folder / CONFIG)} --resume {quote(str(run.folder))}"
            print(f"interrupted; {kept(run)}; resume with: {again}", file=sys.stderr)
            raise
    if present is not None:
        present(run, content)
    return content


def print_end(files: str, folder: Path, content: Plain) -> None:
    """Print which files a run has written, the best policy that it kept, and the command that
    shows the files."""
    from train.runs.folder import CONFIG
    from train.runs.provenance import allow_options

    if best := content.get("best"):
        aim, frames = content["objective"], f"{best['frames']:,}"
        exact = best.get("exact", aim["column"] == "nash_conv")
        how = "exact" if exact else "on other starts than those that chose it"
        value = f"{aim['column']} {best[aim['column']]:.4g} ({how})"
        print(f"best kept policy: at {frames} frames, {value}; use it by --at best")
    print(f"{files}: {folder}")
    print(f"look: pursuit view{allow_options(folder / CONFIG)} {quote(str(folder))}")
