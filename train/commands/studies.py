"""`pursuit sweep`, `ablate`, `compare` and `reproduce`: studies, from the file to the report."""

from __future__ import annotations

import re
import shlex
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import chain
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pursuit.validation import at_least, check, choice, passes
from train.commands.parse import parse
from train.commands.progress import ProgressLine, duration
from train.experiments.shards import shard_of
from train.experiments.study import ENDED, StudyFile, shipped
from train.files import check_output_folder
from train.settings.checks import Settings

if TYPE_CHECKING:
    from train.experiments.runs import Study, TrainingRun
    from train.experiments.stages import Stage


@dataclass(frozen=True)
class SweepCommand(Settings):
    """Execute all runs of a sweep file; complete runs are skipped, interrupted runs are resumed.

    The command `pursuit sweep --list` lists the shipped files, which are the experiments of the
    thesis.
    """

    file: Annotated[str | None, tyro.conf.Positional] = None
    """A study file (.toml), or the name of a shipped one."""
    list: bool = False
    """List the shipped files."""
    version: str | None = None
    """short or full, if the file has both; by default short."""
    out: Path | None = None
    """The folder of the study; by default sweeps/NAME (ablations/NAME, comparisons/NAME-short), of
    the full version NAME-full."""
    executor: Annotated[str, choice("local", "ray")] = "local"
    """local: processes of this machine, one core each. ray: tasks of a Ray cluster."""
    workers: Annotated[int, at_least(0)] = 0
    """Parallel local processes; 0: one per core."""
    address: str | None = None
    """Address of the Ray cluster ("auto": that of this machine); by default one is started here."""
    dry_run: bool = False
    """Check the file and list the runs (status, varying settings, folder) without executing
    them."""
    rows: Path | None = None
    """A folder for the rows of finished runs: runs.csv, with a search for settings tuning.csv. Runs
    whose row is there are not executed again, also on another machine and without --out."""
    shard: Annotated[str | None, passes(shard_of)] = None
    """K/N, such as 3/10: execute the part K of N of the runs, with rows in a file of its own, such
    as runs-3-of-10.csv in --rows. The same command without --shard makes the report of all."""
    overwrite: bool = False
    """Use --out even if it contains another study. Its runs are kept, its report is replaced."""


@dataclass(frozen=True)
class AblateCommand(SweepCommand):
    """Compare variants (such as curricula) with a control, over several seeds.

    All variants have the same budget and are evaluated on the task itself, at its final difficulty,
    throughout training. `pursuit ablate --list` lists the shipped files. Complete runs are skipped,
    interrupted runs are resumed.
    """


@dataclass(frozen=True)
class CompareCommand(SweepCommand):
    """Compare PPO of several libraries on the same tasks, with the same budget for tuning.

    Settings are searched on held-out mazes. Then every library learns the tasks with several
    seeds, and the time to 5, 2 and 1 % of the exact optimum is measured. Completed runs are not
    repeated, so Ctrl-C loses at most one run.
    """

    file: Annotated[str | None, tyro.conf.Positional] = "ppo"
    """A comparison file (.toml), or the name of a shipped one."""
    clock: str | None = None
    """wall, or processor: processor time of the run's process, which other load on the machine
    affects less. By default the clock of the file."""
    workers: Annotated[int, at_least(0)] = 1
    """Parallel local processes; 0: one per core. Use 1 for published timings: cores share caches
    and memory bandwidth."""


