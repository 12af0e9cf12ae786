"""`pursuit levels`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from curricula import LevelReplay
from train.commands.parse import parse
from train.files import check_folder
from train.runs.folder import MISFITS, load_checkpoint, misfit
from train.settings.checks import Settings, at_least, passes


@dataclass(frozen=True)
class LevelsCommand(Settings):
    """The levels that a run with --curriculum level-replay or learnability kept, best first."""

    run: Annotated[Path, tyro.conf.Positional, passes(check_folder)]
    """The folder of the run."""
    count: Annotated[int, at_least(1)] = 3
    """How many."""


def levels(arguments: Sequence[str]) -> None:
    """`pursuit levels`."""
    given = parse(LevelsCommand, arguments, "levels")
    from train.runs.parts import parts_of  # torch is slow to import
    from train.runs.saved import load_settings
    from train.teaching.teacher import load_curriculum

    settings = load_settings(given.run)
    parts = parts_of(settings)
    curriculum = None if parts.plan is None else parts.plan.curriculum()
    if not isinstance(curriculum, LevelReplay):
        raise ValueError(
            f"{given.run}: curriculum {settings.curriculum!r} keeps no levels; level-replay and "
            "learnability do"
        )
    try:
        state = load_checkpoint(given.run)
        load_curriculum(curriculum, state["trainee"]["teacher"]["curriculum"])
    except MISFITS as error:
        raise misfit(given.run, error) from None
    kept = curriculum.best(given.count)
    if not kept:
        print(f"{given.run}: no level was kept; none was played often enough to be scored")
    for seed, score, wins, plays in kept:
        print(f"level {seed}: {curriculum.score} {score:.4g}, {wins} of {plays} episodes solved")
        print(parts.world.level(parts.seat.task, seed))
