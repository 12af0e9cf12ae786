"""`pursuit ablate`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from train.commands.parse import parse
from train.commands.sweep import SweepCommand, carry_out, check_options


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
    given = parse(AblateCommand, arguments, "ablate")
    check_options(given)
    from train.experiments.ablation import ABLATIONS, load_ablation  # torch is slow to import
    from train.experiments.sweep import shipped

    if given.list:
        for name in shipped(ABLATIONS):
            plan = load_ablation(name)
            variants = len({run.label["variant"] for run in plan.runs})
            print(f"{name:<26}{variants} variants  {plan.title}")
        return
    plan = load_ablation(str(given.file), given.version)
    carry_out(plan, given, f"pursuit ablate {shlex.join(arguments)}", "ablations")
