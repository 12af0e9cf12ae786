"""`pursuit reproduce`."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from pursuit.validation import at_least, check
from train.commands.parse import parse
from train.commands.sweep import exit_if_failed, list_stages, run_stages
from train.files import check_output_folder
from train.settings.checks import Settings


@dataclass(frozen=True)
class ReproduceCommand(Settings):
    """Repeat the experiments of the thesis, and decide its claims.

    First settings are searched, with the same budget for every algorithm. Then the studies run, and
    a page lists every claim with its rule, verdict and evidence. Complete runs are skipped, so the
    same command continues after Ctrl-C. The short version takes some hours on two cores,
    the full one some days; --dry-run lists the budgets.
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
    options = parse(ReproduceCommand, arguments, "reproduce")
    from train.experiments.replication import (  # torch is slow to import
        is_replication,
        keep_rules,
        load_replication,
        replication_stages,
    )
    from train.experiments.replication_page import write_replication

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
        list_stages(stages, out, options.workers or os.cpu_count() or 1)
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
