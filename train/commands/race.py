"""`pursuit race`."""

from __future__ import annotations

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
from train.settings.checks import Settings, at_least

if TYPE_CHECKING:
    from train.experiments.comparison.plan import Race
    from train.experiments.study import Study


@dataclass(frozen=True)
class RaceCommand(Settings):
    """Have PPO of several libraries race: the same tasks, the same budget to find settings.

    (Not the task called race: see `pursuit train --task race`.) Settings are searched on held-out
    mazes, then every contestant learns the tasks with several seeds, and the time to 5, 2 and 1 %
    of the exact optimum counts. What is done is not done again, so Ctrl-C loses a run at most.
    """

    file: Annotated[str, tyro.conf.Positional] = "ppo"
    """A race file (.toml), or the name of a shipped one."""
    version: str = "short"
    """short or full."""
    out: Path | None = None
    """The folder of the race; races/NAME-VERSION if left out."""
    clock: str | None = None
    """wall, or cpu: seconds of the run's own process on its core, which a machine that is busy with
    other things does not stretch as much. That of the file if left out."""
    workers: Annotated[int, at_least(1)] = 1
    """Runs at a time, each on a core of its own. Leave it at 1 for figures that are to be
    believed: cores share their caches and their memory."""
    dry_run: bool = False
    """Check the file and say what would be done, but do nothing."""
    overwrite: bool = False
    """Use --out though it is the folder of another race: its runs stay, its report is replaced."""


def race(arguments: Sequence[str]) -> None:
    """`pursuit race`."""
    given = parse(RaceCommand, arguments, "race")
    from train.experiments.comparison.plan import load_race  # torch is slow to import
    from train.experiments.comparison.report import race_report
    from train.experiments.comparison.run import is_folder_of, run_race

    plan = load_race(given.file, given.version, given.clock)
    out = given.out or Path("races") / f"{Path(given.file).stem}-{given.version}"
    check_output_folder(out, lambda folder: is_folder_of(plan, folder), given.overwrite)
    tell_plan(plan, out, given.workers)
    if given.dry_run:
        return

    def watch(study: Study) -> SweepWatch:
        print(f"{study.title}: {len(study.runs)} runs")
        return SweepWatch()

    with resumable(f"pursuit race {shlex.join(arguments)}"):
        standing = run_race(plan, out, watch, given.workers)
    print(f"report: {race_report(plan, standing, out)}")
    failed = sum(result is None for result in standing.finals.values())
    if failed:
        print(f"{failed} runs failed; the same command tries them again", file=sys.stderr)
        sys.exit(1)


def tell_plan(plan: Race, out: Path, workers: int) -> None:
    """Say what is to be done."""
    from train.experiments.comparison.plan import FILES
    from train.experiments.sweep import shipped  # torch is slow to import

    trials, finals = plan.count()
    print(f"{plan.title}: {', '.join(plan.contestants)}")
    for on in plan.tasks:
        mazes = ", ".join(task.maze.removeprefix("suite:") for task in on.held_out)
        print(f"  {on.name}; settings searched on {mazes}")
    length = plan.seconds()
    told = "" if length is None else f", {length / 60 / workers:.0f} minutes without evaluations"
    print(f"{trials} runs of the search and {finals} of the race into {out}{told}")
    print(f"shipped race files: {', '.join(shipped(FILES))}")
