"""`pursuit sweep`."""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pursuit.validation import at_least, choice
from train.commands.parse import parse
from train.files import check_output_folder
from train.settings.checks import Settings, check

if TYPE_CHECKING:
    from train.experiments.study import Study

ENDED = ("complete", "failed")
"""Statuses of runs that have ended."""


@dataclass(frozen=True)
class SweepCommand(Settings):
    """Execute all runs of a sweep file; complete runs are skipped, interrupted runs are resumed.

    The command `pursuit sweep --list` lists the shipped files, which are the experiments of the
    thesis.
    """

    file: Annotated[str | None, tyro.conf.Positional] = None
    """A sweep file (.toml), or the name of a shipped one."""
    list: bool = False
    """List the shipped sweep files."""
    version: str | None = None
    """short or full, if the file has both; by default short."""
    out: Path | None = None
    """The folder of the sweep; by default sweeps/NAME, of the full version sweeps/NAME-full."""
    executor: Annotated[str, choice("local", "ray")] = "local"
    """local: processes of this machine, one core each. ray: tasks of a Ray cluster."""
    workers: Annotated[int, at_least(0)] = 0
    """Parallel local processes; 0: one per core."""
    address: str | None = None
    """Address of the Ray cluster ("auto": that of this machine); by default one is started here."""
    dry_run: bool = False
    """Check the file and list the runs (status, varying settings, folder) without executing
    them."""
    overwrite: bool = False
    """Use --out even if it contains another sweep. Its runs are kept, its report is replaced."""


def sweep(arguments: Sequence[str]) -> None:
    """`pursuit sweep`."""
    given = parse(SweepCommand, arguments, "sweep")
    check_options(given)
    from train.experiments.sweep import load_sweep, shipped  # torch is slow to import

    if given.list:
        for name in shipped():
            print(f"{name:<28}{load_sweep(name).title}")
        return
    plan = load_sweep(str(given.file), given.version)
    carry_out(plan, given, f"pursuit sweep {shlex.join(arguments)}")


def check_options(given: SweepCommand) -> None:
    """ValueError for options that are invalid for every sweep file."""
    check(
        given.file is None or not given.list,
        f"file {given.file!r} with --list; leave one of the two out",
    )
    check(given.list or given.file is not None, "no file; give one, or --list")
    check(
        given.address is None or given.executor == "ray",
        f"address={given.address!r} is for Ray clusters; give --executor ray, or leave it out",
    )


def carry_out(plan: Study, given: SweepCommand, again: str, parent: str = "sweeps") -> None:
    """Execute the runs of `plan`, print the progress, and write the report.

    Exits with status 1 if runs failed; `again` is the command that continues. The folder is by
    default in `parent`.

    Raises:
        ValueError: invalid options.
        KeyboardInterrupt: on interruption; checkpoints are saved.
    """
    from train.experiments.executors import run_locally, run_on_ray  # torch is slow to import
    from train.experiments.report import report_on
    from train.experiments.study import is_folder_of, statuses_of

    stem = Path(str(given.file)).stem
    out = given.out or Path(parent) / (f"{stem}-full" if given.version == "full" else stem)
    check_output_folder(out, lambda folder: is_folder_of(plan, folder), given.overwrite)
    if given.dry_run:
        list_runs(plan, out)
        return
    out.mkdir(parents=True, exist_ok=True)
    watch, workers = SweepWatch(), given.workers or os.cpu_count() or 1
    print(f"{plan.title}: {len(plan.runs)} runs into {out}")
    with resumable(again, lambda: f" ({counts(statuses_of(plan, out).values())})"):
        if given.executor == "local":
            statuses = run_locally(plan, out, workers, watch)
        else:
            statuses = run_on_ray(plan, out, given.address, watch)
    print(counts(statuses.values()))
    if "complete" in statuses.values():
        print(f"report: {report_on(out) / 'report.md'}")
    left = {name: status for name, status in statuses.items() if status != "complete"}
    for name, status in left.items():
        folder = out / "runs" / name
        where = folder / "error.txt" if status == "failed" else f"{folder}; continue with: {again}"
        print(f"{status}: {where}", file=sys.stderr)
    if left:
        sys.exit(1)


@contextlib.contextmanager
def resumable(again: str, now: Callable[[], str] = lambda: "") -> Iterator[None]:
    """Print the progress (`now`) and the command that continues if interrupted."""
    try:
        yield
    except KeyboardInterrupt:
        print(
            f"\ninterrupted; completed work is kept{now()}. Continue with: {again}", file=sys.stderr
        )
        raise


def counts(statuses: Iterable[str]) -> str:
    """The number of runs of each status, as text."""
    found = sorted(Counter(statuses).items())
    return ", ".join(f"{number} {status}" for status, number in found)


def list_runs(plan: Study, out: Path) -> None:
    """Print the status, the varying settings and the folder of every run."""
    from train.experiments.study import folder_of, statuses_of  # torch is slow to import

    statuses = statuses_of(plan, out)
    for run in plan.runs:
        what = " ".join(f"{n}={v}" for n, v in (run.label | {"seed": run.seed}).items())
        print(f"{statuses[run.name]:<12}{what}  {folder_of(out, run.name)}")
    if "control" in plan.report:
        from train.experiments.attainable import out_of_reach

        for line in out_of_reach(plan):
            print(line)
    print(
        f"{len(statuses)} runs into {out} ({counts(statuses.values()) or 'none'}); nothing was done"
    )


class SweepWatch:
    """Prints the progress of a sweep, when a run starts or ends and every 30 seconds."""

    def __init__(self) -> None:
        self.began, self.printed = time.monotonic(), 0.0
        self.before: dict[str, str] = {}
        self.done_before: set[str] | None = None

    def __call__(self, statuses: dict[str, str], progress: dict[str, float]) -> None:
        """Print runs that have ended, and the progress."""
        if self.done_before is None:
            self.done_before = {name for name, s in statuses.items() if s == "complete"}
            if self.done_before:
                print(f"{counts(statuses[name] for name in self.done_before)} already")
        reported = (*ENDED, "interrupted")
        for name, status in statuses.items():
            new = status != self.before.get(name) and name not in self.done_before
            if new and status in reported:
                print(f"{status:<12}{name}", flush=True)
        ended = sum(status in ENDED for status in statuses.values())
        now = time.monotonic()
        if statuses != self.before or now - self.printed > 30:
            self.printed, self.before = now, dict(statuses)
            left = self.seconds_left(statuses, progress)
            parts = [f"{ended} of {len(statuses)} done", f"{len(progress)} running"]
            if progress:
                parts.append(" ".join(f"{100 * share:.0f}%" for share in progress.values()))
            if left is not None:
                parts.append(f"about {_span(left)} left")
            print(", ".join(parts), flush=True)

    def seconds_left(self, statuses: dict[str, str], progress: dict[str, float]) -> float | None:
        """The expected remaining time, from the time so far; None until that is long enough."""
        left = sum(
            1.0 - progress.get(name, 0.0)
            for name, status in statuses.items()
            if status not in ENDED
        )
        done = len(statuses) - len(self.done_before or ()) - left
        return None if done < 0.05 else (time.monotonic() - self.began) / done * left


def _span(seconds: float) -> str:
    minutes = round(seconds / 60)
    if minutes < 1:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60:.1f} h"
