"""`pursuit export`: the policy of a run for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from pursuit.validation import check, passes
from train.commands.parse import parse
from train.files import check_folder, check_new_files


@dataclass(frozen=True)
class ExportCommand:
    """Write the policy of a run as ONNX (.onnx) or as a program of torch.export (.pt2).

    Of self-play give the folder of one side, such as runs/pair/chaser.
    """

    run: Annotated[Path | None, tyro.conf.Positional, passes(check_folder)] = None
    """The folder of the run."""
    at: str | None = None
    """The policy that was kept at so many frames, or best; as in pursuit evaluate."""
    out: Path = Path("policy.onnx")
    """A new .onnx or .pt2 file."""
    overwrite: bool = False
    """Replace --out if it exists."""


def export(arguments: Sequence[str]) -> None:
    """`pursuit export`."""
    given = parse(ExportCommand, arguments, "export")
    check(given.run is not None, "give the folder of a run")
    check_new_files([given.out], given.overwrite)
    from train.runs.export import export_policy
    from train.runs.opponents import load_policy

    policy = load_policy(str(given.run), at=given.at)
    path = export_policy(policy, given.out)
    seen = getattr(policy.seat, "seen", policy.seat.features)
    shape, encoding = ", ".join(map(str, ("batch", *seen.shape))), policy.seat.encoding
    print(f"{path}: observation [{shape}] ({encoding}) to probabilities [batch, actions]")
