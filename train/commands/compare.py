"""`pursuit compare`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pursuit.validation import at_least, check
from train.commands.parse import parse
from train.commands.sweep import check_own, exit_if_failed, list_stages, run_stages
from train.settings.checks import Settings

if TYPE_CHECKING:
    from train.experiments.study import StudyFile


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
    options = parse(CompareCommand, arguments, "compare")
    check(
        options.version in ("short", "full"), f"unknown version {options.version!r}; short or full"
    )
    from train.experiments.stages import stages_of  # torch is slow to import

    def with_clock(file: StudyFile) -> StudyFile:
        if options.clock is not None:
            file.settings = {**(file.settings or {}), "clock": options.clock}
        return file

    out = options.out or Path("comparisons") / f"{Path(options.file).stem}-{options.version}"
    stages = stages_of(options.file, "comparison", options.version, out, with_clock)
    check_own(stages[-1], out, options.overwrite)
    if options.dry_run:
        list_stages(stages, out, options.workers)
        return
    again = f"pursuit compare {shlex.join(arguments)}"
    done = run_stages(stages, options.workers, again)
    exit_if_failed(done[-1:], again)