@dataclass(frozen=True)
class ReproduceCommand(Settings):
    """Repeat the experiments of the thesis, and decide its claims.

    First settings are searched, with the same budget for every algorithm. Then the studies run, and
    a page lists every claim with its rule, verdict and evidence. Complete runs are skipped, so the
    same command continues after Ctrl-C. The short version takes some hours on two cores,
    the full one some days; --dry-run lists the budgets.
    """

    studies: Annotated[tuple[str, ...], tyro.conf.Positional] = ("all",)
    """all, or studies by name: figure-4.2, figure-4.6, ... (see --list)."""
    claims: str = "thesis"
    """thesis: the claims of the thesis. optimum: hypotheses on the parts of gaps. Or a replication
    file (.toml)."""
    list: bool = False
    """List the studies and their claims."""
    version: str = "short"
    """short or full."""
    mazes: Path | None = None
    """A folder with the mazes of the thesis: text files, one of each size, that replace the shipped
    mazes of the same size."""
    out: Path | None = None
    """The folder of the replication; replications/CLAIMS-VERSION by default."""
    workers: Annotated[int, at_least(0)] = 0
    """Parallel runs, one core each; 0: one per core."""
    dry_run: bool = False
    """List the runs without executing them."""
    page: bool = False
    """Only write the page from the complete runs."""
    overwrite: bool = False
    """Use --out even if it contains another replication. Its runs are kept, its page is
    replaced."""


def sweep(arguments: Sequence[str]) -> None:
    """`pursuit sweep`."""
    run_study_file(SweepCommand, arguments, "sweep", "sweep")


def ablate(arguments: Sequence[str]) -> None:
    """`pursuit ablate`."""
    run_study_file(AblateCommand, arguments, "ablate", "ablation")


def compare(arguments: Sequence[str]) -> None:
    """`pursuit compare`."""
    run_study_file(CompareCommand, arguments, "compare", "comparison")


def run_study_file(
    form: type[SweepCommand], arguments: Sequence[str], command: str, kind: str
) -> None:
    """Execute the runs of a study file, and write the report.

    Args:
        form, arguments, command: as of `parse`.
        kind: of the study file: "sweep", "ablation" or "comparison".
    """
    options = parse(form, arguments, command)
    check(options.list or options.file is not None, "no file; give one, or --list")
    check(
        options.address is None or options.executor == "ray",
        f"address={options.address!r} is for Ray clusters; give --executor ray, or leave it out",
    )
    check(
        options.shard is None or options.rows is not None,
        f"shard={options.shard!r} without rows; give --rows FOLDER, the same to all shards",
    )
    from train.experiments.expansion import load_study  # torch is slow to import
    from train.experiments.runs import is_folder_of
    from train.experiments.stages import stages_of

    if options.list:
        check(
            options.file == form.file,
            f"file {options.file!r} with --list; leave one of the two out",
        )
        for name in shipped(kind):
            layout = load_study(name, kind).layout
            variants = f"{len(layout.variants)} variants  " if layout.control else ""
            print(f"{name:<28}{variants}{layout.title}")
        return

    def with_clock(file: StudyFile) -> StudyFile:
        if isinstance(options, CompareCommand) and options.clock is not None:
            file.settings = {**file.settings, "clock": options.clock}
        return file

    name, full = str(options.file), options.version == "full"
    version = "-full" if full else "-short" * (kind == "comparison")
    out = options.out or Path(f"{kind}s") / f"{Path(name).stem}{version}"
    stages = stages_of(name, kind, options.version, out, with_clock, options.rows)
    if options.shard is not None:
        stages = [stage.in_shard(shard_of(options.shard)) for stage in stages]
    study = stages[-1].expand()
    check_output_folder(out, lambda folder: is_folder_of(study, folder), options.overwrite)
    if options.dry_run:
        if kind == "comparison" or len(stages) > 1:
            list_stages(stages, out, options.workers)
        if kind != "comparison":
            list_runs(study, out)
    else:
        again = f"pursuit {command} {shlex.join(arguments)}"
        done = run_stages(stages, options.workers, again, options.executor, options.address)
        exit_if_failed(done[-1:], again)


