"""`pursuit reproduce`."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pursuit.validation import at_least
from train.commands.parse import parse
from train.commands.sweep import SweepWatch, resumable
from train.files import check_output_folder
from train.settings.checks import Settings, check

if TYPE_CHECKING:
    from train.experiments.replication.plan import Replication
    from train.experiments.study import Study


@dataclass(frozen=True)
class ReproduceCommand(Settings):
    """Repeat the experiments of the thesis, and decide its claims.

    First settings are searched, with the same budget for every algorithm. Then the studies run, and
    a page lists every claim with its rule, verdict and evidence. Complete runs are skipped, so the
    same command continues after Ctrl-C. The short version takes two hours on two cores, the full
    one about 40 core hours.
    """

    studies: Annotated[tuple[str, ...], tyro.conf.Positional] = ("all",)
    """all, or studies by name: figure-4.2, table-3.1, ... (see --list)."""
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


def reproduce(arguments: Sequence[str]) -> None:
    """`pursuit reproduce`."""
    given = parse(ReproduceCommand, arguments, "reproduce")
    from train.experiments.replication.plan import load_replication  # torch is slow to import
    from train.experiments.replication.report import is_folder_of, write_replication
    from train.experiments.replication.run import carry_out

    plan = load_replication(given.studies, given.version, given.mazes, given.claims)
    if given.list:
        for study in plan.studies:
            print(f"{study.id:<20}{study.title}")
            print("\n".join(f"{'':<22}{claim.text}" for claim in study.claims))
        return
    own = "-own-mazes" if given.mazes else ""
    out = given.out or Path("replications") / f"{plan.name}-{given.version}{own}"
    workers = given.workers or os.cpu_count() or 1
    check_output_folder(out, lambda folder: is_folder_of(plan, folder), given.overwrite)
    if given.dry_run:
        print_plan(plan, out, workers)
        return
    if given.page:
        check(out.is_dir(), f"{out}: no such folder; leave out --page to start the runs")
        print(f"page: {write_replication(plan, out)}")
        return
    with resumable(f"pursuit reproduce {shlex.join(arguments)}"):
        well = carry_out(
            plan,
            out,
            workers,
            lambda line: print(f"\n{line}", flush=True),
            lambda study: SweepWatch(),
        )
    print(f"page: {write_replication(plan, out)}")
    if not well:
        print("runs failed; repeat the command to retry them", file=sys.stderr)
        sys.exit(1)


def print_plan(plan: Replication, out: Path, workers: int) -> None:
    """Print the number of runs of every study, and of complete ones."""
    from train.experiments.replication.run import stages  # torch is slow to import
    from train.experiments.study import statuses_of

    total = 0
    for stage in stages(plan, out):
        runs = stage.runs.runs
        done = list(statuses_of(stage.runs, stage.folder).values()).count("complete")
        total += len(runs) - done
        words = budget_words(stage.runs)
        print(f"{stage.name:<20}{len(runs):>4} runs, {done} complete; {words}")
    print(f"{total} runs to do into {out}, {workers} in parallel; nothing was done")


def budget_words(sweep: Study) -> str:
    """The budgets of the runs as text."""
    budgets = {(run.settings.seconds, run.settings.frames) for run in sweep.runs}
    return " or ".join(
        f"{seconds:g} s each" if seconds is not None else f"{frames:,} frames each"
        for seconds, frames in sorted(budgets, key=str)
    )
