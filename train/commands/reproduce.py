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

from train.commands.parse import parse
from train.commands.sweep import SweepWatch, resumable
from train.files import check_output_folder
from train.settings.checks import Settings, at_least, check

if TYPE_CHECKING:
    from train.experiments.replication.plan import Replication
    from train.experiments.study import Study


@dataclass(frozen=True)
class ReproduceCommand(Settings):
    """Run the thesis' experiments again, and decide its claims one by one.

    Settings are searched first, equally long for every algorithm; then the studies run, and a page
    with every claim, the rule that decides it, the verdict and what it rests on. What is complete
    is not done again: Ctrl-C loses nothing, and the same command goes on. The short version is made
    for two hours of two cores, the full one for some 40 core hours.
    """

    studies: Annotated[tuple[str, ...], tyro.conf.Positional] = ("all",)
    """all, or studies by name: figure-4.2, table-3.1, ... (see --list)."""
    claims: str = "thesis"
    """thesis: what the thesis claims. optimum: hypotheses of our own, on what gaps are made of. Or
    a file of yours in their form."""
    list: bool = False
    """Name the studies and their claims."""
    version: str = "short"
    """short or full."""
    mazes: Path | None = None
    """A folder with your copy of the thesis' mazes: text files, one of each size, that stand for
    ours of the same size."""
    out: Path | None = None
    """The folder of the replication; replications/CLAIMS-VERSION if left out."""
    workers: Annotated[int, at_least(0)] = 0
    """Runs at a time, each on a core of its own; 0 is one for each core."""
    dry_run: bool = False
    """Say what there is to do, but do nothing."""
    page: bool = False
    """Only write the page, of the runs that are complete."""
    overwrite: bool = False
    """Use --out though it is the folder of another replication: its runs stay, its page is
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
        tell_plan(plan, out, workers)
        return
    if given.page:
        check(out.is_dir(), f"{out}: no such folder; leave --page out to begin")
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
        print("runs failed; the same command tries them again", file=sys.stderr)
        sys.exit(1)


def tell_plan(plan: Replication, out: Path, workers: int) -> None:
    """Say what there is to do, and what is done already."""
    from train.experiments.replication.run import stages  # torch is slow to import
    from train.experiments.study import statuses_of

    total = 0
    for stage in stages(plan, out):
        runs = stage.runs.runs
        done = list(statuses_of(stage.runs, stage.folder).values()).count("complete")
        total += len(runs) - done
        words = budget_words(stage.runs)
        print(f"{stage.name:<20}{len(runs):>4} runs, {done} complete; {words}")
    print(f"{total} runs to do into {out}, {workers} at a time; nothing was done")


def budget_words(sweep: Study) -> str:
    """How long its runs are."""
    budgets = {(run.settings.seconds, run.settings.frames) for run in sweep.runs}
    return " or ".join(
        f"{seconds:g} s each" if seconds is not None else f"{frames:,} frames each"
        for seconds, frames in sorted(budgets, key=str)
    )