def reproduce(arguments: Sequence[str]) -> None:
    """`pursuit reproduce`."""
    options = parse(ReproduceCommand, arguments, "reproduce")
    from train.experiments.claims_page import write_replication  # torch is slow to import
    from train.experiments.replication import (
        is_replication,
        keep_rules,
        load_replication,
        replication_stages,
    )

    plan = load_replication(options.studies, options.version, options.mazes, options.claims)
    if options.list:
        for study in plan.studies:
            print(f"{study.id:<20}{study.title}")
            print("\n".join(f"{'':<22}{claim.text}" for claim in study.claims))
        return
    own = "-own-mazes" if options.mazes else ""
    out = options.out or Path("replications") / f"{plan.name}-{options.version}{own}"
    check_output_folder(out, lambda folder: is_replication(plan, folder), options.overwrite)
    stages = replication_stages(plan, out)
    if options.dry_run:
        list_stages(stages, out, options.workers)
        return
    if options.page:
        check(out.is_dir(), f"{out}: no such folder; leave out --page to start the runs")
        print(f"page: {write_replication(plan, out)}")
        return
    out.mkdir(parents=True, exist_ok=True)
    keep_rules(plan, out)
    again = f"pursuit reproduce {shlex.join(arguments)}"
    done = run_stages(stages, options.workers, again)
    print(f"page: {write_replication(plan, out)}")
    exit_if_failed(done, again)


def run_stages(
    stages: Sequence[Stage],
    workers: int,
    again: str,
    executor: str = "local",
    address: str | None = None,
) -> list[tuple[Path, dict[str, str]]]:
    """Execute the runs of all stages, print the progress, and write the reports.

    Args:
        stages: of the command.
        workers: parallel local processes; 0: one per core.
        again: the command that continues.
        executor, address: local, or ray with the address of the cluster.

    Returns:
        The folder of each stage, with the status of every run.

    Raises:
        ValueError: invalid options.
        KeyboardInterrupt: on interruption; checkpoints are saved.
    """
    from train.experiments.executors import run_locally, run_on_ray  # torch is slow to import
    from train.experiments.runs import statuses_of
    from train.experiments.stages import carry_out
    from train.machine import usable_cores

    running: list[tuple[Study, Path]] = []

    def execute(study: Study, folder: Path) -> dict[str, str]:
        running[:] = [(study, folder)]
        place = [stage.folder for stage in stages].index(folder)
        later = sum(budget_left(stage) for stage in stages[place + 1 :])
        watch = SweepWatch(study.layout.title, study.own, later)
        with closing(watch.line):
            if executor == "local":
                statuses = run_locally(study, folder, workers or len(usable_cores()), watch)
            else:
                statuses = run_on_ray(study, folder, address, watch)
        print(counts(statuses.values()))
        return statuses

    try:
        merge = re.sub(r" --shard[ =]\S+", "", again)
        done = carry_out(stages, execute, lambda line: print(line, flush=True), merge)
    except KeyboardInterrupt:
        found = [*chain(*(statuses_of(*each).values() for each in running))]
        saved = counts(status for status in found if status != "new")
        kept = f"kept: {saved}" if saved else "no run has saved anything yet"
        print(f"\ninterrupted; {kept}. Continue with: {again}", file=sys.stderr)
        raise
    for folder, _ in done:
        if (folder / "report" / "report.md").exists():
            print(f"report: {folder / 'report' / 'report.md'}")
    return done


def exit_if_failed(done: Iterable[tuple[Path, dict[str, str]]], again: str) -> None:
    """Name the runs that are not complete, and exit with status 1 if there are some."""
    left = [
        (folder / "runs" / name, status)
        for folder, statuses in done
        for name, status in statuses.items()
        if status != "complete"
    ]
    for folder, status in left:
        where = folder / "error.txt" if status == "failed" else f"{folder}; continue with: {again}"
        print(f"{status}: {where}", file=sys.stderr)
    if left:
        sys.exit(1)


def counts(statuses: Iterable[str]) -> str:
    """The number of runs of each status, as text."""
    found = sorted(Counter(statuses).items())
    return ", ".join(f"{number} {status}" for status, number in found)


def budget_left(stage: Stage) -> float:
    """The budgets of the runs of a stage that are not complete, as `TrainingRun.cost`."""
    from train.experiments.runs import statuses_of  # torch is slow to import

    study = stage.expand()
    statuses = statuses_of(study, stage.folder)
    return sum(run.cost for run in study.own if statuses[run.name] != "complete")


