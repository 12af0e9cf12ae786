"""`pursuit ablate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from train.commands.parse import parse
from train.commands.sweep import SweepCommand, run_study_file


@dataclass(frozen=True)
class AblateCommand(SweepCommand):
    """Compare variants (such as curricula) with a control, over several seeds.

    All variants have the same budget and are evaluated on the task itself, at its final difficulty,
    throughout training. `pursuit ablate --list` lists the shipped files. Complete runs are skipped,
    interrupted runs are resumed.
    """

    file: Annotated[str | None, tyro.conf.Positional] = None
    """An ablation file (.toml), or the name of a shipped one."""
    list: bool = False
    """List the shipped ablation files."""
    out: Path | None = None
    """The folder of the ablation; by default ablations/NAME, of the full version
    ablations/NAME-full."""


def ablate(arguments: Sequence[str]) -> None:
    """`pursuit ablate`."""
    run_study_file(parse(AblateCommand, arguments, "ablate"), arguments, "ablation")
