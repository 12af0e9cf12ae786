"""`pursuit ablate`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
    """The folder of the ablation; ablations/NAME-VERSION by default."""


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
            print(f"{name:<22}{variants} variants  {plan.title}")
        return
    plan = load_ablation(str(given.file), given.version)
    stem = Path(str(given.file)).stem
    out = Path("ablations") / (f"{stem}-{given.version}" if given.version else stem)
    carry_out(plan, replace(given, out=given.out or out), f"pursuit ablate {shlex.join(arguments)}")