def list_runs(plan: Study, out: Path) -> None:
    """Print the status, the varying settings and the folder of every run."""
    from train.experiments.runs import folder_of, statuses_of  # torch is slow to import
    from train.experiments.variants import out_of_reach

    statuses = statuses_of(plan, out)
    for run in plan.own:
        what = " ".join(f"{n}={v}" for n, v in (run.label | {"seed": run.seed}).items())
        print(f"{statuses[run.name]:<12}{what}  {folder_of(out, run.name)}")
    for line in out_of_reach(plan):
        print(line)
    print(
        f"{len(statuses)} runs into {out} ({counts(statuses.values()) or 'none'}); nothing was done"
    )


def list_stages(stages: Iterable[Stage], out: Path, workers: int) -> None:
    """Print the number of runs of every stage, of complete ones, and their budgets.

    Args:
        stages, workers: as in `run_stages`.
        out: the folder of the command.
    """
    from train.experiments.runs import statuses_of  # torch is slow to import
    from train.experiments.variants import out_of_reach
    from train.machine import usable_cores

    total = 0
    for stage in stages:
        plan = stage.expand()
        done = list(statuses_of(plan, stage.folder).values()).count("complete")
        total += len(plan.own) - done
        budgets = {(run.settings.seconds, run.settings.frames) for run in plan.own}
        words = " or ".join(
            f"{seconds:g} s each" if seconds is not None else f"{frames:,} frames each"
            for seconds, frames in sorted(budgets, key=str)
        )
        print(f"{stage.name:<20}{len(plan.own):>4} runs, {done} complete; {words}")
        if plan.pinned and stage.folder == out:
            for line in out_of_reach(plan):
                print(line)
    parallel = workers or len(usable_cores())
    print(f"{total} runs to do into {out}, {parallel} in parallel; nothing was done")


class SweepWatch:
    """Prints the runs of a study that end, and its progress with the expected remaining time.

    That is the time for the budgets of the runs left, at the speed of the runs so far.

    Args:
        title: of the study.
        runs: those that this command executes.
        later: the budgets (`TrainingRun.cost`) of further studies.

    Attributes:
        started: by run its time, and its progress then.
        took: by run the seconds to its last progress, and the share of its budget that they made.
    """

    def __init__(self, title: str, runs: Sequence[TrainingRun], later: float = 0.0) -> None:
        self.title, self.later, self.line = title, later, ProgressLine()
        self.costs = {run.name: run.cost for run in runs}
        self.in_seconds = all(run.settings.seconds is not None for run in runs)
        self.before: dict[str, str] = {}
        self.done_before: set[str] | None = None
        self.started: dict[str, tuple[float, float]] = {}
        self.took: dict[str, tuple[float, float]] = {}

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
                self.line.close()
                print(f"{status:<12}{name}", flush=True)
        self.before = dict(statuses)
        left = self.seconds_left(statuses, progress)
        ended = sum(status in ENDED for status in statuses.values())
        state = f"{ended} of {len(statuses)} runs done, {len(progress)} running"
        whole = " in all" if self.later else ""
        words = "" if left is None else f"about {duration(left)} left{whole}"
        self.line(self.title, nan, state, words)

    def seconds_left(self, statuses: dict[str, str], progress: dict[str, float]) -> float | None:
        """The expected remaining time; None until the speed is known, for budgets in frames."""
        now = time.monotonic()
        complete = {name: 1.0 for name in self.started if statuses[name] == "complete"}
        for name, share in {**complete, **progress}.items():
            began, before = self.started.setdefault(name, (now, share))
            if share - before > self.took.get(name, (0.0, 0.0))[1]:
                self.took[name] = (now - began, share - before)
        work = sum(self.costs[name] * share for name, (_, share) in self.took.items())
        if not work and not self.in_seconds:
            return None
        speed = work / sum(seconds for seconds, _ in self.took.values()) if work else 1.0
        ahead = [name for name, status in statuses.items() if status not in ENDED]
        left = sum(self.costs[name] * (1.0 - progress.get(name, 0.0)) for name in ahead)
        return (left + self.later) / speed / max(len(progress), 1)
