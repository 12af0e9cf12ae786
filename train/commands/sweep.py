"""`pursuit sweep`."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from train.commands.parse import Formats, parse
from train.experiments.exact import write_exact
from train.figures import Look
from train.files import check_output_folder
from train.settings.checks import check

if TYPE_CHECKING:
    from train.experiments.sweep import Sweep

DONE = ("complete", "stopped")
"""Runs that are not done when a sweep is run again."""
ENDED = (*DONE, "failed")
"""Runs that a sweep has no more to do with."""


@dataclass(frozen=True)
class SweepCommand:
    """Do all runs of a sweep file; those that are complete are skipped, others are resumed.

    `pursuit sweep --list` names the shipped files, which are the experiments of the thesis.
    """

    file: Annotated[str | None, tyro.conf.Positional] = None
    """A sweep file (.toml), or the name of a shipped one."""
    list: bool = False
    """Name the shipped sweep files."""
    version: str | None = None
    """short or full, where the file has both; short if left out."""
    out: Path | None = None
    """The folder of the sweep; sweeps/NAME-VERSION if left out."""
    executor: str = "local"
    """local: processes of this machine, one core each. ray: tasks of a Ray cluster."""
    workers: int = 0
    """Local processes at a time; 0 is one for each core."""
    address: str | None = None
    """Of the Ray cluster ("auto": that of this machine); one is started here if left out."""
    again: bool = False
    """Go on, too, with the runs that a scheduler stopped early."""
    dry_run: bool = False
    """Check the file and list the runs: how far each is, what varies, its folder; and what so many
    can show. But do none."""
    format: Formats = ()
    """pdf, svg, or both: figures are saved so, too, beside their .png."""
    overwrite: bool = False
    """Use --out though it is the folder of another sweep: its runs stay, its report is replaced."""


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
    """ValueError for options that no sweep takes, whatever its file."""
    check(
        given.file is None or not given.list,
        f"{given.file!r} with --list, which names the shipped files; leave one of the two out",
    )
    check(given.list or given.file is not None, "give a file, or --list")
    check(given.executor in ("local", "ray"), f"unknown executor {given.executor!r}; local or ray")
    check(
        given.address is None or given.executor == "ray",
        f"address={given.address!r} is of a Ray cluster; give --executor ray, or leave it out",
    )
    check(given.workers >= 0, f"workers={given.workers}; at least 0")
    Look(given.format)


def carry_out(plan: Sweep, given: SweepCommand, again: str) -> None:
    """Do the runs of `plan` as the options say, watch them, and report.

    Exits with 1 where runs failed; `again` says how to go on.

    Raises:
        ValueError: options that make no sense.
        KeyboardInterrupt: it was interrupted; what was learned is saved.
    """
    from train.experiments.executors import run_locally, run_on_ray  # torch is slow to import
    from train.experiments.report import report
    from train.experiments.sweep import is_folder_of, status_of

    check(
        plan.scheduler is None or given.executor == "ray",
        f"scheduler={plan.scheduler!r} needs --executor ray; or leave it out of [search]",
    )
    look = Look(given.format)
    stem = Path(str(given.file)).stem
    out = given.out or Path("sweeps") / (f"{stem}-{given.version}" if given.version else stem)
    check_output_folder(out, lambda folder: is_folder_of(plan, folder), given.overwrite)
    if given.dry_run:
        list_runs(plan, out)
        return
    out.mkdir(parents=True, exist_ok=True)
    if plan.exact is not None:
        print(write_exact(plan.title, plan.exact, out))
    if not plan.runs:
        return
    watch = SweepWatch(plan, given.workers or os.cpu_count() or 1)
    print(f"{plan.title}: {len(plan.runs)} runs into {out}")
    try:
        if given.executor == "local":
            workers = given.workers or os.cpu_count() or 1
            statuses = run_locally(plan, out, workers, watch, given.again)
        else:
            statuses = run_on_ray(plan, out, given.address, watch, given.again)
    except KeyboardInterrupt:
        now = counts(status_of(out / "runs" / run.name) for run in plan.runs)
        print(
            f"\ninterrupted; {now} (what was interrupted goes on from its last checkpoint). "
            f"Go on with: {again}",
            file=sys.stderr,
        )
        raise
    print(counts(statuses.values()))
    if "complete" in statuses.values():
        print(f"report: {report(out, look) / 'report.md'}")
    left = {name: status for name, status in statuses.items() if status not in DONE}
    for name, status in left.items():
        folder = out / "runs" / name
        where = folder / "error.txt" if status == "failed" else f"{folder}; go on with: {again}"
        print(f"{status}: {where}", file=sys.stderr)
    if left:
        sys.exit(1)


def counts(statuses: Iterable[str]) -> str:
    """How many runs there are of each status, in words."""
    found = sorted(Counter(statuses).items())
    return ", ".join(f"{number} {status}" for status, number in found)


def list_runs(plan: Sweep, out: Path) -> None:
    """Print every run: how far it is, what varies, its folder; and what so many can show."""
    from train.experiments.power import power_lines  # torch is slow to import
    from train.experiments.sweep import status_of

    folders = [out / "runs" / run.name for run in plan.runs]
    statuses = [status_of(folder) for folder in folders]
    for run, folder, status in zip(plan.runs, folders, statuses, strict=True):
        what = " ".join(f"{n}={v}" for n, v in (run.label | {"seed": run.settings.seed}).items())
        print(f"{status:<12}{what}  {folder}")
    for line in power_lines(plan):
        print(f"power: {line}")
    print(f"{len(folders)} runs into {out} ({counts(statuses) or 'none'}); nothing was done")


class SweepWatch:
    """Says how far a sweep is: a line whenever a run begins or ends, and every half minute."""

    def __init__(self, plan: Sweep, workers: int) -> None:
        self.budgets = {run.name: run.settings.seconds for run in plan.runs}
        self.workers, self.began, self.told = workers, time.monotonic(), 0.0
        self.before: dict[str, str] = {}
        self.done_before: set[str] | None = None
        self.live = sys.stdout.isatty()

    def __call__(self, statuses: dict[str, str], progress: dict[str, float]) -> None:
        """Print what is new."""
        if self.done_before is None:
            self.done_before = {name for name, s in statuses.items() if s in DONE}
            if self.done_before:
                print(f"{counts(statuses[name] for name in self.done_before)} already")
        told = (*ENDED, "interrupted")
        for name, status in statuses.items():
            new = status != self.before.get(name) and name not in self.done_before
            if new and status in told:
                print(("\r" if self.live else "") + f"{status:<12}{name}", flush=True)
        ended = sum(status in ENDED for status in statuses.values())
        now = time.monotonic()
        if statuses != self.before or now - self.told > (1 if self.live else 30):
            self.told, self.before = now, dict(statuses)
            left = self.seconds_left(statuses, progress)
            parts = [f"{ended} of {len(statuses)} done", f"{len(progress)} running"]
            if progress:
                parts.append(" ".join(f"{100 * share:.0f}%" for share in progress.values()))
            if left is not None:
                parts.append(f"about {_span(left)} left")
            line = ", ".join(parts)
            print(f"\r{line:<78}" if self.live else line, end="" if self.live else "\n", flush=True)

    def seconds_left(self, statuses: dict[str, str], progress: dict[str, float]) -> float | None:
        """By the budgets where they are seconds, else by what was done so far."""
        shares = {
            name: 1.0 - progress.get(name, 0.0)
            for name, status in statuses.items()
            if status not in ENDED
        }
        budgets = [self.budgets[name] for name in shares]
        if all(budget is not None for budget in budgets):
            work = sum(s * b for s, b in zip(shares.values(), budgets, strict=True) if b)
            return 1.15 * work / self.workers
        done = len(statuses) - len(self.done_before or ()) - sum(shares.values())
        if done < 0.05:
            return None
        return (time.monotonic() - self.began) / done * sum(shares.values())


def _span(seconds: float) -> str:
    minutes = round(seconds / 60)
    if minutes < 1:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60:.1f} h"
