"""`pursuit compare`."""

from __future__ import annotations

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
from train.settings.checks import Settings

if TYPE_CHECKING:
    from train.experiments.comparison.plan import Comparison
    from train.experiments.study import Study


@dataclass(frozen=True)
class CompareCommand(Settings):
    """Compare PPO of several libraries on the same tasks, with the same budget for tuning.

    Settings are searched on held-out mazes. Then every contestant learns the tasks with several
    seeds, and the time to 5, 2 and 1 % of the exact optimum is measured. Completed runs are not
    repeated, so Ctrl-C loses at most one run.
    """

    file: Annotated[str, tyro.conf.Positional] = "ppo"
    """A comparison file (.toml), or the name of a shipped one."""
    version: str = "short"
    """short or full."""
    out: Path | None = None
    """The output folder; comparisons/NAME-VERSION by default."""
    clock: str | None = None
    """wall, or processor: processor time of the run's process, which other load on the machine
    affects less. By default the clock of the file."""
    workers: Annotated[int, at_least(1)] = 1
    """Parallel runs, one core each. Use 1 for published timings: cores share caches and memory
    bandwidth."""
    dry_run: bool = False
    """Check the file and print the plan without running it."""
    overwrite: bool = False
    """Use --out even if it contains another comparison. Its runs are kept, its report is
    replaced."""


def compare(arguments: Sequence[str]) -> None:
    """`pursuit compare`."""
    given = parse(CompareCommand, arguments, "compare")
    from train.experiments.comparison.plan import load_comparison  # torch is slow to import
    from train.experiments.comparison.report import comparison_report
    from train.experiments.comparison.run import is_folder_of, run_comparison

    plan = load_comparison(given.file, given.version, given.clock)
    out = given.out or Path("comparisons") / f"{Path(given.file).stem}-{given.version}"
    check_output_folder(out, lambda folder: is_folder_of(plan, folder), given.overwrite)
    print_plan(plan, out, given.workers)
    if given.dry_run:
        return

    def watch(study: Study) -> SweepWatch:
        print(f"{study.title}: {len(study.runs)} runs")
        return SweepWatch()

    with resumable(f"pursuit compare {shlex.join(arguments)}"):
        outcome = run_comparison(plan, out, watch, given.workers)
    print(f"report: {comparison_report(plan, outcome, out)}")
    failed = sum(result is None for result in outcome.finals.values())
    if failed:
        print(f"{failed} runs failed; repeat the command to retry them", file=sys.stderr)
        sys.exit(1)


def print_plan(plan: Comparison, out: Path, workers: int) -> None:
    """Print tasks, number of runs and duration."""
    from train.experiments.attainable import comparison_out_of_reach
    from train.experiments.comparison.plan import FILES
    from train.experiments.sweep import shipped  # torch is slow to import

    trials, finals = plan.count()
    print(f"{plan.title}: {', '.join(plan.contestants)}")
    for on in plan.tasks:
        mazes = ", ".join(task.maze.removeprefix("suite:") for task in on.held_out)
        print(f"  {on.name}; settings searched on {mazes}")
    length = plan.seconds()
    time = "" if length is None else f", {length / 60 / workers:.0f} minutes without evaluations"
    print(f"{trials} runs of the search and {finals} of the comparison into {out}{time}")
    for line in comparison_out_of_reach(len(plan.final.seeds)):
        print(line)
    print(f"shipped comparison files: {', '.join(shipped(FILES))}")
